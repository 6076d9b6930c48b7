"""The shipped durations."""

import numpy as np
import pytest
from measure_durations import measure_durations

from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.schedule import SITUATIONS, car_durations, nominal_durations


def test_the_shipped_durations_are_what_physics_takes():
    measured = measure_durations()
    table = nominal_durations()
    for action in Action:
        for column, name in enumerate(SITUATIONS):
            seconds = measured.get(ACTIONS[action].duration, {}).get(name, 0.0)
            assert table[action, column] == pytest.approx(seconds, abs=0.05), (
                f"{action.name}, {name}: run scripts/measure_durations.py and put it into durations.yaml"
            )


def test_a_tick_takes_as_long_as_its_slowest_car_and_forbidden_actions_take_no_time():
    def longest(*tick):
        return car_durations(*tick).max()

    table = nominal_durations()
    before = np.zeros((3, 7), np.int64)
    before[1, CarField.LOAD] = Kind.BLOCK
    after = before.copy()
    after[:2, CarField.X] += 1
    actions = np.array([Action.MOVE_RIGHT, Action.MOVE_RIGHT, Action.UNFOLD])
    applied = np.array([True, True, False])
    flat, loaded = (SITUATIONS.index(name) for name in ("flat", "flat_loaded"))
    assert longest(before, after, actions, applied) == table[Action.MOVE_RIGHT, loaded]
    assert longest(before, after, actions, ~applied) == table[Action.UNFOLD, flat]
    after[0, CarField.SLOPE] = 1
    assert (
        longest(before[:1], after[:1], actions[:1], applied[:1])
        == table[Action.MOVE_RIGHT, SITUATIONS.index("slope")]
    )
    turned = before[:1].copy()
    turned[0, CarField.YAW] = 1
    # The action helper turns first, where a move was asked for.
    assert longest(before[:1], turned, actions[:1], applied[:1]) == table[Action.ROTATE_LEFT, flat]
