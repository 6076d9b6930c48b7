"""A study: training runs of tasks, algorithms and seeds, and how each is evaluated. Read from a YAML file.

Each run has a folder of its own, and goes on where it was cut off.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from craftsim.errors import InputError, suggestion
from craftsim.experiments.experiment import Experiment, Result, RunOptions, Trial, TrialRecord
from craftsim.experiments.session import RUN_ALONE, run_experiment
from craftsim.learning.algorithms import AlgoName
from craftsim.learning.config import LEARNED, Protocol, TrainConfig, protocol
from craftsim.learning.curve import CURVE_FILE, last_point
from craftsim.learning.policy_files import policy_file
from craftsim.learning.ranges import TRAIN_EPISODES, TRAIN_STEPS
from craftsim.learning.settings import PresetName
from craftsim.learning.shape import Shape, check_stage
from craftsim.learning.starts import check_guidance
from craftsim.storage.folders import directory_within, owned
from craftsim.storage.limits import SHARE, TITLE_CHARACTERS, Range
from craftsim.storage.paths import exists
from craftsim.storage.records import from_json, record
from craftsim.storage.yaml import read_document
from craftsim.tasks import Task, known_task

RUNS_FOLDER: Final = "runs"
"""Folder of the runs in that of a study."""
SHIPPED_STUDIES: Final = Path(__file__).parents[1] / "data" / "studies"
_SETTLED: Final = ("task", "algo", "seed")
"""Fields of a training configuration that a study does not set."""
_SEEDS: Final = Range(1, 1000)
_TASKS: Final = Range(1, 100)
_RUNS: Final = Range(1, 10_000)
"""Tasks times algorithms times seeds."""
_NAME_CHARACTERS: Final = 80
"""Of a run's folder."""


@dataclass(frozen=True)
class StudyRun:
    """One training run, and what it is evaluated on. Workers are sent the tasks: names are looked up once, before."""

    config: TrainConfig
    task: Task
    stages: tuple[Task, ...]
    steps: int
    until: float
    tests: Mapping[str, Task]  # by what the study calls them
    episodes: int

    @property
    def key(self) -> str:
        """Its name in the study, and that of its folder, which lies in the study's whatever a task is called."""
        return f"{_folder_name(self.task)}/{self.config.algo}/{self.config.seed}"


def _folder_name(task: Task) -> str:
    return re.sub(r"[^\w.-]+", "-", task.name).lstrip(".")[:_NAME_CHARACTERS] or "task"


_Score = Literal["final", "last_fifth"]
_AtLeastOne = Annotated[tuple[str, ...], Field(min_length=1)]


@record(kw_only=True)
class Threshold:
    """From which mean return on an evaluation counts, and in which last share of a run."""

    mean_return: Annotated[float, Range(-1e6, 1e6)]
    last: Annotated[float, SHARE]


