"""``craftsim train``: cars learn a task on the grid, or in contact physics."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from craftsim.commands.progress import counting
from craftsim.commands.terminal import Terminal
from craftsim.commands.text import say
from craftsim.discrete.rules import RuleSet
from craftsim.errors import InputError
from craftsim.mjcf.parameters import Drive
from craftsim.report import write_report
from craftsim.storage.folders import owned
from craftsim.storage.limits import (
    BATCH,
    BLOCKS,
    BONUS,
    CARS,
    EXPLORED_TICKS,
    HELPER_DEPTH,
    IMITATED_PLANS,
    NETWORK_WIDTH,
    SEED,
    SHARE,
    TRAIN_EPISODES,
    TRAIN_STEPS,
    WORKERS,
)
from craftsim.training.config import (
    HALF,
    PRESETS,
    WORLDS,
    Acting,
    AlgoName,
    NetworkName,
    PresetName,
    TrainBackend,
    TrainConfig,
)
from craftsim.training.extra import need_torch
from craftsim.training.settings import read_settings

if TYPE_CHECKING:
    from craftsim.discrete.tasks import Task
    from craftsim.training.tensorboard_log import TensorboardLog
    from craftsim.training.trainer import Trainer

INTERRUPTED: Final = 130
LINE_EVERY_S: Final = 15.0
"""How often a run says how far it is where there is no terminal for a bar."""


def train(
    task: str = "strip",
    algo: AlgoName = "ippo",
    seed: Annotated[int, SEED] = 0,
    steps: Annotated[int, TRAIN_STEPS] = 3_000_000,
    until: Annotated[float, SHARE] = 0.99,
    backend: TrainBackend = "grid",
    worlds: Annotated[int | None, BATCH] = None,
    workers: Annotated[int | None, WORKERS] = None,
    drive: Drive | None = None,
    randomize: Annotated[
        str | None, tyro.conf.arg(metavar="{none,mild,strong,lab_floor,workshop_floor}")
    ] = None,
    preset: PresetName | None = None,
    rules: RuleSet | None = None,
    helper_depth: Annotated[int | None, HELPER_DEPTH] = None,
    network: NetworkName = "map",
    width: Annotated[int, NETWORK_WIDTH] = 128,
    novelty: Annotated[float, BONUS] = 0.0,
    explore: Annotated[int | None, EXPLORED_TICKS] = None,
    imitate: Annotated[int | None, IMITATED_PLANS] = None,
    shown_share: Annotated[float, SHARE] = HALF,
    pretrained: Annotated[str, tyro.conf.arg(metavar="POLICY")] = "",
    stages: Annotated[tuple[str, ...], tyro.conf.arg(metavar="TASK [TASK ...]", help_behavior_hint="")] = (),
    stage_steps: Annotated[int | None, TRAIN_STEPS] = None,
    acting: Acting = "greedy",
    settings: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    cars: Annotated[int | None, CARS] = None,
    blocks: Annotated[int | None, BLOCKS] = None,
    starts: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    episodes: Annotated[int, TRAIN_EPISODES] = 1000,
    record: bool = False,
    tensorboard: bool = False,
    resume: bool = False,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
) -> int:
    """Train a policy on the grid, or in physics, and report its success rate there on fresh episodes.

    On the grid it runs on one core, and gains and machine parameters mean nothing, so there is no --gains or
    --parameters here. Ctrl-C ends it after the current iteration with everything saved;
    --resume goes on as if it had never stopped. Exit status 0 when training ended by itself.

    Args:
        task: one of the paper's six, one that varies such as random_strip, or a task of one's own: a registered name, a
            file, or module:factory.
        algo: independent or multi-agent PPO, COMA, QMIX, QTRAN, VDN, or independent Q-learning.
        seed: decides everything that is drawn.
        steps: ticks to play at most, all worlds together.
        until: end when this success rate is reached in an evaluation.
        backend: where it is trained and evaluated.
        worlds: how many are stepped side by side in a rollout; 500 on the grid and 32 in physics unless given.
        workers: processes that share the worlds in physics, one for each processor unless given; results do not depend
            on it.
        drive: how cars touch the ground in physics: by forty free rollers, or reduced to one body, which is several
            times as fast; reduced unless given.
        randomize: what is drawn of physics, floor, machines, motors and sensors in each episode; nothing unless given.
        preset: paper is the protocol of CraftEnv's paper: published rules, action helper of depth 20, the task's own
            starts and nothing shown.
        rules: what is legal on the grid: what physics supports, or what CraftEnv's code allows; physical unless given.
        helper_depth: search depth of the action helper on the grid; without it unless given.
        network: what a car's observation is looked up by: each cell of the map, or how a thing lies from the car, which
            serves any number of cars.
        width: of the network's layers.
        novelty: exploration bonus for a building never seen before, smaller the more often it was seen.
        explore: ticks of exploration at random on the grid before learning: worlds once reached are returned
            to, the way to the best is imitated, and every second episode of training starts with one of them.
        imitate: how many plans of the planner are imitated before learning; every second episode of training then
            starts with a world of one of them, or of starts.
        shown_share: with --imitate in a task that varies, how many of the episodes start with a world of a plan, where
            not every second one.
        pretrained: policy to begin with, a name, file or folder; one that looks from a car may be of another area.
        stages: tasks to learn on before, one after the other: a curriculum of easier ones, of the same size and with as
            many things.
        stage_steps: ticks on each of them, all worlds together.
        acting: how the policy acts in evaluations and later: what it rates highest, or drawn by its probabilities.
        settings: YAML file of the algorithm's hyperparameters that are not to be its own, such as learning_rate.
        cars: other than the task's number of cars; those that its start does not list are drawn at random.
        blocks: the same for blocks.
        starts: start every second episode of training with a world of this .plan, or of a file of reached worlds.
        episodes: how many episodes the final evaluation has.
        record: write the trajectories of the final evaluation's episodes, in physics only.
        tensorboard: write the learning curve for TensorBoard, too, into tensorboard/ of the output folder.
        resume: go on with the run in the output folder, begun with the same options; where nothing has been saved yet,
            begin it.
        out: folder for policy.safetensors, run.pt, curve.csv, curve.png and report.json; out/train/TASK-ALGO if not
            given.
    """
    need_torch()
    from craftsim.discrete.tasks import as_task
    from craftsim.rendering.trajectory import TRAJECTORIES

    if backend == "grid" and workers is not None:
        raise InputError("--workers is for physics; on the grid one process steps all worlds: leave it out")
    if backend == "grid" and drive is not None:
        raise InputError("--drive is for physics; on the grid nothing rolls: leave it out")
    if backend == "grid" and randomize is not None:
        raise InputError("--randomize is for physics; on the grid nothing is drawn of it: leave it out")
    if backend == "grid" and record:
        raise InputError("--record is for physics; on the grid nothing moves: leave it out")
    worlds = WORLDS[backend] if worlds is None else worlds
    config = TrainConfig(
        *(task, algo, seed, worlds),
        width=width,
        network=network,
        shown_share=shown_share,
        pretrained=pretrained,
        stages=stages,
        stage_steps=stage_steps or 0,
        acting=acting,
        novelty=novelty,
        n_cars=cars,
        n_blocks=blocks,
        backend=backend,
        drive=drive or "reduced",
        randomize=randomize or "none",
        hyperparameters=read_settings(settings, algo) if settings else {},
        **_protocol(
            preset,
            starts or pretrained,
            rules=rules,
            helper_depth=helper_depth,
            explore=explore,
            imitate=imitate,
        ),
    )
    learnt = as_task(task, cars, blocks)
    if not learnt.has_goal:
        raise InputError(
            f"task '{learnt.name}' has no goal to learn: put a {learnt.name}_goal.yaml beside its blueprint, "
            "or name one in a task file (docs/reference/tasks.md)"
        )
    staged = [as_task(name, cars, blocks) for name in stages]
    folder = out or Path("out/train") / re.sub(r"[^\w.-]+", "-", f"{learnt.name}-{algo}")

    import torch

    # One thread adds numbers up in one order, so that a run can be repeated bit for bit.
    torch.set_num_threads(1)
    console = Terminal()
    begun = time.perf_counter()
    with (
        owned(folder),
        closing(_trainer(config, learnt, staged, starts, folder, resume, workers)) as trainer,
    ):
        log = _log(folder, trainer) if tensorboard else None
        _ = trainer.guidance  # shows progress of its own
        try:
            _run(trainer, console, steps, until, folder, log)
        except KeyboardInterrupt:
            trainer.save(folder)
            say(f"Interrupted; --resume goes on. Policy: {folder / 'policy.safetensors'}")
            return INTERRUPTED
        trainer.save(folder)
        asked = config.as_dict() | {"steps": steps, "until": until, "starts": starts, "episodes": episodes}
        asked |= {"task_digest": trainer.task.digest, "starts_digest": trainer.starts}
        asked["pretrained_digest"] = trainer.pretrained
        place = folder / TRAJECTORIES if record else None
        _report(trainer, folder, asked, time.perf_counter() - begun, place)
    return 0


def _protocol(preset: PresetName | None, shown: Path | str | None, **given: Any) -> dict[str, Any]:
    """Return what is given; a preset settles the rest."""
    if preset is not None and (shown or given["imitate"]):
        raise InputError(
            f"--preset {preset} learns from nothing; leave --starts, --imitate and --pretrained out"
        )
    return {**(PRESETS[preset] if preset else {}), **{k: v for k, v in given.items() if v is not None}}


def _trainer(
    config: TrainConfig,
    task: Task,
    stages: Sequence[Task],
    starts: Path | None,
    folder: Path,
    resume: bool,
    workers: int | None,
) -> Trainer:
    from craftsim.training.checkpoint import RUN_FILE
    from craftsim.training.starts import with_starts
    from craftsim.training.trainer import Trainer

    def progress(total: int) -> AbstractContextManager[Callable[[bool], None]]:
        return counting(Terminal(), "plans", total, bool)

    other = with_starts(task, starts, config.rules) if starts else None
    begun = (folder / RUN_FILE).exists()
    if begun and resume:
        return Trainer.resume(folder, other, task, config, workers, progress, stages)
    if begun:
        raise InputError(f"{folder} holds a run already; --resume goes on with it, or choose another --out")
    if resume:
        # As with a campaign: what was cut off before anything was kept begins again.
        say(f"Nothing is saved in {folder} yet: the run begins.")
    return Trainer(config, other, task, workers, progress, stages)


def _log(folder: Path, trainer: Trainer) -> TensorboardLog:
    from craftsim.training.tensorboard_log import TensorboardLog

    return TensorboardLog(folder, trainer.curve)


def _run(
    trainer: Trainer, console: Console, steps: int, until: float, folder: Path, log: TensorboardLog | None
) -> None:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn(
            "success {task.fields[success]}, return {task.fields[earned]}, {task.fields[rate]:,.0f} steps/s"
        ),
        TimeElapsedColumn(),
        TextColumn("at most"),
        TimeRemainingColumn(),
    )
    what = f"{trainer.task.name}, {trainer.config.algo}"
    begun = printed = time.perf_counter()
    before, success, earned = trainer.steps, "-", "-"
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        row = bar.add_task(what, total=steps, completed=before, success=success, earned=earned, rate=0.0)
        for evaluated in trainer.run(steps, until):
            now = time.perf_counter()
            rate = (trainer.steps - before) / (now - begun)
            if evaluated:
                point = trainer.curve[-1]
                success, earned = f"{point.success:.2f}", f"{point.mean_return:.2f}"
                trainer.save(folder)
                if log is not None:
                    log.write(point)
            bar.update(row, completed=trainer.steps, rate=rate, success=success, earned=earned)
            if not console.is_terminal and now - printed >= LINE_EVERY_S:
                printed = now
                console.print(
                    f"{what}: {trainer.steps:,} of at most {steps:,} steps, success {success}, return {earned}, "
                    f"{rate:,.0f} steps/s",
                    soft_wrap=True,
                )


def _report(
    trainer: Trainer, folder: Path, asked: dict[str, Any], seconds: float, record: Path | None
) -> None:
    from craftsim.training.curve import plot_curve
    from craftsim.training.trainer import training_versions

    config, curve = trainer.config, trainer.curve
    played = trainer.evaluate(asked["episodes"], record=record)
    plot_curve(folder / "curve.png", f"{trainer.task.name}, {config.algo}, seed {config.seed}", curve)
    figures: dict[str, Any] = {
        "steps": trainer.steps,
        **played.as_figures(),
        "learning_curve": curve,
        "training_versions": training_versions(),
    }
    wall = {"training_s": trainer.wall_s, "this_call_s": seconds}
    report = write_report(folder, figures, command="train", seed=config.seed, config=asked, wall=wall)
    say(
        f"{trainer.task.name}, {config.algo}: {played.in_words}, {played.mean_ticks:.1f} ticks, after "
        f"{trainer.steps:,} steps in {trainer.wall_s:.0f} s."
    )
    say(f"Policy: {folder / 'policy.safetensors'}\nReport: {report}")
