"""Buildings that are planned, built in physics, and planned again where it went wrong: validate --plan auto."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from craftsim.cli.terminal import Terminal
from craftsim.cli.text import say
from craftsim.options import Physics, Trials


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
    from craftsim.cli.build_text import builds_table, conclusion
    from craftsim.cli.films import film_runs, rendering_works
    from craftsim.cli.notes_text import print_notes
    from craftsim.cli.progress import counting
    from craftsim.cli.validate_text import print_disagreements
    from craftsim.validation.builds import build_all, read_goal
    from craftsim.validation.runs.rebuilding import Rebuilding

    task = read_goal(start, goal)
    setup = physics.setup()
    console = Terminal()
    filming = video and rendering_works(console)
    result = build_all(
        *(task, setup, Rebuilding(*asked)),
        trials=campaign.trials,
        seed=physics.seed,
        out=out,
        options=campaign.run(lambda total: counting(console, "buildings", total, _is_built)),
        timeout_s=timeout_s,
        record=video,
    )
    if filming:
        film_runs(console, out, campaign.workers)
    console.print(builds_table(result.records))
    print_disagreements(out, result.records)
    print_notes(result.figures.capped_steps, result.figures.retried)
    if result.comparison is not None:
        say(result.comparison)
    say(f"Report: {out / 'report.json'}")
    say(conclusion(result))
    return 0 if result.all_built else 1


def _is_built(record: dict[str, dict[str, str]]) -> bool:
    return record["extra"].get("ended") == "built"
