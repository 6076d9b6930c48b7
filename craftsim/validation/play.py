"""Random play by the rules that prefers the rare: what has been done least in an episode is drawn most.

What an action is counts with what stands around it; so does what a campaign of such play has covered.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from craftsim.checking.attempt import Attempt
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.footprint import cell_of
from craftsim.discrete.grid import CarField, Cell, Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.experiments.experiment import TrialRecord

Joint = tuple[tuple[int, Action], ...]
"""(car, action) in acting order."""

_VERBS: Final = {
    "STOP": 0.05,
    "ROTATE_LEFT": 0.4,
    "ROTATE_RIGHT": 0.4,
    "LIFT": 3.0,
    "FOLD": 2.8,
    "UNFOLD": 2.8,
}
"""How much likelier an action is than a move on the flat, before what is rare about it counts."""
_COMMON: Final = 0.2
"""Below this weight an action is common: it has been done often before."""
_IDLE: Final = 0.8
"""How often a car that would do something common waits instead."""
_LOADED_TURN: Final = 4.0
_SLOPE: Final = 20.0
_ABOVE_FLOOR: Final = 1.5
_AHEAD: Final = 6.0
"""For what brings a car before a ramp that it can drive next."""
_NEAR: Final = 0.5
"""More, for each other car within two cells."""
_AROUND: Final = [(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1) if dx or dy]
_THINGS: Final = {
    Kind.BLOCK: "block",
    Kind.FLAG: "block",
    Kind.WALL: "wall",
    Kind.FSLOPE: "folded slope",
    Kind.GEAR: "gear",
    Kind.BODY: "ramp",
    Kind.FOOT: "ramp",
}
NEIGHBOURS: Final = (
    *("nothing", "block", "wall", "folded slope", "gear", "ramp", "car", "load", "load on a ramp"),
    *("load below", "something above", "wall overhead"),
)
"""All that may be around an action: in the eight cells round the car's own and its next one, on its level; below and
above stands for the same cells one level lower or higher, and a wall overhead is right above the car."""
ALL: Final = "all"
"""The column that counts every action once; the others count it beside each thing that is around it."""


@dataclass(frozen=True)
class PlayedAction:
    """An action, where it is done, and what is around it."""

    verb: str
    level: int
    load: Kind
    on_slope: bool
    """Whether it starts or ends on a slope."""
    near: tuple[str, ...]
    """Of :data:`NEIGHBOURS`, in their order."""

    @property
    def name(self) -> str:
        """What is done and where, whatever is around: verb, level, load and slope, such as ``MOVE 2+ block slope``."""
        words = [self.verb.split("_")[0], "1" if self.level == 1 else "2+"]
        words += [self.load.name.lower()] if self.load != Kind.AIR else []
        return " ".join([*words, "slope"] if self.on_slope else words)


def doing(before: Grid, after: Grid, car: int, action: Action) -> PlayedAction:
    """Return what an action is, from the worlds before and after it."""
    row = before.cars[car]
    here, there = cell_of(before, car), cell_of(after, car)
    slope = bool(row[CarField.SLOPE] or after.cars[car, CarField.SLOPE])
    near = _near(before, car, here) | _near(before, car, there)
    listed = tuple(name for name in NEIGHBOURS if name in near) or ("nothing",)
    return PlayedAction(ACTIONS[action].verb, here[2], Kind(row[CarField.LOAD]), slope, listed)


def _near(grid: Grid, me: int, cell: Cell) -> set[str]:
    x, y, z = cell
    length, width, _ = grid.size
    found = {"wall overhead"} if grid.kind_at((x, y, z + 1)) == Kind.WALL else set()
    columns = {(x + dx, y + dy) for dx, dy in _AROUND if 0 <= x + dx < length and 0 <= y + dy < width}
    for cx, cy in columns:
        kind = grid.kind_at((cx, cy, z))
        found |= {_THINGS[kind]} if kind in _THINGS else set()
        found |= {"something above"} if grid.kind_at((cx, cy, z + 1)) != Kind.AIR else set()
    for car, row in enumerate(grid.cars.tolist()):
        if car == me or tuple(row[: CarField.Z]) not in columns:
            continue
        loaded, level = row[CarField.LOAD] != Kind.AIR, row[CarField.Z] - z
        if level == 0:
            found.add(("load on a ramp" if row[CarField.SLOPE] else "load") if loaded else "car")
        elif level == 1:
            found.add("something above")
        elif level == -1 and loaded:
            found.add("load below")
    return found


@dataclass(frozen=True)
class Play:
    """What the cars of a world do, tick by tick, each action legal in its turn."""

    ticks: tuple[Joint, ...]
    doings: tuple[tuple[PlayedAction, ...], ...]
    """What each action is and where, parallel to ``ticks``."""


def play(grid: Grid, rules: Rules, rng: np.random.Generator, n_ticks: int) -> Play:
    """Return a play of so many ticks from a world; in each the cars act in drawn order.

    A car waits where it can do nothing, and mostly where it would do what has been done often.
    """
    done: Counter[str] = Counter()
    ticks, doings = [], []
    for _ in range(n_ticks):
        joint, what = [], []
        for car in rng.permutation(grid.n_cars).tolist():
            options = [Action(a) for a in np.flatnonzero(rules.mask(grid)[car]).tolist()]
            if not options:
                continue
            after = [rules.apply(grid, car, action) for action in options]
            found = [doing(grid, then, car, a) for a, then in zip(options, after, strict=True)]
            weights = np.array(
                [
                    _weight(grid, then, rules, car, one) / (1 + done[one.name])
                    for one, then in zip(found, after, strict=True)
                ]
            )
            choice = int(rng.choice(len(options), p=weights / weights.sum()))
            if weights[choice] < _COMMON and rng.random() < _IDLE:
                continue
            joint.append((car, options[choice]))
            what.append(found[choice])
            done[found[choice].name] += 1
            grid = after[choice]
        ticks.append(tuple(joint))
        doings.append(tuple(what))
    return Play(tuple(ticks), tuple(doings))


def _weight(grid: Grid, after: Grid, rules: Rules, car: int, one: PlayedAction) -> float:
    weight = _VERBS.get(one.verb, 1.0)
    weight *= _ABOVE_FLOOR if one.level > 1 else 1.0
    weight *= _SLOPE if one.on_slope else 1.0
    if one.verb.startswith("ROTATE"):
        weight *= _LOADED_TURN if one.load != Kind.AIR else 1.0
    weight *= _AHEAD if one.verb != "STOP" and _ramp_ahead(after, rules, car) else 1.0
    here = after.cars[car, : CarField.YAW]
    near = (np.abs(after.cars[:, : CarField.YAW] - here).max(axis=1) <= 2).sum() - 1
    return weight * (1 + _NEAR * int(near))


def _ramp_ahead(grid: Grid, rules: Rules, car: int) -> bool:
    """Return whether a car's next move forward would take it onto a ramp."""
    yaw = int(grid.cars[car, CarField.YAW])
    action = next(a for a, spec in ACTIONS.items() if spec.direction == yaw)
    return rules.legal(grid, car, action) and bool(rules.apply(grid, car, action).cars[car, CarField.SLOPE])


