"""Build the six tasks by plans that are made again, on a workshop floor behind a network, and with a car that dies.

    python scripts/network_plans.py             # 20 buildings of each task in both conditions: half an hour
    python scripts/network_plans.py strip block --episodes 3 --conditions "a car dies" --resume

Behind the network commands and measurements are late, and some are lost. In "a car dies" one is out of action when its
second action begins, on the floor alone; a building counts there if a plan without that car exists from the start, and
if it did not end for want of blocks, of which the car keeps the one below which it stands. Cars go back after failures
and seat loads again, as with 'craftsim validate --plan auto'.
"""

from __future__ import annotations

import math
import re
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, Final, cast

import numpy as np
from network_causes import NETWORK
from running import (
    EpisodeCase,
    NetworkEpisodes,
    check_known,
    condition_options,
    options,
    publish,
)

from craftsim.checking.setup import set_up, setup_of
from craftsim.discrete.rules import Rules
from craftsim.experiments.experiment import Result
from craftsim.experiments.intervals import Proportion
from craftsim.experiments.report_parts import measurement_headline
from craftsim.planning import NoPlanError, Planned, plan_building
from craftsim.reports.json_file import document
from craftsim.reports.report import DataTable, Report, Section, numbers
from craftsim.skills.library import WENT_BACK
from craftsim.tasks import TASK_NAMES, as_task
from craftsim.validation.replanning import Replanning
from craftsim.validation.rollout import EpisodeJob, roll_out

BEHIND: Final = "floor and network"
DIES: Final = "a car dies"
CONDITIONS: Final = (BEHIND, DIES)
_ROUNDS: Final = 60
"""Attempts at each plan, as of 'craftsim validate'."""
_TOO_FEW: Final = "no plan: not enough blocks"
_PROVED: Final = "gave up: no plan: "
"""How a loss begins in which the planner has proved that no plan exists from the world that was read."""


def building(case: EpisodeCase) -> Result:
    """Build once, and return how it ended and what it took."""
    task_name, condition, number = case
    setup = setup_of("workshop_floor", drive="rollers")
    place = set_up
    disturb = None
    if condition == BEHIND:
        from craftsim.robots.server import Network
        from craftsim.robots.simulated import simulated_network

        place = simulated_network(Network(*NETWORK))
    else:
        disturb = "dead-early"
    job = EpisodeJob(
        key=f"{task_name}, {condition}, {number}",
        world=task_name,
        behaviour=Replanning(rounds=_ROUNDS, disturb=cast(Any, disturb)),
        episode=number,
        seed=0,
        setup=setup,
        set_up=place,
    )
    episode = roll_out(job)
    performed = [attempt for attempt in episode.attempts if attempt.performed]
    ending = dict(episode.ending or {})
    extra = {
        "built": ending["ended"] == "built",
        "ended": ending["ended"],
        "why": ending["why"],
        "seconds": episode.makespan_s,
        "actions": len(performed),
        "failed": sum(attempt.skill != "succeeded" for attempt in performed),
        "retried": sum(attempt.tries > 1 for attempt in performed),
        "went_back": sum(attempt.skill.endswith(WENT_BACK) for attempt in performed),
        "seated": ending["seated"],
        "plans": 1 + int(ending["replans"]),
        "disturbed": ending["disturbed"],
        "counts": condition == BEHIND or _counts(task_name, ending),
    }
    return Result(agrees=extra["built"], extra=extra)


def _counts(task_name: str, ending: Mapping[str, Any]) -> bool:
    """Return whether a car has died that the design can be built without, and blocks did not run out."""
    dead = re.match(r"car (\d+) is out of action", ending["disturbed"])
    if dead is None or ending["why"].startswith(_TOO_FEW):
        return False
    return can_do_without(task_name, int(dead[1]))


@cache
def can_do_without(task_name: str, car: int) -> bool:
    """Return whether the planner finds a plan for a task from a start without a car."""
    task = as_task(task_name)
    start = task.draw(np.random.default_rng(0))
    start.cars = np.delete(start.cars, car, axis=0)
    if not start.n_cars:
        return False
    try:
        plan_building(
            start, task, Rules("physical"), rounds=_ROUNDS, time_s=math.inf, report=_has_plan
        )
    except NoPlanError:
        return False
    return True


def _has_plan(attempts: int, best: Planned | None) -> bool:
    """Return whether there is a plan, which ends the search."""
    return best is not None


