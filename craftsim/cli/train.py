"""Train a policy, or over tasks, algorithms and seeds: ``craftsim train`` and ``train study``."""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Parameter

from craftsim.choices import AlgoName, Backend, PresetName
from craftsim.cli.app import FOLDER, setting
from craftsim.cli.progress import counting, progress_of, telling
from craftsim.cli.text import print_safe
from craftsim.errors import InputError, suggestion
from craftsim.options import Dir, OptionalDir, Record, Seeded, Shown, Work, number
from craftsim.reports.report import Drawing, Headline, KeyFigure, Report, Section, Tone, count
from craftsim.storage.folders import output_directory, owned, owning
from craftsim.storage.limits import SHARE, TIMEOUT_S, TRAIN_EPISODES, TRAIN_STEPS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from craftsim.discrete.tasks import Task
    from craftsim.training.config import Protocol, TrainConfig
    from craftsim.training.trainer import Trainer

INTERRUPTED: Final = 130
LINE_EVERY_S: Final = 15.0
"""How often a run says how far it is where there is no terminal for a bar."""
STUDY_EVERY_S: Final = 60.0
"""How often a study says how far its runs are."""
_BESIDES: Final[tuple[str, ...]] = (
    "cars",
    "blocks",
    "starts",
    "settings",
    "workers",
    "engine",
    "device",
    "tensorboard",
)
"""What --set takes besides fields of the configuration and the algorithm's hyperparameters."""


