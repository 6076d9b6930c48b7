"""Play policies asynchronously on a workshop floor and behind a network, and find the causes of failed buildings.

    python scripts/network_causes.py            # 11 conditions, 4 tasks, 5 starts: an hour of CPU time
    python scripts/network_causes.py random_strip --episodes 25 --conditions "floor and network" --resume
    python scripts/execution.py --seeds 1 --train asynchronous    # policies, trained further, to be named here

Conditions are the grid, on which nothing but the policy can fail, the floor alone, delay, jitter and loss each alone,
the network alone, and both. With "recovers" a car whose action failed goes back to where that began, and the planner
goes on where a policy gets no further; a car that waits decides when another action has ended. Robots are on rollers.
Of each run that is not built it says what failed first and why, how it ended, and what would have been needed.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, Final, NamedTuple

from running import (
    EpisodeCase,
    NetworkEpisodes,
    check_known,
    condition_options,
    options,
    publish,
)

from craftsim.checking.attempt import Verdict
from craftsim.checking.setup import RANDOMIZE, Randomize
from craftsim.checking.thresholds import thresholds_of
from craftsim.envs import parallel_env
from craftsim.envs.planner import PlannerPolicy
from craftsim.experiments.experiment import Result
from craftsim.experiments.intervals import Proportion
from craftsim.experiments.report_parts import measurement_headline
from craftsim.learning.policies import policy_digest
from craftsim.learning.policy import load_policy
from craftsim.learning.settings import BackendChoice
from craftsim.mjcf.machines import NOMINAL
from craftsim.reports.json_file import document
from craftsim.reports.report import DataTable, Report, Section, numbers
from craftsim.skills.library import WENT_BACK
from craftsim.tasks import as_task

TASKS: Final = (
    "random_strip",
    "random_block",
    "random_simple_two_story",
    "random_breaking_barrier",
)
_TOLD: Final = 3
"""Actions beyond limits whose reasons are kept."""
LOST_M: Final = 0.005
"""A car that believes to be so far beside its place has lost it; a good estimate is off by 1 mm."""


class Condition(NamedTuple):
    """Floor and network of an episode."""

    randomize: Randomize
    network: tuple[float, float, float] | None = None
    """Delay and jitter in seconds, and loss; None without a network."""
    recovers: bool = False
    backend: BackendChoice = "physics"
    wait_s: float = 1.0
    """As of environments: after this time, at the latest, a car that waits decides again."""


TRAINED: Final = "out/execution/{}-asynchronous-0"
"""Folder of the policy for a task that scripts/execution.py trained further, asynchronously with failures."""
_BOTH: Final = "floor and network"
_WAITS: Final = "floor and network, waits"
_RECOVERS: Final = "floor and network, recovers"
NETWORK: Final = (0.03, 0.01, 0.02)
CONDITIONS: Final = {
    "grid": Condition("none", backend="grid"),
    "neither": Condition("mild"),
    "delay": Condition("mild", (0.03, 0.0, 0.0)),
    "jitter": Condition("mild", (0.01, 0.01, 0.0)),
    "loss": Condition("mild", (0.0, 0.0, 0.02)),
    "network": Condition("mild", NETWORK),
    "floor": Condition("workshop_floor"),
    _BOTH: Condition("workshop_floor", NETWORK),
    _WAITS: Condition("workshop_floor", NETWORK, wait_s=20.0),
    _RECOVERS: Condition("workshop_floor", NETWORK, recovers=True, wait_s=20.0),
    "lab floor and network, recovers": Condition("lab_floor", NETWORK, recovers=True, wait_s=20.0),
}
"""Jitter takes a delay as long. On the floor an action takes 2 to 5 s: with waits of a second, a car that waits for
another one uses up the decisions of both."""
_SUMS: Final = ("built", "runs", "built_s", "actions", "failed", "planner_runs")


def episode(case: EpisodeCase) -> Result:
    """Play an episode and return how it ended, and each action that failed or ended in a wrong cell."""
    name, condition, seed = case
    env = _env(name, condition)
    trained = load_policy(name, seed)
    planner = PlannerPolicy(env, policy=trained)
    policy = planner if CONDITIONS[condition].recovers else trained
    observations, _ = env.reset(seed=seed)
    failures = list[dict[str, Any]]()
    seconds = 0.0
    n_actions = n_retried = n_went_back = 0
    off_limits = list[str]()
    info: Mapping[str, Any] = {}
    while env.agents:
        observations, _, _, _, infos = env.step(policy(observations))
        for car, agent in enumerate(env.possible_agents):
            info = infos[agent]
            if info.get("outcome") in (None, "not performed"):
                continue
            n_actions += 1
            n_retried += info["result"] == Verdict.RETRIED
            n_went_back += info["outcome"].endswith(WENT_BACK)
            if info["outcome"] != "succeeded" or info["failed"]:
                failures.append(_failure(env, car, info, seconds + info["duration_s"]))
            elif not info["result"].startswith("as predicted"):
                off_limits.append(f"{seconds:.2f} s, {agent}: {info['reason']}")
        seconds += info["duration_s"]
    extra = {
        "success": bool(info["success"]),
        "seconds": round(seconds, 3),
        "actions": n_actions,
        "retried": n_retried,
        "went_back": n_went_back,
        "plans": planner.n_plans,
        "replaces": planner.replaces,
        "off_limits": len(off_limits),
        "first_off_limits": off_limits[:_TOLD],
        "failures": failures,
        "deadlock": str(info["deadlock"].words) if info["deadlock"] else "",
        "problems": list(info["problems"]),
    }
    return Result(agrees=extra["success"], extra=extra)


def _failure(env: Any, car: int, info: Mapping[str, Any], time_s: float) -> dict[str, Any]:
    """Return what is known of a failed action: the skill's report, and how far the car's belief is from its place."""
    judge = env.core.backend.judge
    reading = judge.executor.readings()[car]
    x, y, _ = judge.poses.car_positions[car].tolist()
    return {
        "time_s": round(time_s, 3),
        "car": car,
        "outcome": info["outcome"],
        "reason": info["reason"],
        "differences": list(info["disagreement"]),
        "bystander_m": info["bystander_displacement_m"],
        "astray_m": round(math.hypot(float(reading["x"]) - x, float(reading["y"]) - y), 5),
    }


def cause_of(failure: Mapping[str, Any]) -> str:
    """Return why an action failed."""
    outcome = failure["outcome"]
    if failure["astray_m"] > LOST_M:
        return "the car had lost its place"
    if outcome.startswith("disconnected"):
        return "messages were late"
    if outcome.startswith("blocked"):
        if (failure["bystander_m"] or 0.0) > thresholds_of(NOMINAL).place_m:
            return "the car collided"
        return "the car was blocked"
    if outcome.startswith("load lost"):
        return "the load was lost"
    if outcome == "succeeded":
        return "the car was in a wrong cell"
    return "the car stalled"


def end_of(run: Mapping[str, Any]) -> str:
    """Return how a run ended that is not built."""
    problems = "; ".join(run["problems"])
    if problems.startswith("car "):
        return "a car between cells"
    if problems:
        return "an object between cells"
    if run["deadlock"]:
        return "a deadlock"
    return "no decisions left"


NEEDED: Final = {
    "a car between cells": "go back to the cell",
    "an object between cells": "pick it up and set it down again",
    "a deadlock": "another action",
    "no decisions left": "another action",
}
"""What would have been needed, for each end."""


def summary(runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return what the runs of one condition come to."""
    built = [run for run in runs if run["success"]]
    causes = Counter[str]()
    ends = Counter[str]()
    for run in runs:
        if run["success"]:
            continue
        ends[end_of(run)] += 1
        if run["failures"]:
            causes[cause_of(run["failures"][0])] += 1
        elif run["problems"]:
            causes["objects were displaced"] += 1
        else:
            causes["no action failed"] += 1
    makespan_s = None
    if built:
        makespan_s = sum(run["seconds"] for run in built) / len(built)
    return {
        "success": Proportion.of(len(built), len(runs)),
        "makespan_s": makespan_s,
        "actions": sum(run["actions"] for run in runs),
        "failed": sum(len(run["failures"]) for run in runs),
        "off_limits": sum(run["off_limits"] for run in runs),
        "retried": sum(run["retried"] for run in runs),
        "went_back": sum(run["went_back"] for run in runs),
        "planner_runs": sum(bool(run["replaces"]) for run in runs),
        "plans": sum(run["plans"] for run in runs),
        "causes": dict(causes.most_common()),
        "ends": dict(ends.most_common()),
    }


