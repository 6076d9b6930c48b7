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
    neighbours: tuple[str, ...]
    """Members of :data:`NEIGHBOURS`, in their order."""

    @property
    def name(self) -> str:
        """Verb, level, load and slope, such as ``MOVE 2+ block slope``."""
        words = [self.verb.split("_")[0]]
        if self.level == 1:
            words.append("1")
        else:
            words.append("2+")
        if self.load != Kind.AIR:
            words.append(self.load.name.lower())
        if self.on_slope:
            words.append("slope")
        return " ".join(words)


def played_action(before: Grid, after: Grid, car: int, action: Action) -> PlayedAction:
    """Classify an action from the worlds before and after it."""
    row = before.cars[car]
    cell_before = cell_of(before, car)
    cell_after = cell_of(after, car)
    slope = bool(row[CarField.SLOPE] or after.cars[car, CarField.SLOPE])
    neighbours = _neighbours_of(before, car, cell_before) | _neighbours_of(before, car, cell_after)
    listed = tuple(name for name in NEIGHBOURS if name in neighbours) or ("nothing",)
    return PlayedAction(
        ACTIONS[action].verb, cell_before[2], Kind(row[CarField.LOAD]), slope, listed
    )


def _neighbours_of(grid: Grid, me: int, cell: Cell) -> set[str]:
    x, y, z = cell
    length, width, _ = grid.size
    neighbours = set()
    if grid.kind_at((x, y, z + 1)) == Kind.WALL:
        neighbours = {"wall overhead"}
    columns = set()
    for dx, dy in _AROUND:
        if 0 <= x + dx < length and 0 <= y + dy < width:
            columns.add((x + dx, y + dy))
    for cx, cy in columns:
        kind = grid.kind_at((cx, cy, z))
        if kind in _THINGS:
            neighbours |= {_THINGS[kind]}
        if grid.kind_at((cx, cy, z + 1)) != Kind.AIR:
            neighbours |= {"something above"}
    for car, row in enumerate(grid.cars.tolist()):
        if car == me or tuple(row[: CarField.Z]) not in columns:
            continue
        loaded = row[CarField.LOAD] != Kind.AIR
        level = row[CarField.Z] - z
        if level == 0:
            if not loaded:
                neighbours.add("car")
            elif row[CarField.SLOPE]:
                neighbours.add("load on a ramp")
            else:
                neighbours.add("load")
        elif level == 1:
            neighbours.add("something above")
        elif level == -1 and loaded:
            neighbours.add("load below")
    return neighbours


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
            chosen = choose(grid, rules, rng, car, done)
            if chosen is not None:
                action, grid = chosen
                tick.append((car, action))
        ticks.append(tuple(tick))
    return tuple(ticks)


def choose(
    grid: Grid, rules: Rules, rng: np.random.Generator, car: int, done: Counter[str]
) -> tuple[Action, Grid] | None:
    """Return the next action of a car in random play, and the world after it; None if the car waits.

    ``done`` counts actions by kind, and counts this one, too.
    """
    options = [Action(a) for a in np.flatnonzero(rules.mask(grid)[car]).tolist()]
    if not options:
        return None
    worlds = [rules.apply(grid, car, action) for action in options]
    kinds = []
    weights = []
    for action, world in zip(options, worlds, strict=True):
        kind = played_action(grid, world, car, action)
        kinds.append(kind)
        weights.append(_weight(world, rules, car, kind) / (1 + done[kind.name]))
    probabilities = np.array(weights) / np.sum(weights)
    choice = int(rng.choice(len(options), p=probabilities))
    if weights[choice] < _COMMON and rng.random() < _IDLE:
        return None
    done[kinds[choice].name] += 1
    return options[choice], worlds[choice]


def _weight(after: Grid, rules: Rules, car: int, played: PlayedAction) -> float:
    weight = _VERBS.get(played.verb, 1.0)
    if played.level > 1:
        weight *= _ABOVE_FLOOR
    if played.on_slope:
        weight *= _SLOPE
    if played.verb.startswith("ROTATE") and played.load != Kind.AIR:
        weight *= _LOADED_TURN
    if played.verb != "STOP" and _ramp_ahead(after, rules, car):
        weight *= _AHEAD
    position = after.cars[car, : CarField.YAW]
    n_near = (np.abs(after.cars[:, : CarField.YAW] - position).max(axis=1) <= 2).sum() - 1
    return weight * (1 + _NEAR * int(n_near))


def _ramp_ahead(grid: Grid, rules: Rules, car: int) -> bool:
    """Return whether a car's next move forward would take it onto a ramp."""
    yaw = int(grid.cars[car, CarField.YAW])
    action = next(a for a, spec in ACTIONS.items() if spec.direction == yaw)
    return rules.legal(grid, car, action) and bool(
        rules.apply(grid, car, action).cars[car, CarField.SLOPE]
    )


def covered(
    grid: Grid, ticks: Iterable[TeamAction], rules: Rules, attempts: Iterable[Attempt]
) -> dict[str, dict[str, int]]:
    """Return the number of performed actions of play by name, in all and by neighbour, as JSON values."""
    done = {(a.tick, a.car) for a in attempts if a.performed}
    counts_by_name = defaultdict[str, Counter[str]](Counter)
    for tick, team_action in enumerate(ticks):
        for car, action in team_action:
            before = grid
            grid = rules.apply(grid, car, action)
            if (tick, car) in done:
                played = played_action(before, grid, car, action)
                counts_by_name[played.name].update((ALL, *played.neighbours, *_classes(played)))
    return {name: dict(counts) for name, counts in counts_by_name.items()}


def _classes(played: PlayedAction) -> list[str]:
    """Return the totals in which an action counts."""
    classes = {
        "~on slopes": played.on_slope,
        "~turns of loads": played.verb.startswith("ROTATE") and played.load != Kind.AIR,
        "~folding": played.verb in ("FOLD", "UNFOLD"),
        "~above the floor": played.level > 1,
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
        for name, counts_of_run in extra.get("coverage", {}).items():
            counts[name].update(counts_of_run)
    if not played:
        return None
    totals = sum(counts.values(), Counter())
    rows = {}
    for name in sorted(counts):
        rows[name] = {key: counts[name][key] for key in (ALL, *NEIGHBOURS)}
    return {
        "worlds": played,
        "do_not_stand": fallen,
        "actions": totals[ALL],
        "totals": {key[1:]: n for key, n in sorted(totals.items()) if key.startswith("~")},
        "rows": rows,
    }