def covered(played: Play, attempts: Iterable[Attempt]) -> dict[str, dict[str, int]]:
    """Return how often each thing was done: by name, ``all`` and the neighbours that there were. JSON knows it.

    Only what was performed counts.
    """
    done = {(a.tick, a.car) for a in attempts if a.performed}
    found: dict[str, Counter[str]] = {}
    for tick, (joint, doings) in enumerate(zip(played.ticks, played.doings, strict=True)):
        for (car, _), doing in zip(joint, doings, strict=True):
            if (tick, car) in done:
                found.setdefault(doing.name, Counter()).update((ALL, *doing.near, *_classes(doing)))
    return {name: dict(counts) for name, counts in found.items()}


def _classes(doing: PlayedAction) -> list[str]:
    """Return the totals that an action counts in, whatever is around it."""
    loaded_turn = doing.verb.startswith("ROTATE") and doing.load != Kind.AIR
    classes = {
        "on slopes": doing.on_slope,
        "turns of loads": loaded_turn,
        "folding": doing.verb in ("FOLD", "UNFOLD"),
        "above the floor": doing.level > 1,
    }
    return [f"~{name}" for name, holds in classes.items() if holds]


@dataclass(frozen=True)
class Coverage:
    """What all runs of a campaign covered together."""

    worlds: int
    do_not_stand: int
    """Worlds besides that cannot be: something would stand in something else. Nothing is tried there."""
    actions: int
    totals: dict[str, int]
    """Actions on slopes, turns of loads, of folding and unfolding, above the floor."""
    rows: dict[str, dict[str, int]]
    """By what was done: ``all``, and how often beside each of the neighbours."""

    @classmethod
    def of(cls, records: Iterable[TrialRecord]) -> Coverage | None:
        """Return what the records of a campaign covered; None where nothing was played."""
        played = fallen = 0
        counts: dict[str, Counter[str]] = {}
        for extra in (record["extra"] for record in records):
            fallen += "does_not_stand" in extra
            played += "coverage" in extra
            for name, found in extra.get("coverage", {}).items():
                counts.setdefault(name, Counter()).update(found)
        if not played:
            return None
        every = sum(counts.values(), Counter())
        totals = {key[1:]: n for key, n in sorted(every.items()) if key.startswith("~")}
        rows = {name: {key: counts[name][key] for key in (ALL, *NEIGHBOURS)} for name in sorted(counts)}
        return cls(played, fallen, every[ALL], totals, rows)
