"""Golden records of what Python calls: rules, plans, worlds in physics, policies, names, machines and files."""

from __future__ import annotations

import inspect
import re
from collections import Counter
from typing import Any

import numpy as np
from discrete.worldgen import play, random_world

import craftsim
from craftsim import Action, Rules, make_task
from craftsim.audit.plan import audit_plan, quick_rows
from craftsim.audit.situation import Situation
from craftsim.checking.setup import RANDOMIZE, Seed, nominal_gains, set_up, setup_of
from craftsim.designs.drawn import random_start
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.files.design import design_text
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.rules import RuleSet
from craftsim.learning.policy import load_policy
from craftsim.learning.policy_files import shipped_policies
from craftsim.mjcf.machines import NOMINAL
from craftsim.skills.gains import load_gains
from craftsim.tasks import TASK_NAMES
from craftsim.validation.worlds import RandomWorlds

from .golden import digest, record, text

RULE_SETS = ("published", "physical")
DRIVES = ("rollers", "wheels")


@record("python", fast=True)
def public_names() -> Any:
    """Names of ``import craftsim`` with what they are and how they are called."""
    signatures = {}
    for name in craftsim.__all__:
        if name != "__version__":
            signatures[name] = _signature(getattr(craftsim, name)).split(", ")
    return signatures


def _signature(thing: Any) -> str:
    kind = (
        "class"
        if inspect.isclass(thing)
        else "function"
        if callable(thing)
        else type(thing).__name__
    )
    try:
        return re.sub(r" at 0x[0-9a-f]+", "", f"{kind}{inspect.signature(thing)}")
    except (TypeError, ValueError):
        return kind


@record("everywhere")
def digests() -> Any:
    """Digests of gains and machines, and bytes of written blueprints and designs."""
    rng = np.random.default_rng(11)
    drawn = [random_start(rng) for _ in range(10)]
    return _digests() | {
        "random worlds": [digest(blueprint_text(RandomWorlds().grid(rng))) for _ in range(20)],
        "random designs": [
            [digest(blueprint_text(one.grid)), digest(design_text(one.design))] for one in drawn
        ],
    }


@record("everywhere", fast=True)
def digests_of_some() -> Any:
    """The same with one easy random design, which take most of the time, and few worlds."""
    rng = np.random.default_rng(11)
    one = random_start(rng, 0.0)
    return _digests() | {
        "random design": [digest(blueprint_text(one.grid)), digest(design_text(one.design))],
        "random worlds": [digest(blueprint_text(RandomWorlds().grid(rng))) for _ in range(5)],
    }


def _digests() -> dict[str, Any]:
    starts = {name: make_task(name).draw(np.random.default_rng(0)) for name in TASK_NAMES}
    return {
        "machines": NOMINAL.digest,
        "gains": {name: load_gains(name).digest for name in ("robust", "fast")},
        "nominal gains": nominal_gains().digest,
        "starts": {name: digest(blueprint_text(grid)) for name, grid in starts.items()},
    }


@record("everywhere")
def explanations() -> Any:
    """The explanation of every action in 2,000 random worlds, most of them in the middle of a play."""
    return {rules: _explained(Rules(rules), 500, 3) for rules in RULE_SETS}


@record("everywhere", fast=True)
def explanations_of_some() -> Any:
    """The same in a few of these worlds."""
    return {rules: _explained(Rules(rules), 12, 3) for rules in RULE_SETS}


def _explained(rules: Rules, n: int, ticks: int) -> dict[str, Any]:
    worlds: list[str] = []
    kinds: Counter[str] = Counter()
    for i in range(n):
        rng = np.random.default_rng([7, i])
        grids = [random_world(rng) if i % 4 else RandomWorlds().grid(rng)]
        grids += [grid for _, grid in play(rules, grids[0], rng, ticks)]
        said = []
        for grid in grids:
            for car in range(grid.n_cars):
                for action in Action:
                    why = rules.explain(grid, car, action)
                    said.append(f"{car} {why}")
                    kinds[
                        "legal"
                        if why.legal
                        else why.correction.name
                        if why.correction
                        else "the published rules"
                    ] += 1
        worlds.append(digest("\n".join(said)))
    return {
        "by correction": dict(kinds),
        "by ten worlds": [digest("".join(worlds[i : i + 10])) for i in range(0, n, 10)],
    }


