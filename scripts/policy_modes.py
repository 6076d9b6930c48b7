"""Play policies synchronously and asynchronously, on the grid, in physics and behind a network, from the same starts.

    python scripts/policy_modes.py random_strip out/train/apart --episodes 20

Physics is with mild randomization. At most 10 episodes are played as robots on rollers, on a
workshop floor, behind a network (delay 30 ms, jitter 10 ms, loss 2 % each way). The folder also takes a file a policy
of worlds at random times of its asynchronous episodes in physics, for ``craftsim train --starts FILE``.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NamedTuple, cast

import numpy as np
from running import options, publish

from craftsim.checking.setup import RANDOMIZE, Randomize
from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint
from craftsim.discrete.kinds import Execution
from craftsim.envs import parallel_env
from craftsim.experiments.experiment import Experiment, Result, RunOptions, Trial
from craftsim.experiments.intervals import Proportion
from craftsim.experiments.ranges import TRIAL_COUNT
from craftsim.experiments.report_parts import measurement_headline
from craftsim.experiments.session import run_experiment
from craftsim.experiments.statistics import carried_out
from craftsim.learning.policies import policy_digest
from craftsim.learning.policy import load_policy
from craftsim.learning.settings import BackendChoice
from craftsim.mjcf.drives import Drive
from craftsim.reports.json_file import document
from craftsim.reports.report import DataTable, Report, Section, numbers
from craftsim.robots import need_network
from craftsim.tasks import as_task
from craftsim.tasks.starts import save_starts

TIMEOUT_S: Final = 3600.0
"""After which an episode counts as hanging."""


class Mode(NamedTuple):
    """How a policy is executed."""

    backend: BackendChoice
    execution: Execution
    randomize: str
    drive: Drive = "wheels"
    network: tuple[float, float, float] | None = None
    """Delay and jitter in seconds, and loss, of the network between the policy with its skills and the robots."""
    most: int = 1_000_000

    def __str__(self) -> str:
        drawn = self.randomize if self.network is None else "network"
        return f"{self.backend} {self.execution}{'' if self.backend == 'grid' else f', {drawn}'}"


MODES: Final = (
    Mode("grid", "synchronous", "none"),
    Mode("grid", "asynchronous", "none"),
    Mode("physics", "synchronous", "mild"),
    Mode("physics", "asynchronous", "mild"),
    # On the reference model of wheels.
    Mode("physics", "asynchronous", "workshop_floor", "rollers", (0.03, 0.01, 0.02), 10),
)
REACHED: Final = MODES[3]
"""The mode whose worlds are saved as starts for training."""


PolicyCase = tuple[str, Mode, int]
"""A shipped policy or its path, how it is executed, and the seed of the start, which is the same in all modes."""


def episode(case: PolicyCase) -> Result:
    """Play an episode and return its success, simulated seconds, decisions, and what went wrong.

    ``blocked`` counts decisions that a claim stood against, ``failed`` actions whose skill did not succeed; ``reached``
    is the confirmed world at a time that is drawn, in the mode :data:`REACHED`.
    """
    name, mode, seed = case
    policy, env = load_policy(name, seed), _env(name, mode)
    observations, _ = env.reset(seed=seed)
    found: dict[str, Any] = {
        "success": False,
        "seconds": 0.0,
        "decisions": 0,
        "blocked": 0,
        "failed": 0,
    }
    reached = [(0.0, env.grid)]
    while env.agents:
        acting = list(getattr(env, "agents_to_act", env.agents))
        actions = policy(observations)
        observations, _, _, _, infos = env.step(actions)
        info = next(iter(infos.values()))
        found["success"] = bool(info["success"])
        found["seconds"] += info["duration_s"]
        found["decisions"] += len(acting)
        found["blocked"] += sum(bool(infos[agent].get("blocked")) for agent in acting)
        found["failed"] += sum(
            one.get("outcome") not in (None, "succeeded") for one in infos.values()
        )
        if mode == REACHED and env.agents:
            reached.append((found["seconds"], env.core.episodes.confirmed[0].copy()))
    found["deadlock"] = str(info["deadlock"].words) if info.get("deadlock") else ""
    found["unreadable"] = "; ".join(info["problems"])
    if mode == REACHED:
        at_s = np.random.default_rng([seed, 1]).uniform(0.0, found["seconds"])
        found["reached"] = blueprint_text([grid for time_s, grid in reached if time_s <= at_s][-1])
    found["seconds"] = round(found["seconds"], 3)
    return Result(agrees=found["success"], extra=found)


@lru_cache(maxsize=8)
def _env(name: str, mode: Mode) -> Any:
    """Return the environment of a policy in a mode, kept for its next episode."""
    config = load_policy(name).config
    options: dict[str, Any] = {"rule_set": config.rules, "helper_depth": config.helper_depth}
    if mode.backend == "physics":
        options |= {
            "drive": mode.drive,
            "randomization": RANDOMIZE[cast(Randomize, mode.randomize)],
        }
    if mode.network is not None:
        from craftsim.robots.server import Network
        from craftsim.robots.simulated import simulated_network

        options["robots"] = simulated_network(Network(*mode.network))
    task = as_task(config.task, config.n_cars, config.n_blocks)
    return parallel_env(task, mode.backend, execution=mode.execution, **options)


def policy_figures(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return what the episodes of one policy in one mode come to."""
    won = [one for one in records if one["success"]]
    decisions = sum(one["decisions"] for one in records)
    return {
        "success": Proportion.of(len(won), len(records)),
        "makespan_s": float(np.mean([one["seconds"] for one in won])) if won else None,
        "blocked_share": sum(one["blocked"] for one in records) / max(1, decisions),
        "failed": sum(one["failed"] for one in records),
        "deadlocks": sum(bool(one["deadlock"]) for one in records),
        "unreadable": sum(bool(one["unreadable"]) for one in records),
    }


