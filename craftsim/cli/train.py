"""Train a policy, or over tasks, algorithms and seeds: ``craftsim train`` and ``train study``."""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Parameter

from craftsim.cli.app import FOLDER
from craftsim.cli.options import Dir, OptionalDir, RecordChoice, Shown
from craftsim.cli.progress import counting, print_regularly, progress_of
from craftsim.cli.text import print_safe
from craftsim.cli.train_options import (
    Algo,
    Exploration,
    Hyperparameters,
    Learning,
    LearningDevice,
    SettingsFile,
    TrackerName,
    TrainingPhysics,
    check_read,
    chosen_values,
)
from craftsim.errors import InputError
from craftsim.learning.algorithms import AlgoName
from craftsim.learning.ranges import TRAIN_EPISODES, TRAIN_STEPS
from craftsim.learning.settings import BackendChoice, PresetName
from craftsim.reports.publishing import publish
from craftsim.reports.report import Drawing, Headline, KeyFigure, Report, Section, Tone, count
from craftsim.storage.folders import output_directory, owned, owning
from craftsim.storage.limits import SHARE, TIMEOUT_S
from craftsim.validation.options import Seeded, Work, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from craftsim.learning.config import Protocol, TrainConfig
    from craftsim.learning.curve import TrackedCurve
    from craftsim.learning.trainer import Trainer
    from craftsim.tasks import Task

_INTERRUPTED: Final = 130
LINE_EVERY_S: Final = 15.0
"""How often a run says how far it is where there is no terminal for a bar."""
_STUDY_EVERY_S: Final = 60.0
"""How often a study says how far its runs are."""


