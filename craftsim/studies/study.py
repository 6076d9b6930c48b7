"""What a study is: tasks, algorithms, seeds of training, and how each run is evaluated. Read from a YAML file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Final

from craftsim.discrete.files.documents import Node, Scalar, Sequence, exists, parse_keys, read_text
from craftsim.discrete.tasks import Task, as_task
from craftsim.errors import InputError, suggestion
from craftsim.storage.mistakes import first_mistake
from craftsim.training.config import PRESETS, AlgoName, PresetName, TrainConfig

SHIPPED: Final = Path(__file__).parents[1] / "data" / "studies"
_SETTLED: Final = ("task", "algo", "seed")
SETTINGS: Final = tuple(field.name for field in fields(TrainConfig) if field.name not in _SETTLED)
"""Fields of a training configuration that a study may set."""


@dataclass(frozen=True)
class StudyRun:
    """One training run, and what it is evaluated on."""

    config: TrainConfig
    steps: int
    until: float
    tests: tuple[str, ...]
    episodes: int

    @property
    def key(self) -> str:
        """Its name in the study, and that of its folder."""
        return f"{self.config.task}/{self.config.algo}/{self.config.seed}".replace("@", "-")


@dataclass(frozen=True, kw_only=True)
class Study:
    """Training runs of every task by every algorithm with every seed. Raises InputError for what does not fit."""

    title: str
    tasks: tuple[str, ...]
    algos: tuple[AlgoName, ...] = ("ippo",)
    seeds: int = 5
    """How many; training takes those from 0 on."""
    steps: int = 1_000_000
    """At most, of each run, exploration aside."""
    until: float = 0.99
    """A run ends when this share of the episodes of an evaluation succeeds."""
    episodes: int = 1000
    """Of each evaluation after training."""
    preset: PresetName | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Of all runs, as in a training configuration."""
    of_tasks: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Of the runs of a task, on top; ``steps`` too."""
    tests: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """By task: which are played after training on it; itself unless given."""
    reference: Mapping[str, float] = field(default_factory=dict)
    """By task: a published success rate to stand beside."""

    def __post_init__(self) -> None:
        if not self.tasks or not self.algos:
            raise InputError("a study needs at least one task and one algorithm")
        if not 1 <= self.seeds <= 1000 or not 1 <= self.episodes <= 1_000_000 or self.steps < 1:
            raise InputError(
                f"seeds {self.seeds}, episodes {self.episodes}, steps {self.steps}: each must be 1 or more"
            )
        for name, known in {
            "of_tasks": self.of_tasks,
            "tests": self.tests,
            "reference": self.reference,
        }.items():
            for task in known:
                if task not in self.tasks:
                    raise InputError(
                        f"key '{name}.{task}': no task of the study{suggestion(task, self.tasks)}"
                    )
        for where, given in {"settings": self.settings, **self.of_tasks}.items():
            for key in given:
                if key not in (*SETTINGS, *(() if where == "settings" else ("steps",))):
                    raise InputError(
                        f"key '{where}.{key}': unknown{suggestion(key, SETTINGS)}; there are {', '.join(SETTINGS)}"
                    )
        for run in self.runs:
            for name in (run.config.task, *run.tests):
                _with_goal(name)

    @property
    def runs(self) -> list[StudyRun]:
        """All runs."""
        return [
            self._run(task, algo, seed)
            for task in self.tasks
            for algo in self.algos
            for seed in range(self.seeds)
        ]

    def _run(self, task: str, algo: AlgoName, seed: int) -> StudyRun:
        given = {
            **(PRESETS[self.preset] if self.preset else {}),
            **self.settings,
            **self.of_tasks.get(task, {}),
        }
        steps = int(given.pop("steps", self.steps))
        config = TrainConfig(task=task, algo=algo, seed=seed, **given)
        return StudyRun(config, steps, self.until, self.tests.get(task, (task,)), self.episodes)


def read_study(text: str) -> Study:
    """Return the study of a file, or a shipped one by name; raises InputError with file and key."""
    names = sorted(path.stem for path in SHIPPED.glob("*.yaml"))
    if not exists(text) or (text in names and Path(text).is_dir()):
        if text not in names:
            raise InputError(
                f"no study '{text}'{suggestion(text[:80], names)}; there are {', '.join(names)}, and files"
            )
        text = str(SHIPPED / f"{text}.yaml")
    from pydantic import ConfigDict, TypeAdapter, ValidationError, with_config

    path = Path(text)
    _, keys = parse_keys(path, read_text(path), [field.name for field in fields(Study)])
    adapter = TypeAdapter(with_config(ConfigDict(extra="forbid"))(Study))
    try:
        return adapter.validate_python({key: _plain(node) for key, node in keys.items.items()})
    except ValidationError as error:
        raise InputError(f"{path}: {first_mistake(error)}") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _plain(node: Node) -> Any:
    """Return a node as Python has it; a word stays a text, a number becomes one."""
    if isinstance(node, Scalar):
        for number in () if node.quoted else (int, float):
            try:
                return number(node.text)
            except ValueError:
                continue
        return node.text
    if isinstance(node, Sequence):
        return [_plain(item) for item in node.items]
    return {key: _plain(item) for key, item in node.items.items()}


def _with_goal(name: str) -> Task:
    task = as_task(name)
    if not task.has_goal:
        raise InputError(f"task '{name}' has no goal to learn")
    return task
