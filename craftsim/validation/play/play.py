"""Random play by the rules that prefers the rare: what has been done least in an episode is drawn most."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Final

import numpy as np

from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.validation.play.neighbourhood import Doing, doing

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


@dataclass(frozen=True)
class Play:
    """What the cars of a world do, tick by tick, each action legal in its turn."""

    ticks: tuple[Joint, ...]
    doings: tuple[tuple[Doing, ...], ...]
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


def _weight(grid: Grid, after: Grid, rules: Rules, car: int, one: Doing) -> float:
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