def train(
    task: Annotated[str, Parameter(metavar="TASK")] = "strip",
    *,
    algo: AlgoName = "ippo",
    chance: Seeded = Seeded(),  # noqa: B008
    steps: Annotated[int | None, number(TRAIN_STEPS)] = None,
    until: Annotated[float | None, number(SHARE)] = None,
    backend: Backend = "grid",
    preset: PresetName | None = None,
    settings: Annotated[tuple[str, ...], Parameter(name="--set", metavar="NAME=VALUE")] = (),
    episodes: Annotated[int, number(TRAIN_EPISODES)] = 1000,
    record: Record = "none",
    resume: Shown = False,
    out: OptionalDir = None,
) -> int:
    """Train a policy on the grid or in physics, and evaluate it on fresh episodes.

    Ctrl-C, SIGTERM and SIGHUP save everything after the current iteration; --resume continues bit for bit. Exit status:
    0 if training ended by itself, 130 if interrupted.

    Settings for --set, each as NAME=VALUE, with their defaults: worlds (parallel worlds; 32 in physics; on the grid 500
    for ippo and mappo, 100 for pqn, 25 for the others), network (map, or relative, for any number of cars), recurrent
    (true remembers, for iql, vdn, qmix and qtran; false), width (of the layers; 128), rules (physical), helper_depth
    (search depth of the action helper; none), execution (synchronous, or asynchronous for ippo and mappo on the grid),
    evaluate_every (steps; ten rollouts), evaluation_episodes (500 on the grid, 64 in physics), novelty (exploration
    bonus for new buildings; 0), explore (ticks of random exploration before learning; 0), imitate (number of the
    planner's plans for imitation before learning; 0), shown_share (share of episodes that start along such a plan;
    0.5), starts (a plan or a file of reached worlds for every second episode), pretrained (initial policy), stages
    (easier tasks first, separated by commas), stage_steps (steps on each), acting (greedy, sampled or varied
    evaluation), cars, blocks, max_steps (step limit of an episode; the task's), in physics drive (wheels), randomize
    (none), workers (one per processor) and engine (local, or ray for workers on a Ray cluster), device (of the
    networks: cpu, or cuda), tensorboard (true writes its log), settings (a YAML file of hyperparameters), and every
    hyperparameter of the algorithm, such as learning_rate.

    Args:
        task: name of a task, such as strip or random_strip, a task file, or module:factory.
        algo: independent or multi-agent PPO, COMA, QMIX, QTRAN, VDN, independent Q-learning, or PQN-VDN.
        steps: maximum number of ticks over all worlds; default: 3,000,000, or that of the preset.
        until: stop when an evaluation reaches this success rate; default: 0.99, with a preset never.
        backend: where to train and evaluate.
        preset: paper is the protocol of CraftEnv's paper: published rules, action helper of depth 20, the task's own
            starts, no demonstrations, 20 episodes every 10,000 steps, no early stop; paper_plus adds random exploration
            before.
        settings: other settings, see above.
        episodes: number of episodes of the final evaluation.
        record: write the trajectories of the final evaluation, in physics only.
        resume: continue the run in the output folder, with the same options; start it if nothing is saved yet.
        out: folder for policy.safetensors, run.safetensors, curve.csv, curve.png and report.json; default:
            out/train/TASK-ALGO.
    """
    from craftsim.training.policy import need_torch

    need_torch()
    from craftsim.discrete.tasks import as_task
    from craftsim.envs.options import BatchOptions
    from craftsim.rendering.trajectory import TRAJECTORIES
    from craftsim.training.config import Protocol, protocol

    given = _settings_of(settings)
    besides: dict[str, Any] = {name: given.pop(name) for name in _BESIDES if name in given}
    shared: dict[str, Any] = {name: besides[name] for name in ("workers", "engine") if name in besides}
    try:
        BatchOptions(1, **shared)
    except InputError as error:
        raise InputError(str(error).replace("BatchOptions.", "--set ")) from None
    if backend == "grid":
        physical = {**shared, "drive": given.get("drive"), "randomize": given.get("randomize")}
        for name, value in {**physical, "record": None if record == "none" else record}.items():
            if value is not None:
                raise InputError(f"{name} is for physics; on the grid nothing moves: leave it out")
    run = protocol(preset, task, algo, steps) if preset else Protocol(steps=steps or 3_000_000)
    until = run.until if until is None else until
    config = _config(given, besides, run, task=task, algo=algo, seed=chance.seed, backend=backend)
    learnt = config.find_task(task, as_task)
    if not learnt.has_goal:
        raise InputError(
            f"task '{learnt.name}' has no goal to learn: put a {learnt.name}_goal.yaml beside its blueprint, "
            "or name one in a task file (docs/reference/tasks.md)"
        )
    if "device" in besides:
        shared["device"] = besides["device"]
    staged = [config.find_task(name, as_task) for name in config.stages]
    folder = out or Path("out/train") / re.sub(r"[^\w.-]+", "-", f"{learnt.name}-{algo}")
    reached = Path(str(besides["starts"])) if "starts" in besides else None
    FOLDER.set(output_directory(folder))

    import torch

    # One thread adds numbers up in one order, so that a run can be repeated bit for bit.
    torch.set_num_threads(1)
    begun = time.perf_counter()
    with (
        owned(folder),
        closing(_trainer(config, learnt, staged, reached, folder, resume, shared)) as trainer,
    ):
        try:
            trainer.prepare(folder)  # shows progress of its own
            _run(trainer, run.steps, until, folder, besides.get("tensorboard") in (True, "true"))
            asked = config.as_dict() | {
                "steps": run.steps,
                "until": until,
                "starts": reached,
                "episodes": episodes,
            }
            asked |= {"task_digest": trainer.task.digest, "starts_digest": trainer.starts}
            asked["pretrained_digest"] = trainer.pretrained
            place = folder / TRAJECTORIES if record == "trajectory" else None
            return _evaluate(trainer, folder, asked, time.perf_counter() - begun, place)
        except KeyboardInterrupt:
            print_safe(_interrupted(trainer, folder))
            return INTERRUPTED


def _interrupted(trainer: Trainer, folder: Path) -> str:
    """Save a run that is interrupted, unless within an iteration; return what is said of it."""
    from craftsim.training.checkpoint import RUN_FILE
    from craftsim.training.policy import POLICY_FILE

    if trainer.under_way and not (folder / RUN_FILE).exists():
        return "Interrupted twice, in the first iteration: nothing is saved."
    if trainer.under_way:
        return f"Interrupted twice, within an iteration; --resume goes on from what was saved before in {folder}."
    trainer.save(folder)
    return f"Interrupted; --resume goes on. Policy: {folder / POLICY_FILE}"


