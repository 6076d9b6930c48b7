"""``craftsim validate``: do plans, actions and policies do in physics what the rules predict?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

from cyclopts import Parameter

from craftsim.choices import Backend
from craftsim.cli.again import command_again
from craftsim.cli.options import RESULTS, Dir, File, Films, Name, Shown
from craftsim.errors import InputError
from craftsim.options import Physics, Rollouts, Trials, number
from craftsim.storage.folders import owning
from craftsim.storage.limits import DESIGN_SIDE, PLAN_ROUNDS, REPLANS, RUNS

AUTO: Final = "auto"
"""The plan that is made, and made again."""


@owning
def validate(
    worlds: Annotated[tuple[str, ...], Parameter(metavar="WORLD")] = (),
    what: Rollouts = Rollouts(),  # noqa: B008
    physics: Physics = Physics(),  # noqa: B008
    campaign: Trials = Trials(),  # noqa: B008
    *,
    backend: Backend = "physics",
    area: Annotated[tuple[int, ...], number(DESIGN_SIDE)] = (),
    goal: File = None,
    replans: Annotated[int, number(REPLANS)] = 10,
    attempts: Annotated[int, number(PLAN_ROUNDS)] = 60,
    disturb: Literal["shove", "fold", "dead-car"] | None = None,
    acting: Literal["greedy", "sampled"] | None = None,
    record: Annotated[Literal["none", "trajectory", "minari"], Parameter(group=RESULTS)] = "none",
    dataset: Annotated[Name, Parameter(group=RESULTS)] = None,
    video: Films = "failures",
    minimize: Shown = False,
    out: Dir = Path("out/validate"),
) -> int:
    """Run plans, lists of actions or policies in physics, judge each action on poses, and report.

    After each step the prediction goes on from what was read. An action agrees when the grid that was read is the
    predicted one and every error is within its limit. Exit status 0 when everything agrees, 1 when something does not
    or a trial timed out, 2 for wrong input.

    With --plan auto the goal is built: plan, act, read the world, and plan again; status 0 when all is built. With
    --backend grid, trained policies play on the grid, and different starts and trajectories are counted. With --record
    minari, episodes become a dataset for offline learning.

    Args:
        worlds: names of shipped tasks, files, or 'module:factory'; or 'random' for worlds that each trial draws anew;
            all six tasks unless given.
        backend: contact physics, or the grid by its rules for trained policies and datasets.
        area: length, width and height of another area, of tasks that vary, on the grid.
        goal: design to build with --plan auto, in place of the task's goal.
        replans: plans after the first one with --plan auto, at most.
        attempts: attempts at each plan with --plan auto, of which the best is taken.
        disturb: what goes wrong on purpose with --plan auto: a block is shoved by one cell, a slope is folded again, or
            a car gets no commands any more.
        acting: on the grid, do what a policy rates highest, or draw by its probabilities; as it was trained for unless
            given.
        record: write the trajectory of every run and its cars' log, for 'craftsim render' and 'view'; or a Minari
            dataset of the episodes.
        dataset: name of the dataset, with a version; craftsim/TASK/POLICY-v0 unless given.
        video: films of the failures, or besides of every run from its start to its end.
        minimize: find the smallest world in which the first failure of each kind still happens.
        out: folder for report.html, report.json, config.yaml, trials.jsonl, durations.csv, the bundles of the
            disagreements, and of random play the worlds and plans.
    """
    if record == "minari":
        from craftsim.cli.datasets import write_episodes

        return write_episodes(
            _only(worlds, "--record minari"), what, physics, campaign, backend, dataset, out
        )
    if backend == "grid":
        from craftsim.cli.evaluation import play_policies

        return play_policies(worlds, what, physics, campaign, area, acting, out)
    if str(what.plan) == AUTO:
        from craftsim.cli.building import build

        asked = replans, attempts, disturb
        filmed = video == "all" or (video == "failures" and record == "trajectory")
        return build(
            _only(worlds, "--plan auto"), goal, asked, what.timeout_s, physics, campaign, filmed, out
        )
    for option, given in (("--goal", goal), ("--disturb", disturb)):
        if given is not None:
            raise InputError(f"{option} goes with --plan auto")
    return _validate(worlds, what, physics, campaign, record == "trajectory", video, minimize, out)


def _only(worlds: tuple[str, ...], option: str) -> str:
    if len(worlds) != 1:
        raise InputError(
            f"{option} needs the one world that it is for: a task's name, a file or module:factory"
        )
    return worlds[0]


def _validate(
    worlds: tuple[str, ...],
    what: Rollouts,
    physics: Physics,
    campaign: Trials,
    record: bool,
    video: str,
    minimize: bool,
    out: Path,
) -> int:
    from craftsim.cli.films import film_runs, record_failures, rendering_works
    from craftsim.cli.progress import counting, shrinking
    from craftsim.discrete.tasks import TASK_NAMES
    from craftsim.reports.terminal import Terminal
    from craftsim.validation import validation
    from craftsim.validation.report import validation_report

    RUNS.check(
        "--trials times worlds and policies",
        campaign.trials * len(worlds or TASK_NAMES) * max(1, len(what.policy)),
    )
    console = Terminal()
    filming = video != "none" and rendering_works(console)
    result = validation.validate(
        worlds or TASK_NAMES,
        what,
        physics,
        campaign,
        out=out,
        progress=lambda total: counting(console, "runs", total),
        minimize=shrinking(console) if minimize else None,
        record=record or video == "all",
    )
    if filming or record:
        record_failures(console, out, result.records, campaign.workers, filming)
    if filming and video == "all":
        film_runs(console, out, campaign.workers)
    return validation_report(result, out, command_again()).publish(out, console)
