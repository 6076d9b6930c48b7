"""Measure how long each action takes, on a tour of one car that comes by every situation.

python scripts/measure_durations.py             # at nominal physics: what craftsim/data/durations.yaml holds
python scripts/measure_durations.py --spread    # how durations vary on rollers and a workshop floor: 50 CPU seconds
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from dataclasses import replace
from typing import Final

import numpy as np
import yaml

from craftsim.checking.judge import Judge
from craftsim.checking.setup import RANDOMIZE, Seed, Setup, set_up
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.schedule import SITUATIONS, situation
from craftsim.mjcf.machines import NOMINAL

_LEFT, _RIGHT, _BACK, _FORWARD = (
    Action.MOVE_LEFT,
    Action.MOVE_RIGHT,
    Action.MOVE_BACK,
    Action.MOVE_FORWARD,
)
_ABOUT: Final = (Action.ROTATE_LEFT, Action.ROTATE_LEFT)
_OVER_THE_RAMP: Final = (*3 * (_RIGHT,), *_ABOUT, *3 * (_LEFT,))

TOUR: Final[tuple[Action, ...]] = (
    Action.STOP,
    *(_LEFT, Action.UNFOLD, Action.FOLD, Action.UNFOLD),
    *(_RIGHT, _RIGHT, *_ABOUT, *_ABOUT, _RIGHT, _RIGHT),
    *(Action.LIFT, *_ABOUT, *_ABOUT, _FORWARD, *6 * (_LEFT,), _BACK),
    *_OVER_THE_RAMP,
    *(_BACK, Action.DROP, _LEFT, _FORWARD, *_ABOUT, _RIGHT),
    *_OVER_THE_RAMP,
)
"""Unfolds and folds a slope, fetches a block, takes it up the ramp and down again, and goes there once more without."""


def tour_start() -> Grid:
    """Return the world in which the tour starts: a folded slope before a block, and another block behind it."""
    grid = Grid.empty((9, 3, 3), 1)
    grid.cars[0, :4] = 4, 1, 1, 0
    grid.kind[4, 1, 1] = grid.kind[7, 1, 1] = Kind.BLOCK
    grid.kind[3, 1, 1], grid.kind[2, 1, 1] = Kind.FSLOPE, Kind.GEAR
    grid.yaw[3, 1, 1] = grid.yaw[2, 1, 1] = 2
    grid.derive_marks()
    return grid


def measure_durations() -> dict[str, dict[str, float]]:
    """Return the mean seconds of each verb in each situation that it has, rounded to hundredths.

    Raises RuntimeError if an action of the tour fails: then there is nothing to measure.
    """
    judge = set_up(tour_start(), Setup())
    seconds = take_tour(judge)
    rows: dict[str, dict[str, float]] = defaultdict(dict)
    for (verb, where), taken_s in seconds.items():
        rows[verb][where] = round(float(np.mean(taken_s)), 2)
    return dict(rows)


def take_tour(judge: Judge, stops_early: bool = False) -> dict[tuple[str, str], list[float]]:
    """Return the seconds of each action by verb and situation.

    Raises RuntimeError if an action of the tour fails, unless the tour may stop early: then it ends there.
    """
    seconds: dict[tuple[str, str], list[float]] = defaultdict(list)
    for number, action in enumerate(TOUR):
        before = judge.grid.cars
        attempt = judge.perform(0, action)
        if not attempt.agrees:
            if stops_early:
                break
            raise RuntimeError(f"action {number} of the tour, {action.name}, failed: {attempt}")
        where = SITUATIONS[int(situation(before, judge.grid.cars)[0])]
        seconds[ACTIONS[action].duration, where].append(attempt.duration_s)
    return seconds


def measure_spread(n_tours: int = 6) -> float:
    """Return the standard deviation of the logarithm of an action's duration, of one verb in one situation.

    On rollers and workshop floors, each drawn from a seed. A tour ends where an action fails.
    """
    setup = Setup(
        randomization=RANDOMIZE["workshop_floor"], machines=replace(NOMINAL, drive="rollers")
    )
    logarithms: dict[tuple[str, str], list[float]] = defaultdict(list)
    for seed in range(n_tours):
        judge = set_up(tour_start(), setup, Seed((seed,)))
        for key, taken_s in take_tour(judge, stops_early=True).items():
            logarithms[key].extend(np.log(taken_s))
    deviations = [np.array(values) - np.mean(values) for values in logarithms.values()]
    squares = np.concatenate(deviations) ** 2
    return float(np.sqrt(squares.sum() / (len(squares) - len(deviations))))


def main() -> None:
    """Print what was measured."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--spread", action="store_true")
    if parser.parse_args().spread:
        print(f"{measure_spread():.2f}")
    else:
        print(yaml.safe_dump(measure_durations(), sort_keys=False), end="")


if __name__ == "__main__":
    main()
