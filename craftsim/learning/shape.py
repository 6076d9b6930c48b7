"""Which task a policy is for: by what its worlds are made of, and by the shape of its observations."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from typing import Any, Final, get_args

from craftsim.discrete.grid import check_size
from craftsim.discrete.ranges import EPISODE_TICKS
from craftsim.discrete.rules import RuleSet
from craftsim.errors import InputError, check_choice
from craftsim.learning.config import NetworkName
from craftsim.learning.ranges import RUN_RANGES
from craftsim.learning.starts import HalfShown
from craftsim.storage.limits import POLICY, Range, size_text
from craftsim.tasks import Task
from craftsim.tasks.kernel import IS_BLOCK, IS_BODY, IS_CAR, IS_FLAG, IS_FOOT, IS_FSLOPE, ROW
from craftsim.tasks.starts import Starts

FORMS: Final = {IS_CAR: 8, IS_FSLOPE: 4, IS_BODY: 4, IS_FOOT: 4, IS_BLOCK: 1, IS_FLAG: 1}
"""In how many forms an entity of each kind comes: four yaws, and a car with or without a load."""
_WEIGHT_BYTES: Final = 4


@dataclass(frozen=True)
class Shape:
    """The shape of the networks for a task. Raises InputError for one that no policy file could hold."""

    size: tuple[int, int, int]  # length, width and height of the map
    n_cars: int
    vector_length: int  # numbers in one car's observation
    width: int  # of the vectors inside the network
    network: NetworkName = "map"  # things are looked up by cell, or as they lie from a car
    """``linear``: nothing is looked up, the first layer is linear in what is observed."""
    layer_norm: bool = False  # whether the policy normalises its layers
    recurrent: bool = False  # whether the policy has a memory
    last_action: bool = True  # whether one with a memory sees what its car did last
    ticks: int = (
        0  # of an episode, where the tick and busy helpers are observed, too; 0: they are hidden
    )

    def __post_init__(self) -> None:
        check_choice("network", self.network, get_args(NetworkName))
        check_size(self.size, self.n_cars)
        RUN_RANGES["width"].check("width", self.width)
        Range(0, EPISODE_TICKS.high + 2).check("ticks", self.ticks)
        if self.n_cars < 0 or self.vector_length < ROW or self.vector_length % ROW:
            raise InputError(
                f"the shape has {self.n_cars} cars that observe {self.vector_length} numbers; allowed: {ROW} a thing"
            )
        n_bytes = self.places * self.width * _WEIGHT_BYTES
        if n_bytes > POLICY.content_bytes:
            raise InputError(
                f"for a map of size {self.size} a network of width {self.width} has {size_text(n_bytes)}; allowed: at "
                f"most {size_text(POLICY.content_bytes)}; take a smaller map"
            )

    def __str__(self) -> str:
        cells = " x ".join(map(str, self.size))
        observers = f" with {self.n_cars} cars that observe {self.vector_length} numbers"
        if self.network == "relative":
            observers = ""
        return f"{cells} cells{observers} (network {self.network}, width {self.width})"

    @property
    def cells(self) -> int:
        """Cells in which something may be; a car may stand above the highest one."""
        length, width, height = self.size
        return length * width * (height + 1)

    @property
    def places(self) -> int:
        """Rows of the table of all things in all cells, with one for what is not there.

        The own car has a part of the table to itself.
        """
        if self.network == "linear":
            return self.vector_length
        further = 1 + self.n_hidden
        if self.network == "map":
            return (FORMS[IS_CAR] + sum(FORMS.values())) * self.cells + further
        return FORMS[IS_CAR] * self.cells + 3 * sum(FORMS.values()) * self.offsets + further

    @property
    def n_hidden(self) -> int:
        """Rows of that table for what is hidden otherwise: each tick, and whose helpers are under way."""
        if not self.ticks:
            return 0
        return self.ticks + 4

    @property
    def offsets(self) -> int:
        """Offsets that a thing may have from a car, however the car is turned."""
        length, width, height = self.size
        return (2 * max(length, width) - 1) ** 2 * (2 * height + 1)

    @classmethod
    def of(
        cls,
        task: Task,
        width: int,
        network: NetworkName = "map",
        ticks: int = 0,
        **of_policy: bool,
    ) -> Shape:
        """Return the shape of networks for a task; ``of_policy`` are the three fields about the policy."""
        layout = task.layout
        length = layout.vector_length
        if ticks:
            length += ROW
        return cls(
            task.starts[0].size, layout.n_cars, length, width, network, ticks=ticks, **of_policy
        )

    def of_task(self, task: Task) -> Shape:
        """Return the shape of the same networks for another task."""
        of_policy = {
            "layer_norm": self.layer_norm,
            "recurrent": self.recurrent,
            "last_action": self.last_action,
        }
        return Shape.of(task, self.width, self.network, self.ticks, **of_policy)

    def fits(self, shape: Shape) -> bool:
        """Whether networks for this shape serve the worlds of another; those that look from a car count nothing."""
        if self.network != "relative":
            return self == shape
        ours = self.size, self.width, self.network, self.ticks
        return ours == (shape.size, shape.width, shape.network, shape.ticks)


def check_stage(stage: Task, shape: Shape) -> None:
    """Raise InputError for a task to learn on before another one that is of another shape."""
    stage_shape = shape.of_task(stage)
    if stage_shape != shape:
        raise InputError(
            f"stage '{stage.name}' has {stage_shape}; allowed is what the task has: {shape}"
        )


@dataclass(frozen=True)
class TaskIdentity:
    """What a task is, in digests (SHA-256, hexadecimal) that can be stored and compared."""

    name: str
    world: str  # of the start files' contents and of whether observations show the flag
    design: str  # of the cells to be built; empty for a task without a design
    rules: str  # the name of the rule set, of a learned one with its digest

    @classmethod
    def of(cls, task: Task, rules: RuleSet = "physical") -> TaskIdentity:
        """Return the identity of a task under a rule set; rewards, lengths and stored starts are no part of it."""
        world = _digest([task.shows_flag, *(start.content for start in task.starts)])
        design = ""
        if task.design is not None:
            design = _digest(task.design.content)
        return cls(task.name, world, design, str(rules))

    @property
    def digest(self) -> str:
        """One digest of all but the name."""
        return _digest([self.world, self.design, self.rules])

    def difference(self, task: Task, rules: RuleSet | None = None, any_world: bool = False) -> str:
        """Return in words in what another task differs, or nothing where it is the same.

        Designs are compared where both have one, rule sets where one is given; nothing else in ``any_world``.
        """
        identity = TaskIdentity.of(task)
        if not any_world and self.world != identity.world:
            return "its worlds start otherwise"
        if not any_world and self.design and identity.design and self.design != identity.design:
            return "its design is another"
        if rules and str(rules) != self.rules:
            return f"its rule set is {rules}, not {self.rules}"
        return ""


def starts_digest(task: Task) -> str:
    """Return a digest of the stored worlds that a task's episodes start with; empty where it has none."""
    starts = task.sampler.demonstrated if isinstance(task.sampler, HalfShown) else task.sampler
    if not isinstance(starts, Starts):
        return ""
    digest = hashlib.sha256()
    for array in (starts.grids.cells, starts.grids.cars, starts.designs):
        digest.update(f"{array.dtype} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