def save_reached(path: Path, worlds: Iterable[str]) -> None:
    """Write the worlds that episodes reached as starts to train from."""
    grids = [parse_blueprint(text, path.name).grid(np.random.default_rng(0)) for text in worlds]
    save_starts(path, grids)


def modes_report(
    policies: Sequence[str], episodes: int, seed: int, out: Path, options: RunOptions
) -> Report:
    """Play so many episodes of each policy in each mode, and return the report.

    Raises InputError for what is no trained policy.
    """
    TRIAL_COUNT.check("--episodes", episodes)
    need_network()
    policies = [*dict.fromkeys(policies)]
    for name in policies:
        load_policy(name)
    digests = {name: policy_digest(name) for name in policies}
    config = {"policies": digests, "episodes": episodes, "modes": MODES}
    items = [
        Trial(f"{name}, {mode}, {seed + n}", f"{name}, {mode}", seed + n, (name, mode, seed + n))
        for name in policies
        for mode in MODES
        for n in range(min(episodes, mode.most))
    ]
    experiment = Experiment("policy_modes", seed, config, items, episode, timeout_s=TIMEOUT_S)
    records = run_experiment(experiment, out, options)
    played: dict[str, list[dict[str, Any]]] = {item.group: [] for item in items}
    for record in carried_out(records):
        played[record["group"]].append(record["extra"])
    figures = {
        policy: {str(mode): policy_figures(played[f"{policy}, {mode}"]) for mode in MODES}
        for policy in policies
    }
    for policy in policies:
        if some := played[f"{policy}, {REACHED}"]:
            name = re.sub(r"[^\w.-]+", "-", policy)
            save_reached(out / f"starts-{name}.npz", [one["reached"] for one in some])
    columns = numbers("mode", "success", "makespan, s", "blocked, %", "deadlocks", "failed")
    tables = [
        DataTable(columns, [(mode, *_cells(one)) for mode, one in of.items()], policy)
        for policy, of in figures.items()
    ]
    note = (
        "Paired: same starts. Makespan: mean of the episodes that succeed; blocked: decisions that a running action "
        "stood against; failed: actions whose skill did not succeed. Network: as robots on rollers, on a "
        "workshop_floor, behind a network."
    )
    sentence = f"{', '.join(policies)}: {len(MODES)} modes, from the same starts"
    lost = len(records) - sum(map(len, played.values()))
    return Report(
        "Execution of policies",
        "synchronous and asynchronous, on the grid and in physics",
        measurement_headline(sentence, lost),
        sections=[Section("modes", "Modes", note, tables, terminal=True)],
        document=document({"modes": figures}, command="policy_modes", seed=seed, config=config),
    )


def _cells(one: Mapping[str, Any]) -> tuple[str, ...]:
    share: Proportion = one["success"]
    return (
        f"{share.successes}/{share.trials} ({share.low:.2f}-{share.high:.2f})",
        "" if one["makespan_s"] is None else f"{one['makespan_s']:.1f}",
        f"{100 * one['blocked_share']:.1f}",
        str(one["deadlocks"]),
        str(one["failed"]),
    )


def main(words: Sequence[str] | None = None) -> int:
    """Play the policies."""
    parser = options(__doc__, "policy_modes")
    parser.add_argument("policies", nargs="+", metavar="POLICY", help="shipped or trained")
    parser.add_argument(
        "--episodes", type=int, default=100, metavar="N", help="of each policy and mode"
    )
    asked = parser.parse_args(words)
    return publish(
        asked,
        "episodes",
        lambda run: modes_report(asked.policies, asked.episodes, asked.seed, asked.out, run),
    )


if __name__ == "__main__":
    import policy_modes  # by its own name: a worker cannot be sent what is cached in __main__

    sys.exit(policy_modes.main())
