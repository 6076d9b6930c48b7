"""``craftsim demo``: drawings become buildings, and every action is checked."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from craftsim.cli.app import command_again
from craftsim.cli.options import Dir, File, Shown
from craftsim.cli.progress import counting
from craftsim.errors import InputError
from craftsim.reports.publishing import publish
from craftsim.storage.folders import owning
from craftsim.storage.limits import TIMEOUT_S
from craftsim.validation.options import CarriedPlan, GoalFile, Physics, number

if TYPE_CHECKING:
    from craftsim.planning.plan_file import Plan
    from craftsim.tasks import Task
    from craftsim.validation.replanning import Replanning


@owning
def demo(
    task: str = "simple_two_story",
    *,
    carried: CarriedPlan = CarriedPlan(),  # noqa: B008
    design: GoalFile = GoalFile(),  # noqa: B008
    robot: Annotated[str | None, Parameter(metavar="HOST:PORT")] = None,
    key: File = None,
    timeout: Annotated[float, number(TIMEOUT_S)] = 1.0,
    physics: Physics = Physics(),  # noqa: B008
    video: Shown = True,
    out: Dir = Path("out/demo"),
) -> int:
    """Build one of the paper's tasks in physics, or all six, and compare every action with its prediction.

    The same seed gives the same film. With --plan auto the goal is built with replanning, as by 'craftsim validate'.
    Exit status: 0 if every action is as predicted, within all limits, and each goal is reached, or with --plan auto
    built, 1 if not, 2 for invalid input.

    Args:
        task: name of a task, or 'all' for all six; or a start or task file or 'module:factory', then with --plan.
        robot: address of robots to drive instead of simulated ones, such as those of 'craftsim robot serve'.
        key: key of these robots, which 'craftsim robot serve --key' has, too (docs/how-to/robots.md); the loopback
            address needs none.
        timeout: seconds without a message after which these robots count as lost.
        video: make a film of each task; skipped if rendering does not work on this machine.
        out: folder for report.html, report.json, films, trajectories and logs.
    """
    from craftsim.checking.setup import set_up
    from craftsim.cli.films import rendering_works
    from craftsim.rendering.trajectory import SUFFIX
    from craftsim.reports.json_file import document
    from craftsim.robots import robots_at
    from craftsim.robots.log_files import LOG_SUFFIX, write_table
    from craftsim.tasks import TASK_NAMES
    from craftsim.validation.episode import Episode
    from craftsim.validation.replanning import Replanning
    from craftsim.validation.report import demo_report
    from craftsim.validation.rollout import planned_task, run_plan
    from craftsim.validation.sources import AUTO, read_goal

    started = time.perf_counter()
    if task == "all" and (carried.plan or design.goal):
        raise InputError(
            "--task all builds the shipped tasks; files of your own go with a single task"
        )
    if task == "all" and robot is not None:
        raise InputError("robots stand in one world; --robot goes with a single task")
    if key is not None and robot is None:
        raise InputError("--key is of robots on a network; --robot HOST:PORT says where they are")
    setup = physics.setup()
    if task == "all":
        names = TASK_NAMES
    else:
        names = (task,)
    planned: list[tuple[Task, Plan | Replanning]] = []
    for name in names:
        if carried.plan == AUTO:
            planned.append((read_goal(name, design.goal), Replanning()))
        else:
            planned.append(planned_task(name, carried.plan_file, design.goal))
    filming = video and rendering_works()
    films = dict[str, Path]()
    episodes = list[Episode]()
    for built, plan in planned:
        with (
            nullcontext(set_up) if robot is None else robots_at(robot, timeout, key) as place,
            counting(f"actions of {built.name}", attrgetter("agrees"))(_n_actions(plan)) as tell,
        ):
            episode = run_plan(
                built, plan, setup, physics.seed, carried.order, _telling(tell), place
            )
        assert episode.trajectory is not None
        episode.trajectory.write(out / f"{built.name}{SUFFIX}")
        write_table(out / f"{built.name}{LOG_SUFFIX}", episode.logs)
        if filming:
            from craftsim.rendering.render import render

            films[built.name] = out / f"{built.name}.mp4"
            render(episode.trajectory, films[built.name], progress=counting("frames", bool))
        episodes.append(replace(episode, trajectory=None, logs={}))
    config: dict[str, Any] = {**setup.provenance, "order": carried.order, "rules": setup.rules}
    config |= {"robot": robot, "randomize": physics.randomize}
    figures: dict[str, Any] = episodes[0].figures
    if task == "all":
        config["tasks"] = {built.name: _files(built, plan) for built, plan in planned}
        figures = {
            "tasks": {episode.name: episode.figures for episode in episodes},
            "good": sum(episode.succeeded for episode in episodes),
            "agree": sum(episode.n_agree for episode in episodes),
            "total": sum(episode.n_planned for episode in episodes),
        }
    else:
        config |= _files(*planned[0])
    wall = {"total_s": time.perf_counter() - started}
    written = document(figures, command="demo", seed=physics.seed, config=config, wall=wall)
    return publish(demo_report(episodes, command_again(), written, films), out)


def _n_actions(plan: Plan | Replanning) -> int | None:
    """Return the number of a plan's actions; None where it is yet to be made."""
    from craftsim.planning.plan_file import Plan

    if not isinstance(plan, Plan):
        return None
    return sum(map(len, plan.ticks))


def _files(task: Task, plan: Plan | Replanning) -> dict[str, str | None]:
    """Return the names of the files of a task with a plan, and the task's digest."""
    from craftsim.planning.plan_file import Plan
    from craftsim.validation.sources import AUTO

    return {
        "task": task.name,
        "task_digest": task.digest,
        "blueprint": task.starts[0].path.name,
        "plan": plan.path.name if isinstance(plan, Plan) else AUTO,
        "goal": task.design.path.name if task.design else None,
    }


def _telling(tell: Callable[[Any], None]) -> Callable[[Any], Callable[[Iterable[Any]], None]]:
    def tell_each(attempts: Iterable[Any]) -> None:
        for attempt in attempts:
            tell(attempt)

    return lambda judge: tell_each
