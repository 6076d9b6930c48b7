"""Tasks by name: the paper's six, tasks that were registered, files, and factories in Python modules.

What stands in a file is looked up by :func:`known_task`, which imports nothing; what is given on the command line or in
Python by :func:`as_task`, which also takes ``module:factory``. A file is a blueprint, with a goal file beside it, or a
task file, a small YAML file that names both and a reward; docs/reference/tasks.md shows one.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Final, cast

from craftsim.discrete.files.blueprint import KEYS, blueprint_of, read_blueprint, read_world
from craftsim.discrete.files.design import Design, read_design
from craftsim.discrete.files.shipped import Shelf, find_file
from craftsim.discrete.grid import Kind
from craftsim.errors import CraftsimError, InputError, suggestion
from craftsim.storage.limits import Range
from craftsim.storage.paths import is_file
from craftsim.storage.records import record
from craftsim.storage.writing import writable
from craftsim.storage.yaml import Document
from craftsim.tasks.random_tasks import (
    LARGE_NAMES,
    RANDOM_NAMES,
    RANDOM_PREFIX,
    large_task,
    random_task,
)
from craftsim.tasks.rewards import REWARDS, TERMS
from craftsim.tasks.starts import Split
from craftsim.tasks.task import (
    DEFAULT_MAX_STEPS,
    TASK_NAMES,
    WITHOUT_GOAL,
    Task,
    build_task,
    free_play,
    make_task,
)
from craftsim.workers.modules import find_named, note_registering, plug_ins

DESIGNS: Final = "designs"
"""The name of the task in which each episode has a random design."""
VARIED_NAMES: Final = (*RANDOM_NAMES, *LARGE_NAMES, DESIGNS)
"""The tasks whose episodes differ."""

PLATFORM: Final = "platform"
"""The goal of building one platform of all blocks."""
_MAX_STEPS: Final = 100_000
_MOST_TERMS: Final = 100
_LARGEST_WEIGHT: Final = 1e9
_Number = Annotated[int, Range(0, _MAX_STEPS)]


@record(kw_only=True)
class _File:
    start: Any
    """A start file, or a list of them."""
    goal: Any = None
    reward: Any = None
    """The name of a reward or of a term, or a mapping of such names and weights."""
    max_steps: _Number | None = None
    cars: _Number | None = None
    blocks: _Number | None = None


_OF_TASKS: Final = {field.name for field in fields(_File)} - {*KEYS}
"""Keys that tell a task file from a blueprint."""

_REGISTERED: Final[dict[str, Task]] = {}
_LISTENERS: Final[list[Callable[[Task], None]]] = []
_LONGEST: Final = 1000
"""Characters of a name in a file, which messages repeat."""
_FIXED: Final = "{} has its own area and numbers of cars and blocks; they cannot be given"
_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")


def register_task(task: Task) -> Task:
    """Make a task known by its name wherever a task's name is asked for, to Gymnasium and to PettingZoo; return it.

    Processes that craftsim starts import the modules that register at their top level. Registering a task again
    replaces it. Raises InputError for a name of craftsim's own tasks, for one that is not made of letters, digits,
    ``_`` and ``-``, and for one that Gymnasium could not tell from another's (``long_strip`` is
    ``craftsim/LongStrip-v0``).

    Example:
        >>> import craftsim
        >>> from dataclasses import replace
        >>> mine = replace(craftsim.make_task("strip"), name="long_strip", max_steps=100)
        >>> craftsim.register_task(mine).name
        'long_strip'
        >>> craftsim.parallel_env("long_strip", "grid").possible_agents
        ['car_0', 'car_1']
    """
    if not isinstance(task, Task):
        raise InputError(f"only a Task can be registered, not {type(task).__name__}")
    if task.name in (*TASK_NAMES, *VARIED_NAMES):
        raise InputError(f"'{task.name}' is a task of craftsim's own; give yours another name")
    if not _NAME.fullmatch(task.name):
        raise InputError(f"a task's name is made of letters, digits, _ and -, not '{task.name}'")
    for name in task_names():
        if name != task.name:
            other_id = task_id(name)
            if other_id == task_id(task.name):
                raise InputError(
                    f"the task '{name}' is {other_id} already; give '{task.name}' another name"
                )
    note_registering()
    _REGISTERED[task.name] = task
    for listener in _LISTENERS:
        listener(task)
    return task


def task_id(name: str) -> str:
    """Return what Gymnasium and PettingZoo call a task: ``craftsim/LongStrip-v0`` is ``long_strip``."""
    return f"craftsim/{''.join(word.capitalize() for word in name.split('_'))}-v0"


def on_registration(listener: Callable[[Task], None]) -> None:
    """Call a function with each registered task, now and from now on."""
    _LISTENERS.append(listener)
    for task in _REGISTERED.values():
        listener(task)


def task_names() -> list[str]:
    """Return the names of all tasks that are known by name."""
    return [*TASK_NAMES, *VARIED_NAMES, *_REGISTERED]


def as_task(
    task: Task | str,
    n_cars: int | None = None,
    n_blocks: int | None = None,
    area: tuple[int, ...] | None = None,
) -> Task:
    """Return a task as it is, or the one that a text on the command line or in Python stands for.

    It may import code: a text that was read from a file is for :func:`known_task`.

    Args:
        task: a Task, what :func:`known_task` takes, or ``module:factory``, a callable without arguments that returns a
            Task; the module may lie in the working folder. Or the name that an installed package gives one of its own,
            an entry point of the group ``craftsim.tasks``.
        n_cars: other than the start file's number of cars; those that it does not list are drawn at random.
        n_blocks: the same for blocks.
        area: (length, width) or (length, width, height) in cells, of a task that varies.

    Raises InputError as :func:`known_task` does, for a factory that raises, and for counts and an area for a Task and
    a factory, which have their own.
    """
    if not isinstance(task, Task | str):
        raise InputError(
            f"a task is a Task, the name of one, a file or module:factory, not {task!r}"
        )
    if isinstance(task, str):
        return _look_up(task, True, n_cars, n_blocks, area)
    if (n_cars, n_blocks, area) != (None, None, None):
        raise InputError(_FIXED.format(f"the task '{task.name}'"))
    return task


def known_task(
    text: str,
    n_cars: int | None = None,
    n_blocks: int | None = None,
    area: tuple[int, ...] | None = None,
) -> Task:
    """Return the task that a text in a file stands for; nothing is imported for it.

    ``text`` is a name (one of the paper's six, one of those that vary, with ``@test`` for its held-out starts, or a
    registered one), or a file (a blueprint or a task file, ``.yaml``); the others are as in :func:`as_task`.

    Raises InputError for a text that stands for nothing, ``module:factory`` included, a file that is wrong, counts for
    a registered task, which has its own, and an area for any but a task that varies.
    """
    if len(text) > _LONGEST:
        raise InputError(
            f"task '{text[:40]}...': a name of {len(text)} characters; allowed: at most {_LONGEST}"
        )
    return _look_up(text, False, n_cars, n_blocks, area)


def _look_up(
    text: str,
    may_import: bool,
    n_cars: int | None,
    n_blocks: int | None,
    area: tuple[int, ...] | None,
) -> Task:
    """Return the task of a name, a file or, where code may be imported, ``module:factory``."""
    name, _, split = text.partition("@")
    names = ", ".join(task_names())
    is_code = ":" in text and not is_file(text)
    if is_code and not may_import:
        raise InputError(
            f"task '{text}': module:factory is code, which is imported where the command line or Python names it, "
            f"never where a file does; allowed: {names}, a file .yaml"
        )
    fixed = name in LARGE_NAMES or is_code or text in _REGISTERED
    if fixed and (n_cars, n_blocks, area) != (None, None, None):
        raise InputError(_FIXED.format(f"task '{text}'"))
    if name in LARGE_NAMES:
        return large_task(name, cast(Split, split or "train"))
    if name in VARIED_NAMES:
        # The generator's room is above this one, as those are that factories of one's own lie in.
        varied: Any = random_task
        arguments: list[Any] = [name.removeprefix(RANDOM_PREFIX), split or "train"]
        if name == DESIGNS:
            varied = importlib.import_module("craftsim.designs.tasks").designs_task
            arguments = arguments[1:]
        task: Task = varied(*arguments, n_cars=n_cars, n_blocks=n_blocks, area=area)
        return task
    if is_code:
        return _factory_task(text)
    if text in _REGISTERED:
        return _REGISTERED[text]
    if area is not None:
        raise InputError(
            f"task '{text}' has its own area; only those that vary take one: {', '.join(VARIED_NAMES)}"
        )
    if text in TASK_NAMES:
        return make_task(text, n_cars=n_cars, n_blocks=n_blocks)
    if is_file(text) or text.endswith((".yaml", ".yml")):
        return read_task(text, n_cars, n_blocks)
    installed = {}
    if may_import:
        installed = plug_ins("tasks")
    if text in installed:
        if (n_cars, n_blocks) != (None, None):
            raise InputError(_FIXED.format(f"task '{text}'"))
        return _factory_task(installed[text])
    if Path(text).is_dir():
        raise InputError(f"'{text}' is a folder; give a file .yaml, or one of the tasks {names}")
    if "/" in text:
        raise InputError(f"{text}: no such file or folder")
    hint = suggestion(text[:80], [*task_names(), *installed])
    names = ", ".join([*task_names(), *installed])
    if may_import:
        code_hint = ", or module:factory"
    else:
        code_hint = ""
    raise InputError(f"unknown task '{text}'{hint}; there are {names}, a file .yaml{code_hint}")


def _factory_task(text: str) -> Task:
    """Return the task that ``module:factory`` makes."""
    value = find_named(text, f"task '{text}'", "module:factory, such as mypackage.tasks:corner")
    if isinstance(value, Task):
        return value
    if not callable(value):
        kind = type(value).__name__
        raise InputError(
            f"task '{text}': '{text.partition(':')[2]}' is neither a Task nor callable, but {kind}"
        )
    try:
        task = value()
    except CraftsimError:
        raise
    except (Exception, SystemExit) as error:
        raise InputError(
            f"task '{text}': the factory raised {type(error).__name__}: {error}"
        ) from error
    if not isinstance(task, Task):
        raise InputError(f"task '{text}': returned {type(task).__name__}; it must return a Task")
    return task


def read_task(path: str | Path, n_cars: int | None = None, n_blocks: int | None = None) -> Task:
    """Return the task of a blueprint or of a task file.

    A blueprint ``mine.yaml`` has the design in ``mine_goal.yaml`` beside it as its goal. Without one, the goal is to
    bring its flag to its goal cell if it has both; else there is none, unless a task file says ``goal: platform``.

    Raises BlueprintError with file, line and key, also for a key that would have no effect, and for a count that the
    file gives and an argument gives otherwise.
    """
    path = Path(path)
    document = read_world(path)
    design: Design | None = None
    if not _OF_TASKS & document.plain.keys():
        file = _File(start=None)
        starts = [blueprint_of(document).with_counts(n_cars, n_blocks)]
        goal_path = path.with_name(f"{path.stem}_goal{path.suffix}")
        if is_file(goal_path):
            design = read_design(goal_path)
    else:
        file = document.to(_File)
        cars = _count(document, "cars", file.cars, n_cars)
        blocks = _count(document, "blocks", file.blocks, n_blocks)
        if isinstance(file.start, list):
            named = file.start
        else:
            named = [file.start]
        if not named:
            document.fail(("start",), "key 'start': needs at least one start file")
        places = [_file_named(document, start_name, "start", "blueprints") for start_name in named]
        starts = [read_blueprint(place).with_counts(cars, blocks) for place in places]
        if "goal" in document.plain and file.goal != PLATFORM:
            design = read_design(_file_named(document, file.goal, "goal", "goals"))
    name = writable(path.stem)
    reward = _reward(document, file.reward)
    max_steps = DEFAULT_MAX_STEPS if file.max_steps is None else file.max_steps
    if design is not None:
        goal = "built"
    elif file.goal == PLATFORM:
        goal = "one_platform"
    elif all(start.goal is not None and start.listed(Kind.FLAG) for start in starts):
        goal = "flag_at_goal"
    else:
        for reward_name in reward:
            if reward_name in REWARDS:
                document.fail(
                    ("reward",),
                    f"key 'reward': {reward_name} is of a goal, and there is none; allowed: terms such as "
                    f"{WITHOUT_GOAL}, or with it the key 'goal', a goal file or {PLATFORM}",
                )
        return free_play(name, tuple(starts), max_steps, reward or WITHOUT_GOAL)
    return build_task(name, tuple(starts), goal, reward or "paper", max_steps, design)


def _reward(document: Document, value: Any) -> dict[str, float]:
    """Return the weights of a task file's reward by name, none where the file has no reward."""
    if value is None:
        return {}
    if isinstance(value, str):
        value = {value: 1.0}
    if not isinstance(value, dict) or not 0 < len(value) <= _MOST_TERMS:
        document.fail(
            ("reward",),
            "key 'reward': must be a name, or names with their weights, such as {paper: 1, tick: -0.1}; allowed: 1 to "
            f"{_MOST_TERMS}",
        )
    names = [*REWARDS, *TERMS]
    for name, weight in value.items():
        if name not in names:
            hint = suggestion(str(name)[:_LONGEST], names)
            document.fail(
                ("reward",),
                f"key 'reward': unknown value '{str(name)[:80]}'{hint}; there are {', '.join(names)}",
            )
        number = isinstance(weight, int | float) and not isinstance(weight, bool)
        if not number or not abs(weight) <= _LARGEST_WEIGHT:
            document.fail(
                ("reward", name),
                f"key 'reward.{name}': must be a number, allowed: -{_LARGEST_WEIGHT:g} to {_LARGEST_WEIGHT:g}",
            )
    return {name: float(weight) for name, weight in value.items()}


def _count(document: Document, key: str, in_file: int | None, argument: int | None) -> int | None:
    """Return a count of a task file, or of an argument; raise the document's error where they differ."""
    if in_file is None:
        return argument
    if argument not in (None, in_file):
        document.fail(
            (key,), f"key '{key}': {in_file}, but {argument} asked for; give it in one place"
        )
    return in_file


def _file_named(document: Document, name: Any, key: str, shelf: Shelf) -> Path:
    """Return the file that a value names: one beside the task file, or a shipped one."""
    if not isinstance(name, str) or not name:
        document.fail(
            (key,), f"key '{key}': must be a file beside this one, or the name of a shipped one"
        )
    file = document.path.parent / name
    if is_file(file):
        return file
    return find_file(name, shelf)