@lru_cache(maxsize=8)
def _env(name: str, condition: str) -> Any:
    """Return the environment of a policy in a condition, kept for its next episode."""
    randomize, network, recovers, backend, wait_s = CONDITIONS[condition]
    config = load_policy(name).config
    chosen: dict[str, Any] = {
        "rule_set": config.rules,
        "helper_depth": config.helper_depth,
        "wait_s": wait_s,
    }
    if backend == "physics":
        chosen |= {"randomization": RANDOMIZE[randomize], "drive": "rollers", "recovers": recovers}
    if network is not None:
        from craftsim.robots.server import Network
        from craftsim.robots.simulated import simulated_network

        chosen["robots"] = simulated_network(Network(*network))
    task = as_task(config.task, config.n_cars, config.n_blocks)
    return parallel_env(task, backend, execution="asynchronous", **chosen)


def causes_report(
    policies: Sequence[str], conditions: Sequence[str], episodes: int, seed: int, out: Any, run: Any
) -> Report:
    """Play so many episodes of each policy in each condition, and return the report.

    Raises InputError for what is no trained policy, and for an unknown condition.
    """
    check_known("condition", conditions, CONDITIONS)
    digests = {name: policy_digest(name) for name in policies}
    chosen = {name: CONDITIONS[name] for name in conditions}
    config = {"policies": digests, "episodes": episodes, "conditions": chosen}
    played = NetworkEpisodes(
        script="network_causes",
        subjects=policies,
        conditions=conditions,
        seed=seed,
        episodes=episodes,
        config=config,
    ).play(episode, out, run)
    figures = {group: summary(runs) for group, runs in played.by_group.items()}
    rows = [(group, *_cells(row)) for group, row in figures.items()]
    columns = numbers(
        *("policy", "built", "makespan, s", "failed", "beyond limits"),
        *("tried again", "went back", "planner", "plans"),
    )
    causes = []
    for group, row in figures.items():
        for kind in ("causes", "ends"):
            for words, number in row[kind].items():
                causes.append((group, kind, words, str(number), NEEDED.get(words, "")))
    tables = [
        DataTable(columns, rows, "Runs"),
        DataTable(
            numbers("policy", "", "", "runs", "needed"), causes, "Of runs that are not built"
        ),
    ]
    note = (
        "Same starts in all conditions. Failed: actions whose skill did not succeed, or that ended in a wrong cell; "
        "beyond limits: others that the judge does not accept; tried again: actions; went back: cars after a failed "
        "action; planner: runs in which it goes on in place of the policy. Causes are of a run's first failed action."
    )
    return Report(
        "Floor and network",
        "causes of buildings that are not finished",
        measurement_headline(f"{', '.join(policies)}: {len(conditions)} conditions", played.n_lost),
        sections=[Section("causes", "Causes", note, tables, terminal=True)],
        document=document(figures, command="network_causes", seed=seed, config=config),
    )