def train(
    task: Annotated[str, Parameter(metavar="TASK")] = "strip",
    *,
    algo: Algo = "ippo",
    chance: Seeded = Seeded(),  # noqa: B008
    steps: Annotated[int | None, number(TRAIN_STEPS)] = None,
    until: Annotated[float | None, number(SHARE)] = None,
    backend: BackendChoice = "grid",
    preset: PresetName | None = None,
    learning: Learning = Learning(),  # noqa: B008
    exploration: Exploration = Exploration(),  # noqa: B008
    physics: TrainingPhysics = TrainingPhysics(),  # noqa: B008
    hyperparameters: Hyperparameters = Hyperparameters(),  # noqa: B008
    settings: SettingsFile = None,
    device: LearningDevice = None,
    tracker: TrackerName = None,
    episodes: Annotated[int, number(TRAIN_EPISODES)] = 1000,
    record: RecordChoice = "none",
    resume: Shown = False,
    out: OptionalDir = None,
) -> int:
    """Train a policy on the grid or in physics, and evaluate it on fresh episodes.

    Ctrl-C, SIGTERM and SIGHUP save everything after the current iteration; --resume continues bit for bit. Exit status:
    0 if training ended by itself, 130 if interrupted, 2 for invalid input.

    Args:
        task: name of a task, such as strip or random_strip, a task file, or module:factory.
        steps: maximum number of ticks over all worlds; default: 3,000,000, or that of the preset.
        until: stop when an evaluation reaches this success rate; default: 0.99, with a preset never.
        backend: where to train and evaluate.
        preset: paper is the protocol of CraftEnv's paper: published rules, action helper of depth 20, the task's own
            starts, no demonstrations, 20 episodes every 10,000 steps, no early stop; paper_plus adds random exploration
            before; fork is the learner that was released with it, of iql, vdn and qmix, setting by setting.
        episodes: number of episodes of the final evaluation.
        record: write the trajectories of the final evaluation, in physics only.
        resume: continue the run in the output folder, with the same options; start it if nothing is saved yet.
        out: folder for policy.safetensors, run.safetensors, curve.csv, curve.png and report.json; default:
            out/train/TASK-ALGO.
    """
    from craftsim.learning.policy import need_torch

    need_torch()
    from craftsim.learning.config import Protocol, TrainConfig, protocol
    from craftsim.learning.curve import TrackedCurve
    from craftsim.rendering.trajectory import TRAJECTORIES
    from craftsim.tasks import as_task

    if backend == "grid":
        for_physics = chosen_values(physics)
        if record != "none":
            for_physics["record"] = record
        for name in for_physics:
            raise InputError(f"{name} is for physics; on the grid nothing moves: leave it out")
    run = Protocol(steps=steps or 3_000_000)
    if preset is not None:
        run = protocol(preset, task, algo, steps, learning.max_steps)
        if exploration.imitate or exploration.pretrained or exploration.starts is not None:
            raise InputError(
                "a --preset learns from nothing; leave starts, imitate and pretrained out"
            )
    if until is None:
        until = run.until
    values = _values(run, algo, learning, exploration, physics, hyperparameters, settings)
    try:
        config = TrainConfig(task=task, algo=algo, seed=chance.seed, backend=backend, **values)
    except InputError as error:
        raise InputError(
            str(error).replace("TrainConfig.", "--").removeprefix("TrainConfig: ")
        ) from None
    task_of_run = config.find_task(task, as_task)
    if not task_of_run.has_goal:
        raise InputError(
            f"task '{task_of_run.name}' has no goal to learn: put a {task_of_run.name}_goal.yaml beside its blueprint, "
            "or name one in a task file (docs/reference/tasks.md)"
        )
    names = ("workers", "engine")
    shared = {name: value for name, value in chosen_values(physics).items() if name in names}
    if device is not None:
        shared["device"] = device
    staged = [config.find_task(name, as_task) for name in config.stages]
    folder = out or Path("out/train") / re.sub(r"[^\w.-]+", "-", f"{task_of_run.name}-{algo}")
    FOLDER.set(output_directory(folder))

    import torch

    # One thread adds numbers up in one order, so that a run can be repeated bit for bit.
    torch.set_num_threads(1)
    start_s = time.perf_counter()
    with (
        owned(folder),
        closing(
            _trainer(config, task_of_run, staged, exploration.starts, folder, resume, shared)
        ) as trainer,
    ):
        try:
            tracked = None
            if tracker is not None:
                tracked = TrackedCurve(tracker, folder, trainer.curve)
            trainer.prepare(folder)  # shows progress of its own
            _run(trainer, run.steps, until, folder, tracked)
            reported = config.as_dict() | {
                "steps": run.steps,
                "until": until,
                "starts": exploration.starts,
                "episodes": episodes,
                "task_digest": trainer.task.digest,
                "starts_digest": trainer.starts,
                "pretrained_digest": trainer.pretrained,
            }
            if record == "trajectory":
                trajectories = folder / TRAJECTORIES
            else:
                trajectories = None
            return _evaluate(trainer, folder, reported, time.perf_counter() - start_s, trajectories)
        except KeyboardInterrupt:
            print_safe(_interrupted(trainer, folder))
            return _INTERRUPTED


def _values(
    run: Protocol,
    algo: AlgoName,
    learning: Learning,
    exploration: Exploration,
    physics: TrainingPhysics,
    hyperparameters: Hyperparameters,
    settings: Path | None,
) -> dict[str, Any]:
    """Return the fields of a configuration: those of the preset, of the file of settings, and of the options."""
    from craftsim.learning.config import TrainConfig, read_settings

    values = dict(run.settings)
    chosen = dict(values.get("hyperparameters", {}))
    if settings is not None:
        chosen |= read_settings(settings, algo)
    check_read(chosen_values(hyperparameters), algo)
    chosen |= chosen_values(hyperparameters)
    options = chosen_values(learning) | chosen_values(exploration) | chosen_values(physics)
    names = {field.name for field in fields(TrainConfig)}
    values |= {name: value for name, value in options.items() if name in names}
    return values | {"hyperparameters": chosen}


