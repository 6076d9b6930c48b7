"""Plan a building: from a start and a design to a plan, its pictures and its figures."""

from __future__ import annotations

import time
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from cyclopts import Parameter

from craftsim.choices import DEFAULT_ROUNDS, DEFAULT_TIME_S, Objective
from craftsim.cli.options import RESULTS, File, Shown
from craftsim.cli.text import say
from craftsim.options import number
from craftsim.storage.limits import PLAN_ROUNDS, PLAN_TIME_S, SEED

if TYPE_CHECKING:
    from craftsim.planning import Planned

_ENDING: Final = ".plan"


def plan(
    start: str,
    *,
    goal: File = None,
    objective: Objective = "makespan",
    time_limit: Annotated[float, number(PLAN_TIME_S, "SECONDS")] = DEFAULT_TIME_S,
    attempts: Annotated[int, number(PLAN_ROUNDS)] = DEFAULT_ROUNDS,
    seed: Annotated[int, number(SEED)] = 0,
    video: Shown = False,
    out: Annotated[Path, Parameter(metavar="DIR|FILE", group=RESULTS)] = Path("out/plan"),
) -> int:
    """Find a plan for a building: what goes where in which order, which car does it, and every move.

    Better plans come with time; Ctrl-C keeps the best so far. The plan obeys the physical rules, and says which action
    waits for which. Exit status 0, or 2 for wrong input and where there is no plan, which says why.

    Args:
        start: start file, or the name of a task such as simple_two_story.
        goal: goal file; that of a task unless given. Without one the flag goes to the goal of the start file, or all
            blocks become one platform.
        objective: what is to be small: the time until all is done, or the sum of all actions' durations.
        time_limit: no attempt begins after so many seconds, once there is a plan.
        attempts: attempts at most; with the same seed and enough time, the same plan.
        seed: of what is decided by chance, and of what the start file leaves open.
        video: film the plan on the grid, too.
        out: file for the plan that ends with .plan, or folder for plan, report and Gantt chart.
    """
    import numpy as np

    from craftsim.discrete.files.plan import write_plan
    from craftsim.planning import plan_building
    from craftsim.storage.folders import owned
    from craftsim.validation.validation import read_goal

    rng = np.random.default_rng(seed)
    task = read_goal(start, goal).for_episode(rng)
    grid = task.draw(rng)
    begun = time.monotonic()
    best = np.inf

    def report(number: int, planned: Planned | None) -> None:
        nonlocal best
        if planned is not None and planned.cost(objective)[0] < best - 1e-9:
            best = planned.cost(objective)[0]
            say(f"{time.monotonic() - begun:6.1f} s  attempt {number}: {_figures(planned)}")

    file = out if out.suffix == _ENDING else out / f"{task.name}{_ENDING}"
    with nullcontext() if file is out else owned(out):
        planned = plan_building(
            grid, task, objective=objective, rounds=attempts, time_s=time_limit, seed=seed, report=report
        )
        if not planned.ticks:
            say("the goal is reached already; there is nothing to do")
            return 0
        known = (
            "proved to be the best" if planned.optimal else f"none can take less than {planned.bound_s:.1f} s"
        )
        say(f"best: {_figures(planned)}; {known}")
        if file is not out:
            _draw(planned, out, task.name, video)
            _report(planned, out, task.name, objective, attempts, seed, time.monotonic() - begun)
        write_plan(planned.ticks, file, planned.schedule)
        say(f"plan: {file}")
        return 0


def _figures(planned: Planned) -> str:
    n_actions = len(planned.schedule.steps)
    return f"makespan {planned.makespan_s:.1f} s, work {planned.work_s:.1f} s, {n_actions} actions"


def _draw(planned: Planned, out: Path, name: str, video: bool) -> None:
    """Draw the Gantt chart of a plan, and film it."""
    from craftsim.cli.progress import counting
    from craftsim.discrete.rules import Rules
    from craftsim.rendering.plan_film import film_plan
    from craftsim.rendering.plots.gantt import FORMATS, draw_gantt
    from craftsim.reports.terminal import Terminal

    for ending in FORMATS:
        say(f"Gantt chart: {draw_gantt(out / f'{name}-gantt{ending}', planned.schedule, name)}")
    if video:
        film = film_plan(
            *(out / f"{name}-plan.mp4", planned.schedule, Rules("physical"), name),
            progress=lambda total: counting(Terminal(), "frames", total, bool),
        )
        say(f"film: {film}")


def _report(
    planned: Planned, out: Path, name: str, objective: Objective, rounds: int, seed: int, took_s: float
) -> None:
    from craftsim.reports.json_file import write_report

    figures = {
        "makespan_s": planned.makespan_s,
        "work_s": planned.work_s,
        "bound_s": planned.bound_s,
        "actions": len(planned.schedule.steps),
        "found_in_attempt": planned.rounds,
    }
    config = {"start": name, "objective": objective, "rounds": rounds, "rules": "physical"}
    wall = {"planning_s": took_s}
    say(f"report: {write_report(out, figures, command='plan', seed=seed, config=config, wall=wall)}")