def summary(runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return what the buildings of one task in one condition come to, of those that count."""
    counted = [run for run in runs if run["counts"]]
    built = [run for run in counted if run["built"]]
    lost = [f"{run['ended']}: {run['why']}" for run in counted if not run["built"]]
    makespan_s = None
    if built:
        makespan_s = sum(run["seconds"] for run in built) / len(built)
    return {
        "success": Proportion.of(len(built), len(counted)),
        "left_out": len(runs) - len(counted),
        "makespan_s": makespan_s,
        "lost": lost,
        **{
            name: sum(run[name] for run in counted)
            for name in ("actions", "failed", "retried", "went_back", "seated", "plans")
        },
    }


def plans_report(
    tasks: Sequence[str], conditions: Sequence[str], episodes: int, seed: int, out: Any, run: Any
) -> Report:
    """Build so many of each task in each condition, and return the report.

    Raises InputError for an unknown task or condition.
    """
    check_known("task", tasks, TASK_NAMES)
    check_known("condition", conditions, CONDITIONS)
    config = {"tasks": tasks, "episodes": episodes, "conditions": conditions}
    played = NetworkEpisodes(
        script="network_plans",
        subjects=tasks,
        conditions=conditions,
        seed=seed,
        episodes=episodes,
        config=config,
    ).play(building, out, run)
    figures = {group: summary(runs) for group, runs in played.by_group.items()}
    columns = numbers("task", *HEADS[1:])
    rows = [(group, *cells(row)) for group, row in figures.items()]
    note = (
        "Failed: actions whose skill did not succeed; tried again: actions; went back: cars after a failed action; "
        "seated: loads that sat off their seats and were lifted again. Left out: no plan without the car that died, or "
        "too few blocks in the end, of which that car keeps the one below which it died."
    )
    return Report(
        "Plans behind a network",
        "buildings by plans that are made again",
        measurement_headline(f"{', '.join(tasks)}: {', '.join(conditions)}", played.n_lost),
        sections=[
            Section(
                "buildings", "Buildings", note, [DataTable(columns, rows, "Runs")], terminal=True
            )
        ],
        document=document(figures, command="network_plans", seed=seed, config=config),
    )


HEADS: Final = (
    *("task", "built", "left out", "makespan, s", "actions failed", "tried again"),
    *("went back", "seated", "plans", "what was left"),
)


def cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the cells of a row of figures, fresh or stored, after its task."""
    share = row["success"]
    if isinstance(share, Proportion):
        share = vars(share)
    makespan_s = ""
    if row["makespan_s"] is not None:
        makespan_s = f"{row['makespan_s']:.0f}"
    return (
        f"{share['successes']}/{share['trials']}",
        str(row["left_out"]),
        makespan_s,
        f"{row['failed']}/{row['actions']:,}",
        *(str(row[name]) for name in ("retried", "went_back", "seated", "plans")),
        "; ".join(row["lost"]),
    )


def table_rows(figures: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return a table of stored figures: of each task, what is built in both conditions, and how the others ended."""
    rows: list[tuple[str, ...]] = [("task", *CONDITIONS, "left out", "what was left")]
    for name in TASK_NAMES:
        of_task = [figures[f"{name}, {condition}"] for condition in CONDITIONS]
        built = [f"{row['success']['successes']}/{row['success']['trials']}" for row in of_task]
        ends = Counter[str]()
        for row in of_task:
            ends.update(map(_ending, row["lost"]))
        left = "; ".join(f"{number} {end}" for end, number in ends.items())
        rows.append((name, *built, str(of_task[1]["left_out"]), left))
    return rows


def _ending(lost: str) -> str:
    """Return how a building ended that was lost, in a few words."""
    if lost.startswith(_PROVED):
        return "no plan exists"
    return lost.partition(": ")[0]


def main(words: Sequence[str] | None = None) -> int:
    """Build the tasks."""
    parser = options(__doc__, "network_plans")
    parser.add_argument(
        "tasks", nargs="*", metavar="TASK", help=f"default: {', '.join(TASK_NAMES)}"
    )
    condition_options(parser, CONDITIONS, episodes=20)
    asked = parser.parse_args(words)
    tasks = [*dict.fromkeys(asked.tasks)] or [*TASK_NAMES]
    conditions = [*dict.fromkeys(asked.conditions)]
    return publish(
        asked,
        "buildings",
        lambda run: plans_report(tasks, conditions, asked.episodes, asked.seed, asked.out, run),
    )


if __name__ == "__main__":
    import network_plans  # by its own name: a worker cannot be sent what is cached in __main__

    sys.exit(network_plans.main())
