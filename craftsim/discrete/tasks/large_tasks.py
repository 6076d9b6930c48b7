"""The large tasks of the paper's section 4.4, which CraftEnv does not ship: a tower and free building.

Each has 20 blocks and 4 slopes in 10 x 10 x 4 cells, and 4 or 8 cars; all of them start anywhere on the floor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from craftsim.discrete.files.blueprint import Blueprint
from craftsim.discrete.files.design import Design, read_design
from craftsim.discrete.files.shipped import shipped_blueprint
from craftsim.discrete.grid import Cell
from craftsim.discrete.tasks.random_tasks import RandomPlacement
from craftsim.discrete.tasks.rewards import Reward
from craftsim.discrete.tasks.starts import Split, check_split
from craftsim.discrete.tasks.task import Task
from craftsim.errors import InputError, suggestion

AREA: Final[Cell] = (10, 10, 4)
BLOCKS: Final = 20
SLOPES: Final = 4


@dataclass(frozen=True)
class _Kind:
    cars: int
    max_steps: int
    has_design: bool


_KINDS: Final = {
    "large_tower_4": _Kind(4, 236, True),
    "large_tower_8": _Kind(8, 196, True),
    "large_free_building_4": _Kind(4, 236, False),
    "large_free_building_8": _Kind(8, 196, False),
}
"""Step limits: about 1.3 times the longest of the plans for the tower in docs/results/large.md."""
LARGE_NAMES: Final = tuple(_KINDS)


def large_task(name: str, split: Split = "train") -> Task:
    """Return one of the large tasks, with a random start in each episode.

    The tower is three levels high, with four ramps; its reward is table 1 of the paper, as in complex two-story. Free
    building is rewarded by :func:`craftsim.discrete.tasks.rewards.structure`, has succeeded once three blocks stand on
    one another, and goes on until the step limit.

    Args:
        name: ``large_tower_4``, ``large_tower_8``, ``large_free_building_4`` or ``large_free_building_8``, by the
            number of cars.
        split: ``train`` or ``test``; both are drawn as needed, and no start is in both.

    Raises InputError.

    Example:
        >>> from craftsim.discrete.tasks import as_task
        >>> task = as_task("large_tower_8")
        >>> task.starts[0].size, task.layout.n_cars, task.layout.n_blocks, task.layout.n_slopes
        ((10, 10, 4), 8, 20, 4)
    """
    check_split(split)
    if name not in _KINDS:
        raise InputError(
            f"unknown large task '{name}'{suggestion(name, LARGE_NAMES)}; there are {', '.join(LARGE_NAMES)}"
        )
    kind = _KINDS[name]
    design: Design | None = None
    if kind.has_design:
        design = read_design(shipped_blueprint("large_tower_goal"))
    task = Task(
        name=name + (f"@{split}" if split == "test" else ""),
        starts=(Blueprint(Path(name), AREA, BLOCKS, SLOPES, kind.cars),),
        reward=Reward("complex_building" if design else "structure"),
        success="built" if design else "three_high",
        design=design,
        max_steps=kind.max_steps,
        ends_on_success=design is not None,
        split=split,
        shown_targets=len(design.targets) if design else 0,
    )
    return replace(task, sampler=RandomPlacement(task, apart=True))