def _settings_of(words: Iterable[str]) -> dict[str, Any]:
    """Return the values that words such as ``width=128`` set, by name; several are divided by commas."""
    settings = dict[str, Any]()
    for word in words:
        name, value = setting(word)
        if name in settings:
            raise InputError(f"--set is '{word}'; allowed: NAME=VALUE, each name once")
        settings[name] = value
    return settings


def _config(given: dict[str, Any], besides: dict[str, Any], run: Protocol, **flags: Any) -> TrainConfig:
    """Return the configuration that flags and --set ask for; a preset settles the rest."""
    from craftsim.training.config import KINDS, TrainConfig, read_settings

    if run.settings and ({"imitate", "pretrained"} & {*given} or "starts" in besides):
        raise InputError("a --preset learns from nothing; leave starts, imitate and pretrained out")
    algo = flags["algo"]
    named = {field.name for field in fields(TrainConfig)} - {*flags, "n_cars", "n_blocks", "hyperparameters"}
    own = {field.name for field in fields(KINDS[algo])}
    if strange := [name for name in given if name not in named | own]:
        known = sorted(named | own | {*_BESIDES})
        hint = suggestion(strange[0], known)
        raise InputError(f"--set: no setting '{strange[0]}' of {algo}{hint} (settings: {', '.join(known)})")
    chosen = {name: value for name, value in given.items() if name in named}
    if chosen.get("recurrent") in ("true", "false"):
        chosen["recurrent"] = chosen["recurrent"] == "true"
    if "stages" in chosen:
        chosen["stages"] = tuple(str(chosen["stages"]).split(","))
    settled = dict(run.settings)
    hyperparameters = dict(settled.pop("hyperparameters", {}))
    if "settings" in besides:
        hyperparameters |= read_settings(Path(str(besides["settings"])), algo)
    hyperparameters |= {name: value for name, value in given.items() if name in own}
    chosen = {**settled, **chosen, "n_cars": besides.get("cars"), "n_blocks": besides.get("blocks")}
    try:
        return TrainConfig(**flags, **chosen, hyperparameters=hyperparameters)
    except InputError as error:
        raise InputError(str(error).replace("TrainConfig.", "--set ")) from None


def _trainer(
    config: TrainConfig,
    task: Task,
    stages: Sequence[Task],
    starts: Path | None,
    folder: Path,
    resume: bool,
    shared: dict[str, Any],
) -> Trainer:
    from craftsim.training.checkpoint import RUN_FILE
    from craftsim.training.policy import POLICY_FILE
    from craftsim.training.starts import with_starts
    from craftsim.training.trainer import Trainer

    given: dict[str, Any] = {"task": task, "stages": stages, **shared}
    given["progress"] = counting("plans", bool)
    other = with_starts(task, starts, config.rules) if starts else None
    begun = (folder / RUN_FILE).exists()
    if begun and resume:
        return Trainer.resume(folder, other, config, **given)
    if begun:
        raise InputError(f"{folder} holds a run already; --resume goes on with it, or choose another --out")
    if (folder / POLICY_FILE).exists():
        raise InputError(
            f"{folder} holds a {POLICY_FILE}, but no {RUN_FILE}, from which a run goes on; put that back, or choose "
            f"another --out (--set pretrained={folder} begins with this policy)"
        )
    if resume:
        # As with a campaign: what was cut off before anything was kept begins again.
        print_safe(f"Nothing is saved in {folder} yet: the run begins.")
    return Trainer(config, other, **given)


