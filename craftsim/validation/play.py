"""Count-based exploratory play: random legal actions, weighted towards those done least in the episode.

Actions are counted by kind and surroundings, and so is the coverage of a run.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable
from typing import Any, Final, NamedTuple

import numpy as np

from craftsim.checking.attempt import Attempt
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import CarField, Cell, Grid, Kind, cell_of
from craftsim.discrete.kinds import Action, PlanTick, TeamAction
from craftsim.discrete.rules import Rules
from craftsim.experiments.experiment import TrialRecord

_VERBS: Final = {
    "STOP": 0.05,
    "ROTATE_LEFT": 0.4,
    "ROTATE_RIGHT": 0.4,
    "LIFT": 3.0,
    "FOLD": 2.8,
    "UNFOLD": 2.8,
}
"""Weight of an action relative to a move on the flat, before its count."""
_COMMON: Final = 0.2
"""Weight below which an action is common."""
_IDLE: Final = 0.8
_LOADED_TURN: Final = 4.0
_SLOPE: Final = 20.0
_ABOVE_FLOOR: Final = 1.5
_AHEAD: Final = 6.0
"""Weight of an action that brings a car before a ramp."""
_NEAR: Final = 0.5
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
"""What may surround an action: on its level in the eight cells around the car's present and next cell; "below" and
"above" are the same cells one level lower or higher, and a wall overhead is right above the car."""
ALL: Final = "all"
"""The column that counts every action once; the others count it for each neighbour."""


class PlayedAction(NamedTuple):
    """An action with its place and surroundings."""

    verb: str
    level: int
    load: Kind
    on_slope: bool
    near: tuple[str, ...]
    """Members of :data:`NEIGHBOURS`, in their order."""

    @property
    def name(self) -> str:
        """Verb, level, load and slope, such as ``MOVE 2+ block slope``."""
        words = [self.verb.split("_")[0], "1" if self.level == 1 else "2+"]
        if self.load != Kind.AIR:
            words += [self.load.name.lower()]
        return " ".join([*words, "slope"] if self.on_slope else words)


def doing(before: Grid, after: Grid, car: int, action: Action) -> PlayedAction:
    """Classify an action from the worlds before and after it."""
    row = before.cars[car]
    here = cell_of(before, car)
    there = cell_of(after, car)
    slope = bool(row[CarField.SLOPE] or after.cars[car, CarField.SLOPE])
    near = _near(before, car, here) | _near(before, car, there)
    listed = tuple(name for name in NEIGHBOURS if name in near) or ("nothing",)
    return PlayedAction(ACTIONS[action].verb, here[2], Kind(row[CarField.LOAD]), slope, listed)


def _near(grid: Grid, me: int, cell: Cell) -> set[str]:
    x, y, z = cell
    length, width, _ = grid.size
    found = set()
    if grid.kind_at((x, y, z + 1)) == Kind.WALL:
        found = {"wall overhead"}
    columns = {(x + dx, y + dy) for dx, dy in _AROUND if 0 <= x + dx < length and 0 <= y + dy < width}
    for cx, cy in columns:
        kind = grid.kind_at((cx, cy, z))
        if kind in _THINGS:
            found |= {_THINGS[kind]}
        if grid.kind_at((cx, cy, z + 1)) != Kind.AIR:
            found |= {"something above"}
    for car, row in enumerate(grid.cars.tolist()):
        if car == me or tuple(row[: CarField.Z]) not in columns:
            continue
        loaded = row[CarField.LOAD] != Kind.AIR
        level = row[CarField.Z] - z
        if level == 0:
            found.add(("load on a ramp" if row[CarField.SLOPE] else "load") if loaded else "car")
        elif level == 1:
            found.add("something above")
        elif level == -1 and loaded:
            found.add("load below")
    return found


def play(grid: Grid, rules: Rules, rng: np.random.Generator, n_ticks: int) -> tuple[PlanTick, ...]:
    """Return random play of ``n_ticks`` from a world; the order of the cars is drawn in each tick.

    Each action is legal in its turn. A car waits if it has no other legal action, and mostly if it would take a common
    one.
    """
    done: Counter[str] = Counter()
    ticks = []
    for _ in range(n_ticks):
        tick = list[tuple[int, Action]]()
        for car in rng.permutation(grid.n_cars).tolist():
            options = [Action(a) for a in np.flatnonzero(rules.mask(grid)[car]).tolist()]
            if not options:
                continue
            after = [rules.apply(grid, car, action) for action in options]
            found = [doing(grid, then, car, a) for a, then in zip(options, after, strict=True)]
            pairs = zip(found, after, strict=True)
            weights = np.array([_weight(then, rules, car, one) / (1 + done[one.name]) for one, then in pairs])
            choice = int(rng.choice(len(options), p=weights / weights.sum()))
            if weights[choice] < _COMMON and rng.random() < _IDLE:
                continue
            tick.append((car, options[choice]))
            done[found[choice].name] += 1
            grid = after[choice]
        ticks.append(tuple(tick))
    return tuple(ticks)


def _weight(after: Grid, rules: Rules, car: int, one: PlayedAction) -> float:
    weight = _VERBS.get(one.verb, 1.0)
    if one.level > 1:
        weight *= _ABOVE_FLOOR
    else:
        weight *= 1.0
    if one.on_slope:
        weight *= _SLOPE
    else:
        weight *= 1.0
    if one.verb.startswith("ROTATE"):
        if one.load != Kind.AIR:
            weight *= _LOADED_TURN
        else:
            weight *= 1.0
    if one.verb != "STOP" and _ramp_ahead(after, rules, car):
        weight *= _AHEAD
    else:
        weight *= 1.0
    here = after.cars[car, : CarField.YAW]
    near = (np.abs(after.cars[:, : CarField.YAW] - here).max(axis=1) <= 2).sum() - 1
    return weight * (1 + _NEAR * int(near))


def _ramp_ahead(grid: Grid, rules: Rules, car: int) -> bool:
    """Return whether a car's next move forward would take it onto a ramp."""
    yaw = int(grid.cars[car, CarField.YAW])
    action = next(a for a, spec in ACTIONS.items() if spec.direction == yaw)
    return rules.legal(grid, car, action) and bool(rules.apply(grid, car, action).cars[car, CarField.SLOPE])


