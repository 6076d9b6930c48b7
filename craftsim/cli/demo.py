"""``craftsim demo``: drawings become buildings, and every action is checked."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from craftsim.cli.app import command_again
from craftsim.cli.progress import counting
from craftsim.errors import InputError
from craftsim.options import CarriedPlan, Dir, GoalFile, Physics, Shown, number
from craftsim.storage.folders import owning
from craftsim.storage.limits import TIMEOUT_S


@owning
def demo(
    task: str = "simple_two_story",
    *,
    carried: CarriedPlan = CarriedPlan(),  # noqa: B008
    design: GoalFile = GoalFile(),  # noqa: B008
    robot: Annotated[str | None, Parameter(metavar="HOST:PORT")] = None,
    timeout: Annotated[float, number(TIMEOUT_S)] = 1.0,
    physics: Physics = Physics(),  # noqa: B008
    video: Shown = True,
    out: Dir = Path("out/demo"),
) -> int:
    """Build one of the paper's tasks in physics, or all six, and compare every action with its prediction.

    The same seed gives the same film. Exit status: 0 if every action is as predicted, within all limits, and each goal
    is reached, 1 if not, 2 for invalid input.

    Args:
        task: name of a task, or 'all' for all six; or a start or task file or 'module:factory', then with --plan.
        robot: address of robots to drive instead of simulated ones, such as those of 'craftsim robot serve'.
        timeout: seconds without a message after which these robots count as lost.
        video: make a film of each task; skipped if rendering does not work on this machine.
        out: folder for report.html, report.json, films, trajectories and logs.
    """
    from craftsim.checking.setup import set_up
    from craftsim.cli.films import rendering_works
    from craftsim.discrete.tasks import TASK_NAMES
    from craftsim.logs.files import LOG_SUFFIX, write_table
    from craftsim.rendering.trajectory import SUFFIX
    from craftsim.reports.json_file import document
    from craftsim.robots import robots_at
    from craftsim.validation.report import demo_report
    from craftsim.validation.rollout import Building, read_building

    started = time.perf_counter()
    if task == "all" and (carried.plan or design.goal):
        raise InputError("--task all builds the shipped tasks; files of your own go with a single task")
    if task == "all" and robot is not None:
        raise InputError("robots stand in one world; --robot goes with a single task")
    setup = physics.setup()
    names = TASK_NAMES if task == "all" else (task,)
    buildings = [read_building(name, carried.plan_file, design.goal) for name in names]
    filming, films, done = video and rendering_works(), dict[str, Path](), list[Building]()
    for building in buildings:
        with (
            nullcontext(set_up) if robot is None else robots_at(robot, timeout) as where,
            counting(building.name, attrgetter("agrees"))(building.n_actions) as tell,
        ):
            one = building.run(setup, physics.seed, carried.order, _telling(tell), where)
        assert one.trajectory is not None
        one.trajectory.write(out / f"{one.name}{SUFFIX}")
        write_table(out / f"{one.name}{LOG_SUFFIX}", one.logs)
        if filming:
            from craftsim.rendering.render import render

            films[one.name] = out / f"{one.name}.mp4"
            render(one.trajectory, films[one.name], progress=counting("frames", bool))
        done.append(replace(one, trajectory=None, logs={}))
    config: dict[str, Any] = {"setup": setup, "order": carried.order, "rules": physics.rules}
    config |= {"robot": robot, "randomize": physics.randomize, "digests": setup.digests}
    figures: dict[str, Any] = done[0].figures
    if task == "all":
        config["tasks"] = {one.name: one.files for one in done}
        figures = {"tasks": {one.name: one.figures for one in done}, "good": sum(one.good for one in done)}
        figures |= {"agree": sum(one.n_agree for one in done), "total": sum(one.n_actions for one in done)}
    else:
        config |= done[0].files
    wall = {"total_s": time.perf_counter() - started}
    written = document(figures, command="demo", seed=physics.seed, config=config, wall=wall)
    return demo_report(done, command_again(), written, films).publish(out)


def _telling(tell: Callable[[Any], None]) -> Callable[[Any], Callable[[Iterable[Any]], None]]:
    def tell_each(attempts: Iterable[Any]) -> None:
        for attempt in attempts:
            tell(attempt)

    return lambda judge: tell_each