@record(kw_only=True)
class Study:
    """Training runs of every task by every algorithm with every seed. Raises InputError for what does not fit."""

    title: Annotated[str, Field(max_length=TITLE_CHARACTERS)]
    tasks: _AtLeastOne
    algos: Annotated[tuple[AlgoName, ...], Field(min_length=1)] = ("ippo",)
    seeds: Annotated[int, _SEEDS] = 5  # how many; training takes those from 0 on
    steps: Annotated[int, TRAIN_STEPS] | None = None
    """At most, of each run, exploration aside; 1,000,000 unless given, or what the preset says."""
    until: Annotated[float, SHARE] | None = None
    """A run ends when this share of the episodes of an evaluation succeeds; 0.99 unless given, never with a preset."""
    score: _Score = "final"
    """What a run is judged by: its evaluation after training, or the mean over the last fifth of its curve."""
    episodes: Annotated[int, TRAIN_EPISODES] = 1000  # of each evaluation after training
    preset: PresetName | None = None
    settings: Mapping[str, Any] = field(
        default_factory=dict
    )  # of all runs, as in a training configuration
    of_tasks: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Of the runs of a task, on top; ``steps`` too."""
    tests: Mapping[str, _AtLeastOne] = field(default_factory=dict)
    """By task: which are played after training on it; itself unless given."""
    reference: Mapping[str, Mapping[AlgoName, Annotated[float, SHARE]]] = field(
        default_factory=dict
    )
    """By task and algorithm: the published success rate of that algorithm, to stand beside."""
    thresholds: Mapping[str, Threshold] = field(default_factory=dict)
    """By task: what CraftEnv's authors count as success, in the reward of their code."""

    def __post_init__(self) -> None:
        self._check_counts()
        by_task = {
            "of_tasks": self.of_tasks,
            "tests": self.tests,
            "reference": self.reference,
            "thresholds": self.thresholds,
        }
        for key, group in by_task.items():
            for task in group:
                if task not in self.tasks:
                    hint = suggestion(task[:80], self.tasks)
                    raise ValueError(f"key '{key}.{task[:40]}': no task of the study{hint}")
        layers = {
            "settings": self.settings,
            **{f"of_tasks.{task}": task_layer for task, task_layer in self.of_tasks.items()},
        }
        for prefix, layer in layers.items():
            for key in (*_SETTLED, *(["steps"] if prefix == "settings" else [])):
                if key in layer:
                    raise ValueError(
                        f"key '{prefix[:60]}.{key}': the study says that itself; leave it out"
                    )
        self._check_runs()

    def _check_counts(self) -> None:
        """Refuse what is too much, or given twice, before anything is made of it."""
        _RUNS.check(
            f"runs, {len(self.tasks)} tasks x {len(self.algos)} algorithms x {self.seeds} seeds,",
            len(self.tasks) * len(self.algos) * self.seeds,
        )
        lists = {"tasks": self.tasks, "algos": self.algos}
        for key, names in {
            **lists,
            **{f"tests.{task}": names for task, names in self.tests.items()},
        }.items():
            ((name, times),) = Counter(names).most_common(1)
            if times > 1:
                raise ValueError(
                    f"key '{key[:40]}': '{name[:40]}' is given {times} times; give each once"
                )
        _TASKS.check(
            "tasks that are trained on or played", len({*self.tasks}.union(*self.tests.values()))
        )

    def _check_runs(self) -> None:
        """Refuse tasks of one name, and what would fail when a run begins, or only once it has been trained."""
        names: dict[str, str] = {}
        for run in (run for run in self.runs if run.config.seed == 0):
            called = run.config.task
            folder = _folder_name(run.task)
            if names.setdefault(folder, called) != called:
                raise ValueError(
                    f"tasks '{names[folder]}' and '{called}' are both called '{folder}'; rename one"
                )
            check_guidance(run.config, run.task, None)
            pretrained = run.config.pretrained
            if pretrained and not exists(policy_file(pretrained)):
                raise ValueError(
                    f"key 'pretrained': no policy '{pretrained}'; allowed: a file, a folder, a shipped one"
                )
            shape = Shape.of(run.task, run.config.width, run.config.network)
            for stage in run.stages:
                check_stage(stage, shape)
            for task in (run.task, *run.tests.values()):
                if not task.has_goal:
                    raise ValueError(f"task '{task.name}' has no goal to learn")
                size = task.starts[0].size
                n_cars = task.layout.n_cars
                if shape.size != size or (shape.network != "relative" and shape.n_cars != n_cars):
                    raise ValueError(
                        f"key 'tests.{called}': '{task.name}' has {n_cars} cars in an area of {size}, the network "
                        f"of '{called}' is for {shape}; it serves areas of one size, and unless it is relative, one "
                        "number of cars"
                    )

    @property
    def goal(self) -> float:
        """The success rate that counts as learned."""
        return LEARNED if self.until is None else self.until

    @cached_property
    def runs(self) -> list[StudyRun]:
        """All runs."""
        find_task = cache(known_task)
        runs = []
        for task in self.tasks:
            for algo in self.algos:
                config = self._config(task, algo)
                tasks = {}
                for name in (task, *config.stages, *self._tests(task)):
                    tasks[name] = config.find_task(name, find_task)
                stages = tuple(tasks[name] for name in config.stages)
                tests = {name: tasks[name] for name in self._tests(task)}
                if self.preset:
                    run = self._protocol(self.preset, task, algo)
                else:
                    run = Protocol()
                steps = self._steps(task) or run.steps
                until = run.until if self.until is None else self.until
                for seed in range(self.seeds):
                    runs.append(
                        StudyRun(
                            replace(config, seed=seed),
                            tasks[task],
                            stages,
                            steps,
                            until,
                            tests,
                            self.episodes,
                        )
                    )
        return runs

    def _steps(self, task: str) -> int | None:
        """Return the length that was asked for, of a task's runs."""
        steps = self.of_tasks.get(task, {}).get("steps", self.steps)
        if steps is not None:
            if not isinstance(steps, int):
                raise ValueError(
                    f"key 'of_tasks.{task}.steps': must be an integer, not {str(steps)[:40]!r}"
                )
            TRAIN_STEPS.check(f"key 'of_tasks.{task}.steps'", steps)
        return steps

    def _protocol(self, preset: PresetName, task: str, algo: AlgoName) -> Protocol:
        """Return the preset of a task's runs, which may depend on how long its episodes are."""
        settings = {**self.settings, **self.of_tasks.get(task, {})}
        max_steps = settings.get("max_steps")
        if not isinstance(max_steps, int):
            max_steps = None  # what is no number is refused with the configuration
        return protocol(preset, task, algo, self._steps(task), max_steps)

    def _tests(self, task: str) -> tuple[str, ...]:
        return self.tests.get(task, (task,))

    def _config(self, task: str, algo: AlgoName) -> TrainConfig:
        """Return the configuration of a task's runs, the first seed's."""
        values: dict[str, Any] = {"hyperparameters": {}}
        preset = self._protocol(self.preset, task, algo).settings if self.preset else {}
        for layer in (preset, self.settings, self.of_tasks.get(task, {})):
            before = values["hyperparameters"]
            values |= layer
            hyperparameters = values["hyperparameters"]
            if isinstance(hyperparameters, Mapping):
                values["hyperparameters"] = {**before, **hyperparameters}
        values.pop("steps", None)
        text = json.dumps({"task": task, "algo": algo, **values}, default=str)
        return from_json(TrainConfig, text.encode(), f"settings of '{task}' by {algo}")


