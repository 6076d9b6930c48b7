"""Buildings that are planned, built in physics, and planned again where it went wrong: validate --plan auto."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from craftsim.cli.again import command_again
from craftsim.options import Physics, Trials
from craftsim.reports.terminal import Terminal


def build(
    start: str,
    goal: Path | None,
    asked: tuple[int, int, Any],
    timeout_s: float,
    physics: Physics,
    campaign: Trials,
    video: bool,
    out: Path,
) -> int:
    """Plan a building, build it in physics, read the world from poses, and plan again from what is there.

    After an action that did not do what the rules predict, what does not depend on it comes to its end; then follows
    another plan. A car that does not act any more is an obstacle to the others. Return the exit status, 0 when all is
    built.

    Args:
        start: name of a task, a start file, or 'module:factory'.
        goal: design to build, in place of the task's goal.
        asked: plans after the first one, attempts at each, and what goes wrong on purpose.
        timeout_s: after which a building counts as hanging.
        physics: in which it is built.
        campaign: how often, and where.
        video: film every building from its start to its end.
        out: folder for results.
    """
    from craftsim.cli.films import film_runs, rendering_works
    from craftsim.cli.progress import counting
    from craftsim.validation.replanning import Replanning
    from craftsim.validation.report import validation_report
    from craftsim.validation.validation import build_all, read_goal

    task = read_goal(start, goal)
    setup = physics.setup()
    console = Terminal()
    filming = video and rendering_works(console)
    result = build_all(
        *(task, setup, Replanning(*asked)),
        trials=campaign.trials,
        seed=physics.seed,
        out=out,
        options=campaign.run(lambda total: counting(console, "buildings", total, _is_built)),
        timeout_s=timeout_s,
        record=video,
    )
    if filming:
        film_runs(console, out, campaign.workers)
    return validation_report(result, out, command_again()).publish(out, console)


def _is_built(record: dict[str, dict[str, str]]) -> bool:
    return record["extra"].get("ended") == "built"