def _interrupted(trainer: Trainer, folder: Path) -> str:
    """Save a run that is interrupted, unless within an iteration; return the message."""
    from craftsim.learning.checkpoint import RUN_FILE
    from craftsim.learning.policy_files import POLICY_FILE

    if trainer.under_way and not (folder / RUN_FILE).exists():
        return "Interrupted twice, in the first iteration: nothing is saved."
    if trainer.under_way:
        return f"Interrupted twice, within an iteration; --resume goes on from what was saved before in {folder}."
    trainer.save(folder)
    return f"Interrupted; --resume goes on. Policy: {folder / POLICY_FILE}"


def _trainer(
    config: TrainConfig,
    task: Task,
    stages: Sequence[Task],
    starts: Path | None,
    folder: Path,
    resume: bool,
    shared: dict[str, Any],
) -> Trainer:
    """Return the trainer of a new run, or of one that is resumed. Raises InputError for a folder that holds a run."""
    from craftsim.learning.checkpoint import RUN_FILE
    from craftsim.learning.policy_files import POLICY_FILE
    from craftsim.learning.starts import with_starts
    from craftsim.learning.trainer import Trainer

    options: dict[str, Any] = {
        "task": task,
        "stages": stages,
        "progress": counting("plans", bool),
        **shared,
    }
    task_of_starts = None
    if starts:
        task_of_starts = with_starts(task, starts, config.rules)
    holds_run = (folder / RUN_FILE).exists()
    if holds_run and resume:
        return Trainer.resume(folder, task_of_starts, config, **options)
    if holds_run:
        raise InputError(
            f"{folder} holds a run already; --resume goes on with it, or choose another --out"
        )
    if (folder / POLICY_FILE).exists():
        raise InputError(
            f"{folder} holds a {POLICY_FILE}, but no {RUN_FILE}, from which a run goes on; put that back, or choose "
            f"another --out (--pretrained {folder} begins with this policy)"
        )
    if resume:
        # As with a campaign: what was cut off before anything was kept begins again.
        print_safe(f"Nothing is saved in {folder} yet: the run begins.")
    return Trainer(config, task_of_starts, **options)


def _run(
    trainer: Trainer, steps: int, until: float, folder: Path, tracked: TrackedCurve | None
) -> None:
    """Train, show how it goes, and save after each evaluation."""
    name = f"{trainer.task.name}, {trainer.config.algo}"
    first_step = trainer.steps
    start_s = time.perf_counter()
    success = "-"
    mean_return = "-"
    with progress_of(name, steps, LINE_EVERY_S, first_step) as tell:
        for evaluated in trainer.run_and_save(folder, steps, until):
            if evaluated:
                point = trainer.curve[-1]
                success = f"{point.success:.2f}"
                mean_return = f"{point.mean_return:.2f}"
                if tracked is not None:
                    tracked.add(point)
            rate = (trainer.steps - first_step) / (time.perf_counter() - start_s)
            state = f"success {success}, return {mean_return}, {rate:,.0f} steps/s"
            tell(trainer.steps, state, f"{trainer.steps:,} of at most {steps:,} steps, {state}")