def _run(trainer: Trainer, steps: int, until: float, folder: Path, tensorboard: bool) -> None:
    """Train, show how it goes, and save after each evaluation."""
    from craftsim.training.curve import TensorboardLog

    log = TensorboardLog(folder, trainer.curve) if tensorboard else None
    what, before, begun = f"{trainer.task.name}, {trainer.config.algo}", trainer.steps, time.perf_counter()
    success, earned = "-", "-"
    with progress_of(what, steps, LINE_EVERY_S, before) as tell:
        for evaluated in trainer.run_and_save(folder, steps, until):
            if evaluated:
                point = trainer.curve[-1]
                success, earned = f"{point.success:.2f}", f"{point.mean_return:.2f}"
                if log is not None:
                    log.write(point)
            rate = (trainer.steps - before) / (time.perf_counter() - begun)
            how = f"success {success}, return {earned}, {rate:,.0f} steps/s"
            tell(trainer.steps, how, f"{trainer.steps:,} of at most {steps:,} steps, {how}")


def _evaluate(
    trainer: Trainer, folder: Path, asked: dict[str, Any], seconds: float, record: Path | None
) -> int:
    """Evaluate what was learned on fresh episodes, and report it."""
    from craftsim.reports.json_file import document
    from craftsim.reports.plots import ACCENT, percent_ticks
    from craftsim.training.config import LEARNED
    from craftsim.training.curve import last_fifth, plot_curve
    from craftsim.training.trainer import training_versions

    config, curve = trainer.config, trainer.curve
    what = f"{trainer.task.name}, {config.algo}"
    played = trainer.evaluate(asked["episodes"], record=record)
    plot_curve(folder / "curve.png", f"{what}, seed {config.seed}", curve)
    figures: dict[str, Any] = {
        "steps": trainer.steps,
        **played.as_figures(),
        "learning_curve": curve,
        "last_fifth": last_fifth([point.success for point in curve]),
        "training_versions": training_versions(),
    }
    wall = {"training_s": trainer.wall_s, "this_call_s": seconds}
    sentence = (
        f"{what}: {played.in_words}, {played.mean_ticks:.1f} ticks, after {trainer.steps:,} steps in "
        f"{trainer.wall_s:.0f} s."
    )
    reached = played.success >= min(asked["until"], LEARNED)
    starts = f"{played.solved:,} of {count(played.starts, 'different start')} solved"

    def draw(axes: Axes) -> None:
        axes.plot([point.steps for point in curve], [point.success for point in curve], color=ACCENT, lw=1.8)
        axes.set_ylim(-0.02, 1.04)
        axes.yaxis.set_major_formatter(percent_ticks)
        axes.set_xlabel("steps")

    drawing = Drawing.of_axes(draw, 2.9, "Success of evaluations during training.", "learning curve")
    lead = "Evaluations on fresh episodes; curve.csv holds all."
    return Report(
        "Training",
        f"{what}, seed {config.seed}",
        Headline(*(("Learned", Tone.GOOD) if reached else ("Not learned", Tone.CAUTION)), sentence),
        [
            KeyFigure(f"{played.success:.3f}", "success", starts),
            KeyFigure(f"{trainer.steps:,}", "steps", f"{trainer.wall_s:.0f} s"),
        ],
        [Section("curve", "Learning curve", lead, [drawing])] if curve else [],
        files={"Policy": folder / "policy.safetensors"},
        document=document(figures, command="train", seed=config.seed, config=asked, wall=wall),
    ).publish(folder)


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
    from craftsim.training.policy import need_torch

    need_torch()
    from craftsim.reports.json_file import document
    from craftsim.studies.results import figures_of, plot_results, study_report, write_markdown
    from craftsim.studies.study import read_study, run_study, under_way

    asked, begun, since_s = read_study(study), time.perf_counter(), time.time()
    with telling(lambda: under_way(asked, out, since_s), STUDY_EVERY_S):
        records = run_study(asked, out, work.run(counting("runs")), timeout)
    figures = figures_of(asked, records)
    write_markdown(out / "study.md", asked, figures)
    pictures = plot_results(out, asked, figures)
    cpu_s = {record["key"]: record["extra"].get("cpu_s") for record in records}
    wall = {"this_call_s": time.perf_counter() - begun, "cpu_s": cpu_s}
    written = document(figures, command="study", seed=0, config={"study": asked, "what": study}, wall=wall)
    reached = sum(record["agrees"] for record in records)
    return study_report(asked, reached, written, pictures).publish(out)
