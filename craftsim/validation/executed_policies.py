"""What synchronous and asynchronous execution make of policies: the same policy on the grid and in physics, paired."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NamedTuple, cast

import numpy as np

from craftsim.checking.setup import RANDOMIZE, Randomize
from craftsim.choices import Backend, Execution
from craftsim.discrete.tasks import as_task
from craftsim.envs import parallel_env
from craftsim.experiments.intervals import Proportion
from craftsim.reports.json_file import document
from craftsim.reports.report import Column, DataTable, Headline, Report, Section, Tone
from craftsim.training.policy import TrainedPolicy, load_policy
from craftsim.workers.pool import Pool, answered


class Mode(NamedTuple):
    """How a policy is executed."""

    backend: Backend
    execution: Execution
    randomize: str
    """Preset of what is drawn of physics; the grid has none."""

    def __str__(self) -> str:
        drawn = "" if self.backend == "grid" else f", {self.randomize}"
        return f"{self.backend} {self.execution}{drawn}"


MODES: Final = (
    Mode("grid", "synchronous", "none"),
    Mode("grid", "asynchronous", "none"),
    Mode("physics", "synchronous", "mild"),
    Mode("physics", "asynchronous", "mild"),
    Mode("physics", "asynchronous", "workshop_floor"),
)


@dataclass(frozen=True)
class PolicyCase:
    """An episode of a policy: the same start in all modes."""

    policy: str
    """Name of a shipped policy, or a path."""
    mode: Mode
    seed: int


def episode(case: PolicyCase) -> dict[str, Any]:
    """Play an episode and return its success, simulated seconds, decisions, and what went wrong.

    ``blocked`` counts decisions that a claim stood against, ``disagreed`` actions that did not do what the rules
    predict.
    """
    policy, env = _policy(case.policy), _env(case.policy, case.mode)
    observations, _ = env.reset(seed=case.seed)
    found: dict[str, Any] = {"success": False, "seconds": 0.0, "decisions": 0, "blocked": 0, "disagreed": 0}
    while env.agents:
        acting = list(getattr(env, "agents_to_act", env.agents))
        actions = policy(observations)
        observations, _, _, _, infos = env.step(actions)
        info = next(iter(infos.values()))
        found["success"] = bool(info["success"])
        found["seconds"] += info["duration_s"]
        found["decisions"] += len(acting)
        found["blocked"] += sum(bool(infos[agent].get("blocked")) for agent in acting)
        found["disagreed"] += sum(one.get("outcome") not in (None, "succeeded") for one in infos.values())
    found["deadlock"] = str(info["deadlock"].words) if info.get("deadlock") else ""
    found["unreadable"] = "; ".join(info["problems"])
    return found | {"seconds": round(found["seconds"], 3)}


@lru_cache(maxsize=8)
def _policy(name: str) -> TrainedPolicy:
    return load_policy(name)


@lru_cache(maxsize=8)
def _env(name: str, mode: Mode) -> Any:
    """Return the environment of a policy in a mode, kept for its next episode."""
    config = _policy(name).config
    options: dict[str, Any] = {"rule_set": config.rules, "helper_depth": config.helper_depth}
    if mode.backend == "physics":
        options |= {"drive": "reduced", "randomization": RANDOMIZE[cast(Randomize, mode.randomize)][1]}
    task = as_task(config.task, config.n_cars, config.n_blocks)
    return parallel_env(task, mode.backend, execution=mode.execution, **options)


def figures_of(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return what the episodes of one policy in one mode come to."""
    won = [one for one in records if one["success"]]
    decisions = sum(one["decisions"] for one in records)
    return {
        "success": Proportion.of(len(won), len(records)),
        "makespan_s": float(np.mean([one["seconds"] for one in won])) if won else None,
        "blocked_share": sum(one["blocked"] for one in records) / max(1, decisions),
        "disagreed": sum(one["disagreed"] for one in records),
        "deadlocks": sum(bool(one["deadlock"]) for one in records),
        "unreadable": sum(bool(one["unreadable"]) for one in records),
    }


def policies_report(policies: Sequence[str | Path], episodes: int, seed: int, workers: int) -> Report:
    """Play so many episodes of each policy in each mode, from the same starts, and return the report."""
    cases = [
        PolicyCase(str(policy), mode, seed + number)
        for policy in policies
        for mode in MODES
        for number in range(episodes)
    ]
    with Pool(workers) as pool:
        found = dict(pool.map_unordered(episode, cases, batch=min(10, episodes)))
    figures: dict[str, Any] = {}
    rows = []
    for policy in map(str, policies):
        for mode in MODES:
            some = [answered(found[one]) for one in cases if one.policy == policy and one.mode == mode]
            own = figures.setdefault(policy, {})[str(mode)] = figures_of(some)
            share: Proportion = own["success"]
            shown = f"{share.rate:.3f} ({share.wilson_low:.3f} to {share.wilson_high:.3f})"
            makespan = "" if own["makespan_s"] is None else f"{own['makespan_s']:.1f}"
            counts = (own["deadlocks"], own["disagreed"], own["unreadable"])
            rows.append(
                (policy, str(mode), shown, makespan, f"{100 * own['blocked_share']:.1f}", *map(str, counts))
            )
    names = ("success", "makespan, s", "blocked, %", "deadlocks", "failed actions", "unreadable")
    table = DataTable(
        (Column("policy", "path"), Column("mode"), *(Column(name, "number") for name in names)),
        rows,
        f"{episodes} episodes each",
        "makespan: mean of the episodes that succeeded; blocked: decisions that a running action stood against",
    )
    sentence = (
        f"{len(policies)} policies in {len(MODES)} modes, {episodes} episodes each, from the same starts."
    )
    return Report(
        "Execution of policies",
        "synchronous and asynchronous, on the grid and in physics",
        Headline("Measured", Tone.PLAIN, sentence),
        sections=[Section("modes", "Modes", "Paired: same starts.", [table], terminal=True)],
        document=document(
            {"modes": figures},
            command="bench",
            seed=seed,
            config={"policies": [*map(str, policies)], "episodes": episodes},
        ),
    )
