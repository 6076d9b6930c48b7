"""``craftsim validate``: do plans, actions and policies do in physics what the rules predict?"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from craftsim.cli.app import FOLDER, command_again
from craftsim.cli.options import RESULTS_GROUP, OptionalDir, PlayedChoice, Shown
from craftsim.cli.progress import counting, counting_kinds
from craftsim.designs.ranges import DESIGN_SIDE
from craftsim.errors import InputError
from craftsim.experiments.ranges import RUNS
from craftsim.learning.settings import BackendChoice
from craftsim.planning.ranges import PLAN_ROUNDS
from craftsim.reports.publishing import publish
from craftsim.storage.folders import owned
from craftsim.validation.options import GoalFile, Physics, Rollouts, RunTrials, number

if TYPE_CHECKING:
    from craftsim.learning.config import Acting
    from craftsim.validation.sources import WorldSource


def default_folder(backend: BackendChoice) -> Path:
    """Return the folder of a run without ``--out``: another for each kind, so that none has to replace another one."""
    return Path("out/validate-grid" if backend == "grid" else "out/validate")


def validate(
    worlds: Annotated[tuple[str, ...], Parameter(metavar="WORLD")] = (),
    rollouts: Rollouts = Rollouts(),  # noqa: B008
    physics: Physics = Physics(),  # noqa: B008
    campaign: RunTrials = RunTrials(),  # noqa: B008
    design: GoalFile = GoalFile(),  # noqa: B008
    *,
    backend: BackendChoice = "physics",
    area: Annotated[tuple[int, ...], number(DESIGN_SIDE)] = (),
    attempts: Annotated[int, number(PLAN_ROUNDS)] = 60,
    disturb: Literal["shove", "fold", "dead-car", "dead-early"] | None = None,
    acting: Literal["greedy", "sampled", "varied"] | None = None,
    record: PlayedChoice = "none",
    video: Annotated[
        Literal["none", "failures", "all"], Parameter(group=RESULTS_GROUP)
    ] = "failures",
    minimize: Shown = False,
    out: OptionalDir = None,
) -> int:
    """Run plans, action lists, policies or random play in physics, and compare each action with its prediction.

    After each step the next prediction starts from the grid read from poses. An action agrees if that grid is the
    predicted one and every error is within its limit. Exit status: 0 if everything agrees, 1 if something disagrees, a
    trial timed out or no action was judged, 2 for invalid input.

    With --plan auto the goal is built with replanning: plan, act, read the world, plan again; status 0 if everything is
    built. With --backend grid, trained policies are evaluated on the grid. With --certify each plan or policy is run
    until it is certain whether so large a share of its runs succeeds; status 0 if all do.

    Args:
        worlds: names of tasks, files, or 'module:factory'; or 'random', a new random world for each trial; default: all
            six tasks.
        backend: contact physics, or the grid (for trained policies).
        area: length, width and height of the area, for random tasks on the grid.
        attempts: attempts at each plan with --plan auto; the best is used.
        disturb: disturbance with --plan auto: shove a block by one cell, fold a slope again, or disable a car, at some
            time or when its second action begins.
        acting: on the grid, take the most probable action, sample, or rate actions lower that were taken in the same
            situation; default: as the policy was trained.
        record: write the trajectory and logs of every run, for 'craftsim render' and 'view'; 3d also lets report.html
            replay failures in 3D.
        video: film the failures, or every run as well.
        minimize: reduce the first failure of each kind to the smallest world in which it occurs.
        out: folder for report.html, report.json, config.yaml, trials.jsonl, durations.csv and replay bundles; for
            random play also worlds and plans. Default: out/validate; with --backend grid out/validate-grid.
    """
    if campaign.certify is not None and backend == "grid":
        raise InputError("--certify runs physics: leave out --backend grid, or --certify")
    if design.goal is not None and backend == "grid":
        raise InputError("--goal is judged in physics: leave out --backend grid, or --goal")
    if out is None:
        out = default_folder(backend)
        FOLDER.set(out)
    with owned(out):
        if backend == "grid":
            return _evaluate_on_grid(worlds, rollouts, physics, campaign, area, acting, out)
        from craftsim.cli.films import film_runs, record_failures, rendering_works
        from craftsim.tasks import TASK_NAMES
        from craftsim.validation import validation
        from craftsim.validation.replanning import Replanning
        from craftsim.validation.report import validation_report
        from craftsim.validation.sources import AUTO, read_goal

        worlds_to_run: tuple[WorldSource, ...] = worlds or TASK_NAMES
        progress = counting("runs")
        if rollouts.plan != AUTO and disturb is not None:
            raise InputError("--disturb goes with --plan auto")
        if rollouts.plan == AUTO or design.goal is not None:
            if rollouts.plan == AUTO:
                option = "--plan auto"
            else:
                option = "--goal"
            worlds_to_run = (read_goal(_only(worlds, option), design.goal),)
        if rollouts.plan == AUTO:
            progress = counting("runs", lambda record: record["extra"].get("ended") == "built")
        recording = record != "none"
        RUNS.check(
            "--trials times worlds and policies",
            campaign.most_trials * len(worlds_to_run) * max(1, len(rollouts.policy)),
        )
        filming = video != "none" and rendering_works()
        result = validation.validate(
            worlds_to_run,
            rollouts,
            physics,
            campaign,
            out=out,
            progress=progress,
            minimize=counting_kinds() if minimize else None,
            replanning=Replanning(rounds=attempts, disturb=disturb),
            record=recording or video == "all",
        )
        if filming or recording:
            played = record == "3d"
            record_failures(out, result.records, campaign.workers, filming, played)
        if filming and video == "all":
            film_runs(out, campaign.workers)
        return publish(validation_report(result, command_again()), out)


def _only(worlds: tuple[str, ...], option: str) -> str:
    if len(worlds) != 1:
        raise InputError(
            f"{option} needs the one world that it is for: a task's name, a file or module:factory"
        )
    return worlds[0]


def _evaluate_on_grid(
    tasks: tuple[str, ...],
    rollouts: Rollouts,
    physics: Physics,
    campaign: RunTrials,
    area: tuple[int, ...],
    acting: Acting | None,
    out: Path,
) -> int:
    """Play trained policies on the grid, and count what differs: --backend grid.

    A deterministic policy plays one start alike each time: what is repeated counts once, and only different starts have
    an interval. Tasks may start otherwise than those of training, but are of the same size, and have as many cars and
    things unless the network looks from a car.
    """
    from craftsim.learning.policy import need_torch
    from craftsim.reports.json_file import document
    from craftsim.reports.report import DataTable, Headline, Report, Section, Tone, count, numbers
    from craftsim.tasks import as_task, known_task

    policies = [str(policy) for policy in rollouts.policy]
    cars = rollouts.n_cars
    blocks = rollouts.n_blocks
    episodes = campaign.most_trials
    if not policies or rollouts.plan is not None or rollouts.actions is not None:
        raise InputError(
            "on the grid trained policies are played; name one or more with --policy: what 'craftsim train' wrote, a "
            "file or a folder"
        )
    need_torch()
    from craftsim.learning.evaluation import evaluate
    from craftsim.learning.policy import load_policy

    games = []
    extent = area or None
    for path in policies:
        policy = load_policy(path)
        tasks_of_policy = [as_task(name, cars, blocks, extent) for name in tasks]
        if not tasks:
            config_of_policy = policy.config
            config_of_policy = replace(
                config_of_policy,
                n_cars=cars or config_of_policy.n_cars,
                n_blocks=blocks or config_of_policy.n_blocks,
            )
            try:
                # The name in a policy's file may be from anybody: it is never code.
                find = partial(known_task, area=extent)
                tasks_of_policy = [config_of_policy.find_task(config_of_policy.task, find)]
            except InputError as error:
                raise InputError(
                    f"{path}: the task that it was trained on is not there: {error}; name one with --task"
                ) from error
        for task in tasks_of_policy:
            shape = policy.shape.of_task(task)
            if not policy.shape.fits(shape):
                raise InputError(
                    f"{path}: its network is for {policy.shape}, task '{task.name}' is of {shape}; a network serves "
                    "areas of one size, and unless it is relative, one number of cars and things"
                )
            games.append((path, policy, task))
    figures: list[dict[str, Any]] = []
    rows = []
    for path, policy, task in games:
        rules = policy.config.rules
        depth = policy.config.helper_depth
        acting_here = acting or policy.config.acting
        evaluation = evaluate(policy.net, task, episodes, physics.seed, rules, depth, acting_here)
        figures.append(
            {"policy": path, "task": task.name, "acting": acting_here, **evaluation.as_figures()}
        )
        interval = "one start"
        if evaluation.interval is not None:
            interval = "{:.3f}-{:.3f}".format(*evaluation.interval)
        rows.append(
            (
                Path(path).name,
                task.name,
                f"{evaluation.success:.3f}",
                f"{evaluation.solved} of {evaluation.starts}",
                interval,
                str(evaluation.trajectories),
                f"{evaluation.mean_ticks:.1f}",
            )
        )
    config = {"policies": policies, "task": list(tasks), "episodes": episodes}
    config |= {"cars": cars, "blocks": blocks, "area": list(area)}
    heads = ("success", "starts solved", "at 95 %", "ways", "ticks")
    columns = (*numbers("policy"), *numbers("task", *heads))
    table = DataTable(columns, rows, f"{episodes} episodes each; ways are different trajectories")
    lead = "What repeats itself counts once: only different starts have an interval."
    sentence = f"{count(len(figures), 'evaluation')} of {count(len(policies), 'policy', 'policies')} on the grid."
    report = Report(
        "Evaluation of policies",
        ", ".join(dict.fromkeys(row["task"] for row in figures)),
        Headline("Evaluated", Tone.PLAIN, sentence),
        sections=[Section("evaluations", "Evaluations", lead, [table], terminal=True)],
        document=document(
            {"evaluations": figures}, command="evaluate", seed=physics.seed, config=config
        ),
    )
    return publish(report, out)