def read_study(text: str) -> Study:
    """Return the study of a file, or a shipped one by name; raises InputError with file and key."""
    names = sorted(path.stem for path in SHIPPED_STUDIES.glob("*.yaml"))
    if not exists(text) or (text in names and Path(text).is_dir()):
        if text not in names:
            raise InputError(
                f"no study '{text}'{suggestion(text[:80], names)}; there are {', '.join(names)}, and files"
            )
        text = str(SHIPPED_STUDIES / f"{text}.yaml")
    path = Path(text)
    return read_document(path).to(Study)


def run_study(
    study: Study, out: Path, options: RunOptions = RUN_ALONE, timeout_s: float = 7200.0
) -> list[TrialRecord]:
    """Do all runs of a study and return a record of each, in the order of its runs.

    A record's ``extra`` holds steps, CPU seconds of training in all calls that it took, the learning curve and, by
    task, what evaluations came to. A run that fails is a record with an error. Of a cut-off study what is finished is
    kept, and a run that was under way goes on from its last evaluation.

    Args:
        study: what to do.
        out: folder for the session and a folder of each run; a Ray cluster shares it.
        options: how.
        timeout_s: after which a run counts as hanging.

    Raises InputError where the folder holds another study.
    """
    runs = study.runs
    folder = out.resolve()
    items = []
    for run in runs:
        items.append(
            Trial(run.key, f"{run.config.task}, {run.config.algo}", run.config.seed, (run, folder))
        )
    digests = {}
    for run in runs:
        for name, task in {run.config.task: run.task, **run.tests}.items():
            digests[name] = task.digest
    config = {"study": asdict(study), "digests": digests}
    experiment = Experiment("study", 0, config, items, train_and_evaluate, timeout_s=timeout_s)
    return list(run_experiment(experiment, out, options))


def under_way(study: Study, out: Path, since_s: float) -> list[str]:
    """Return how far each unfinished training run is that was evaluated after a time of the clock, a line each.

    A run that was saved before its first evaluation has none, and a file that is no curve has one that says so.
    """
    lines = []
    for run in study.runs:
        path = out / RUNS_FOLDER / run.key / CURVE_FILE
        try:
            if path.stat().st_mtime < since_s:
                continue
        except OSError:
            continue  # nothing is saved yet
        try:
            last = last_point(path)
        except InputError as error:
            lines.append(f"{run.key}: {error}")
            continue
        if (
            last is not None
            and last.steps < run.steps
            and last.successes < run.until * last.episodes
        ):
            so_far = f"{last.steps:,} of at most {run.steps:,} steps"
            lines.append(
                f"{run.key}: {so_far}, {last.successes} of {last.episodes} episodes succeed"
            )
    return lines


def train_and_evaluate(job: tuple[StudyRun, Path]) -> Result:
    """Train, or go on training, and evaluate; what a worker does of a study."""
    import torch

    from craftsim.learning.checkpoint import RUN_FILE
    from craftsim.learning.evaluation import evaluate_as_trained
    from craftsim.learning.trainer import Trainer

    run, out = job
    config = run.config
    torch.set_num_threads(1)
    tasks: dict[str, Any] = {"task": run.task, "stages": run.stages}
    # Its own folder too: somebody may go on with this run alone.
    with owned(directory_within(out, RUNS_FOLDER, run.key)) as place, ExitStack() as closing:
        resumed = (place / RUN_FILE).exists()
        if resumed:
            trainer = Trainer.resume(place, config=config, **tasks)
        else:
            trainer = Trainer(config, **tasks)
        closing.callback(trainer.close)
        trainer.prepare(place)
        for _ in trainer.run_and_save(place, run.steps, run.until):
            pass
        extra: dict[str, Any] = {
            "steps": trainer.steps,
            "cpu_s": round(trainer.cpu_s, 1),
            "resumed": resumed,
            "curve": [asdict(point) for point in trainer.curve],
            "evaluations": {
                name: evaluate_as_trained(
                    config, trainer.learner.net, task, run.episodes, 1
                ).as_figures()
                for name, task in run.tests.items()
            },
        }
    success = extra["evaluations"][next(iter(run.tests))]["success"]["rate"]
    return Result(agrees=success >= min(run.until, LEARNED), extra=extra)