@record("everywhere")
def situations() -> Any:
    """All that an audit tries: by action its rows, and their situations with worlds and actions; the quick choice."""
    return {rules: _audited(rules) for rules in RULE_SETS}


def _audited(rules: RuleSet) -> dict[str, Any]:
    plan = audit_plan(rules)
    by_action: dict[str, list[str]] = {}
    for row in plan:
        said = [
            row.name,
            row.legal,
            row.no_prediction,
            row.clearance_mm,
            *map(_situation, row.members),
        ]
        by_action.setdefault(row.row.action, []).append(text(said))
    every = [member for row in plan for member in row.members]
    rng = np.random.default_rng(5)
    return {
        "rows": len(plan),
        "situations": len(every),
        "by action": {action: digest("\n".join(rows)) for action, rows in by_action.items()},
        "quick": digest(
            "\n".join(f"{row.name} {row.members[0].id}" for row in quick_rows(plan, rules))
        ),
        "placed": digest("\n".join(text(_situation(one.placed(rng))) for one in every[::10])),
        "draws": digest("\n".join(str(one.digest) for one in every)),
    }


def _situation(one: Situation) -> list[Any]:
    acts, grid = [act.name for act in one.acts], one.grid
    world = digest(grid.cells.astype("<i2").tobytes() + grid.cars.astype("<i2").tobytes())
    return [one.id, grid.size, world, acts, one.order]


@record("everywhere")
def plans() -> Any:
    """Plans of the six tasks and of 30 random designs, by a fixed number of rounds."""
    found = {}
    for name in TASK_NAMES:
        task = make_task(name)
        found[name] = _planned(task.draw(np.random.default_rng(0)), task)
    for seed in range(30):
        drawn = random_start(np.random.default_rng([3, seed]), 0.4)
        found[f"design {seed}"] = _planned(drawn.grid, drawn.design)
    return found


def _planned(start: Any, goal: Any) -> Any:
    try:
        planned = craftsim.plan(start, goal, rounds=3, time_s=600.0, seed=1)
    except craftsim.errors.CraftsimError as error:
        return str(error)
    acts = [[[car, Action(action).name] for car, action in tick] for tick in planned.ticks]
    return {
        "ticks": len(acts),
        "actions": sum(map(len, acts)),
        "makespan_s": round(planned.makespan_s, 6),
        "plan": digest(text(acts)),
    }


@record()
def motion() -> Any:
    """Positions after 5 s of the shipped plan of each task on each drive under each preset."""
    found = {}
    for name in TASK_NAMES:
        task = make_task(name)
        start = task.draw(np.random.default_rng(0))
        actions = craftsim.read_plan(shipped_plan(name), start.n_cars).ticks
        for drive in DRIVES:
            for preset in RANDOMIZE:
                judge = set_up(start, setup_of(preset, drive=drive), Seed((5,)))
                for tick in actions:
                    if judge.physics.time_s > 5.0:
                        break
                    judge.perform_tick(tick)
                data = judge.physics.data
                found[f"{name} {drive} {preset}"] = [
                    round(data.time, 3),
                    digest(data.qpos.tobytes() + data.qvel.tobytes()),
                ]
    return found


@record()
def policies() -> Any:
    """Actions of the shipped policies on 50 starts each."""
    found = {}
    for name in shipped_policies():
        policy = load_policy(name, seed=3)
        env = craftsim.parallel_env(name, "grid")
        chosen = []
        for seed in range(50):
            observations, _ = env.reset(seed=seed)
            chosen.append([policy(observations)[agent] for agent in sorted(observations)])
        found[name] = [digest(text(chosen[i : i + 10])) for i in range(0, 50, 10)]
    return found