def _evaluate(
    trainer: Trainer,
    folder: Path,
    config_of_run: dict[str, Any],
    seconds: float,
    record: Path | None,
) -> int:
    """Evaluate what was learned on fresh episodes, and report it."""
    from craftsim.learning.config import LEARNED
    from craftsim.learning.curve import last_fifth, plot_curve
    from craftsim.learning.trainer import training_versions
    from craftsim.reports.json_file import document
    from craftsim.reports.plots import ACCENT, percent_ticks

    config = trainer.config
    curve = trainer.curve
    name = f"{trainer.task.name}, {config.algo}"
    evaluation = trainer.evaluate(config_of_run["episodes"], record=record)
    plot_curve(folder / "curve.png", f"{name}, seed {config.seed}", curve)
    figures: dict[str, Any] = {
        "steps": trainer.steps,
        **evaluation.as_figures(),
        "learning_curve": curve,
        "last_fifth": last_fifth([point.success for point in curve]),
        "training_versions": training_versions(),
    }
    wall = {
        "training_s": trainer.wall_s,
        "training_cpu_s": trainer.cpu_s,
        "this_call_s": seconds,
    }
    sentence = (
        f"{name}: {evaluation.in_words}, {evaluation.mean_ticks:.1f} ticks, after {trainer.steps:,} steps in "
        f"{trainer.wall_s:.0f} s."
    )
    starts = f"{evaluation.solved:,} of {count(evaluation.starts, 'different start')} solved"
    headline = Headline("Not learned", Tone.CAUTION, sentence)
    if evaluation.success >= min(config_of_run["until"], LEARNED):
        headline = Headline("Learned", Tone.GOOD, sentence)

    def draw(axes: Axes) -> None:
        axes.plot(
            [point.steps for point in curve],
            [point.success for point in curve],
            color=ACCENT,
            lw=1.8,
        )
        axes.set_ylim(-0.02, 1.04)
        axes.yaxis.set_major_formatter(percent_ticks)
        axes.set_xlabel("steps")

    drawing = Drawing.of_axes(
        draw, 2.9, "Success of evaluations during training.", "learning curve"
    )
    lead = "Evaluations on fresh episodes; curve.csv holds all."
    report = Report(
        "Training",
        f"{name}, seed {config.seed}",
        headline,
        [
            KeyFigure(f"{evaluation.success:.3f}", "success", starts),
            KeyFigure(f"{trainer.steps:,}", "steps", f"{trainer.wall_s:.0f} s"),
        ],
        [Section("curve", "Learning curve", lead, [drawing])] if curve else [],
        files={"Policy": folder / "policy.safetensors"},
        document=document(
            figures, command="train", seed=config.seed, config=config_of_run, wall=wall
        ),
    )
    return publish(report, folder)


@owning
def study(
    study: Annotated[str, Parameter(metavar="NAME|FILE")],
    *,
    work: Work = Work(),  # noqa: B008
    timeout: Annotated[float, number(TIMEOUT_S)] = 7200.0,
    out: Dir = Path("out/study"),
) -> int:
    """Train on every task of a study with every algorithm and seed, evaluate, and report statistics.

    Results are over training runs with different seeds: interquartile means with stratified bootstrap intervals,
    learning curves and performance profiles. Repeated episodes count once. Ctrl-C keeps what is finished; --resume
    continues, also within a run. Exit status: 0 if all runs reached the study's success rate, 1 if not, 2 for invalid
    input.

    Args:
        study: a YAML file, or the name of a shipped study such as paper or quick.
        timeout: time limit of a run in seconds.
        out: folder for report.json, study.md, curves.png, profiles.png, trials.jsonl and a folder of each run.
    """
    from craftsim.learning.policy import need_torch

    need_torch()
    from craftsim.learning.study import read_study, run_study, under_way
    from craftsim.learning.study_results import (
        plot_results,
        study_figures,
        study_report,
        write_markdown,
    )
    from craftsim.reports.json_file import document

    plan = read_study(study)
    start_s = time.perf_counter()
    since_s = time.time()
    with print_regularly(lambda: under_way(plan, out, since_s), _STUDY_EVERY_S):
        records = run_study(plan, out, work.run(counting("runs")), timeout)
    figures = study_figures(plan, records)
    write_markdown(out / "study.md", plan, figures)
    pictures = plot_results(out, plan, figures)
    cpu_s = {record["key"]: record["extra"].get("cpu_s") for record in records}
    wall = {"this_call_s": time.perf_counter() - start_s, "cpu_s": cpu_s}
    written = document(
        figures, command="study", seed=0, config={"study": plan, "what": study}, wall=wall
    )
    reached = sum(record["agrees"] for record in records)
    return publish(study_report(plan, reached, written, pictures), out)
