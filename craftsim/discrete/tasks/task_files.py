"""Tasks from files: a blueprint, with a goal file beside it, or a task file that names both and a reward.

A task file is a small YAML file; docs/tasks.md shows one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, get_args

from craftsim.discrete.files.blueprint import KEYS, Blueprint, parse_blueprint, read_blueprint
from craftsim.discrete.files.design import Design, read_design
from craftsim.discrete.files.documents import Node, Scalar, Sequence, Source, parse_keys, read_text
from craftsim.discrete.files.shipped import Shelf, find
from craftsim.discrete.grid import Kind
from craftsim.discrete.tasks.task import DEFAULT_MAX_STEPS, RewardName, Task, build_task, free_play
from craftsim.storage.paths import is_file
from craftsim.storage.writing import writable

TASK_KEYS: Final = ["start", "goal", "reward", "max_steps", "cars", "blocks"]
PLATFORM: Final = "platform"
"""The goal of building one platform of all blocks."""
MAX_STEPS: Final = 100_000


def read_task(
    path: str | Path, reward: RewardName = "paper", n_cars: int | None = None, n_blocks: int | None = None
) -> Task:
    """Return the task of a blueprint or of a task file.

    A blueprint ``mine.yaml`` has the design in ``mine_goal.yaml`` beside it as its goal. Without one, the goal is to
    bring its flag to its goal cell if it has both; else there is none, unless a task file says ``goal: platform``. What
    a task file says of reward and counts goes before the arguments. Raises BlueprintError with file, line and key.
    """
    path = Path(path)
    text = read_text(path)
    source, keys = parse_keys(path, text, [*KEYS, *(key for key in TASK_KEYS if key not in KEYS)])
    if "start" not in keys.items:
        start = parse_blueprint(text, path).with_counts(n_cars, n_blocks)
        beside = path.with_name(f"{path.stem}_goal{path.suffix}")
        design = read_design(beside) if is_file(beside) else None
        return _task(path, (start,), design, reward, DEFAULT_MAX_STEPS)
    for key in keys.items:
        if key not in TASK_KEYS:
            source.fail_unknown(keys.key_lines[key], key, TASK_KEYS)

    def whole(key: str, otherwise: int | None, high: int) -> int | None:
        return source.integer(keys.items[key], key, 0, high) if key in keys.items else otherwise

    counts = whole("cars", n_cars, MAX_STEPS), whole("blocks", n_blocks, MAX_STEPS)
    starts = tuple(
        read_blueprint(place).with_counts(*counts) for place in _places(source, keys.items["start"])
    )
    design, platform = None, False
    if "goal" in keys.items:
        platform = isinstance(keys.items["goal"], Scalar) and keys.items["goal"].text == PLATFORM
    if "goal" in keys.items and not platform:
        design = read_design(_place(source, keys.items["goal"], "goal", "goals"))
    if "reward" in keys.items:
        reward = source.word(keys.items["reward"], "reward", [*get_args(RewardName)])  # type: ignore[assignment]
    return _task(
        path, starts, design, reward, whole("max_steps", None, MAX_STEPS) or DEFAULT_MAX_STEPS, platform
    )


def _places(source: Source, node: Node) -> list[Path]:
    """Return the files that a start names: one, or a list of which one is drawn for each episode."""
    items = node.items if isinstance(node, Sequence) else [node]
    if not items:
        source.fail(node.line, "key 'start': needs at least one start file")
    return [_place(source, item, "start", "blueprints") for item in items]


def _place(source: Source, node: Node, key: str, shelf: Shelf) -> Path:
    """Return the file that a value names: one beside the task file, or a shipped one."""
    if not isinstance(node, Scalar) or not node.text:
        source.fail(node.line, f"key '{key}': must be a file beside this one, or the name of a shipped one")
    near = source.path.parent / node.text
    return near if is_file(near) else find(node.text, shelf)


def _task(
    path: Path,
    starts: tuple[Blueprint, ...],
    design: Design | None,
    reward: RewardName,
    max_steps: int,
    platform: bool = False,
) -> Task:
    name = writable(path.stem)
    flags = all(start.goal is not None and start.listed(Kind.FLAG) for start in starts)
    goal = starts[0].goal if flags and design is None and starts else None
    if design is None and goal is None and not platform:
        return free_play(name, starts, max_steps)
    return build_task(name, starts, design, goal, reward, max_steps)