def causes_rows(stored: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return a table of stored figures: of each condition, how many each policy built, and why not the others."""
    groups = _merged(stored)
    rows: list[tuple[str, ...]] = [("condition", *TASKS, "actions failed", "of lost runs")]
    for condition in dict.fromkeys(condition for _, condition in groups):
        of_tasks = [groups[task, condition] for task in TASKS]
        causes = Counter[str]()
        for row in of_tasks:
            causes.update(row["causes"])
        n_failed = sum(row["failed"] for row in of_tasks)
        failed = f"{n_failed:,}/{sum(row['actions'] for row in of_tasks):,}"
        built = (_share_of(row) for row in of_tasks)
        rows.append((condition, *built, failed, _listed(causes)))
    return rows


def recovery_rows(stored: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return a table of stored figures: of each policy, what it built with recovery and without, and how."""
    heads = ("policy", "recovers", "built", "makespan, s", "actions failed", "planner went on")
    rows: list[tuple[str, ...]] = [(*heads, "what was left")]
    groups = _merged(stored)
    for task in TASKS:
        trained = TRAINED.format(task)
        for policy, condition, word in (
            (task, _WAITS, "no"),
            (task, _RECOVERS, "yes"),
            (trained, _RECOVERS, "yes"),
        ):
            if (policy, condition) not in groups:
                continue
            row = groups[policy, condition]
            makespan_s = ""
            if row["built"]:
                makespan_s = f"{row['built_s'] / row['built']:.0f}"
            failed = f"{row['failed']}/{row['actions']:,}"
            planner_runs = str(row["planner_runs"])
            cells = (_share_of(row), makespan_s, failed, planner_runs, _listed(row["ends"]))
            name = f"{task}, trained further" if policy == trained else task
            rows.append((name, word, *cells))
    return rows


def built_of(stored: Sequence[Mapping[str, Any]], recovers: bool) -> Proportion:
    """Return how many of all runs on the floor and behind the network are built, with recovery or without.

    In both cars wait as long for one another.
    """
    groups = _merged(stored)
    condition = _RECOVERS if recovers else _WAITS
    built = sum(groups[task, condition]["built"] for task in TASKS)
    return Proportion.of(built, sum(groups[task, condition]["runs"] for task in TASKS))


def _merged(stored: Sequence[Mapping[str, Any]]) -> dict[tuple[str, str], dict[str, Any]]:
    """Return the sums of stored figures by policy and condition."""
    groups = dict[tuple[str, str], dict[str, Any]]()
    for figures in stored:
        for group, row in figures.items():
            task, _, condition = group.partition(", ")
            total = groups.setdefault(
                (task, condition),
                {**dict.fromkeys(_SUMS, 0), "causes": Counter(), "ends": Counter()},
            )
            built = row["success"]["successes"]
            total["built"] += built
            total["runs"] += row["success"]["trials"]
            total["built_s"] += built * (row["makespan_s"] or 0.0)
            for name in ("actions", "failed", "planner_runs"):
                total[name] += row.get(name, 0)
            for name in ("causes", "ends"):
                total[name].update(row[name])
    return groups


def _share_of(row: Mapping[str, Any]) -> str:
    return f"{row['built']}/{row['runs']}"


def _listed(counts: Mapping[str, int]) -> str:
    return "; ".join(f"{number} {words}" for words, number in counts.items() if number)


def _cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    share: Proportion = row["success"]
    makespan_s = row["makespan_s"]
    return (
        f"{share.successes}/{share.trials}",
        "" if makespan_s is None else f"{makespan_s:.1f}",
        f"{row['failed']}/{row['actions']}",
        *(
            str(row[name])
            for name in ("off_limits", "retried", "went_back", "planner_runs", "plans")
        ),
    )


def main(words: Sequence[str] | None = None) -> int:
    """Play the policies."""
    parser = options(__doc__, "network_causes")
    parser.add_argument(
        "policies", nargs="*", metavar="POLICY", help=f"default: {', '.join(TASKS)}"
    )
    condition_options(parser, CONDITIONS, episodes=5)
    asked = parser.parse_args(words)
    policies = [*dict.fromkeys(asked.policies)] or TASKS
    conditions = [*dict.fromkeys(asked.conditions)]
    return publish(
        asked,
        "episodes",
        lambda run: causes_report(policies, conditions, asked.episodes, asked.seed, asked.out, run),
    )


if __name__ == "__main__":
    import network_causes  # by its own name: a worker cannot be sent what is cached in __main__

    sys.exit(network_causes.main())