def covered(
    grid: Grid, ticks: Iterable[TeamAction], rules: Rules, attempts: Iterable[Attempt]
) -> dict[str, dict[str, int]]:
    """Return the number of performed actions of play by name, in all and by neighbour, as JSON values."""
    done = {(a.tick, a.car) for a in attempts if a.performed}
    found = defaultdict[str, Counter[str]](Counter)
    for tick, team_action in enumerate(ticks):
        for car, action in team_action:
            before = grid
            grid = rules.apply(grid, car, action)
            if (tick, car) in done:
                one = doing(before, grid, car, action)
                found[one.name].update((ALL, *one.near, *_classes(one)))
    return {name: dict(counts) for name, counts in found.items()}


def _classes(doing: PlayedAction) -> list[str]:
    """Return the totals in which an action counts."""
    classes = {
        "~on slopes": doing.on_slope,
        "~turns of loads": doing.verb.startswith("ROTATE") and doing.load != Kind.AIR,
        "~folding": doing.verb in ("FOLD", "UNFOLD"),
        "~above the floor": doing.level > 1,
    }
    return [name for name, holds in classes.items() if holds]


def coverage_of(records: Iterable[TrialRecord]) -> dict[str, Any] | None:
    """Return the coverage of all runs together; None without random play.

    It holds the numbers of ``worlds`` and of ``actions``; of worlds that ``do_not_stand``, since solids would overlap;
    ``totals`` of actions on slopes, turns of loads, folding and unfolding, and actions above the floor; and by kind of
    action the ``rows``: ``all``, and the number beside each neighbour.
    """
    played = fallen = 0
    counts = defaultdict[str, Counter[str]](Counter)
    for extra in (record["extra"] for record in records):
        fallen += "does_not_stand" in extra
        played += "coverage" in extra
        for name, found in extra.get("coverage", {}).items():
            counts[name].update(found)
    if not played:
        return None
    every = sum(counts.values(), Counter())
    return {
        "worlds": played,
        "do_not_stand": fallen,
        "actions": every[ALL],
        "totals": {key[1:]: n for key, n in sorted(every.items()) if key.startswith("~")},
        "rows": {name: {key: counts[name][key] for key in (ALL, *NEIGHBOURS)} for name in sorted(counts)},
    }
