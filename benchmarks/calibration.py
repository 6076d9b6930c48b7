"""A fixed piece of work in plain Python, from whose time CraftEnv's speed on this machine is estimated."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

REFERENCE_PER_UNIT: Final = {"simple_two_story": 0.187, "complex_two_story": 0.098}
"""CraftEnv's steps in the time of one :func:`unit`, its helper's masks (depth 20) and observations included.

Derived over a second piece of plain Python, whose time was measured beside CraftEnv itself (spread 6 %) and beside
this unit: 24 rounds of both in turns, in CPU seconds on one core. The median; rounds spread from 11 % below it to 7 %
above, 4 % either way for four in five of them, while the processor's speed changed by 1.8 times.
"""

PRIMITIVE_TIMES_HELPER: Final = {"simple_two_story": 5270 / 225, "complex_two_story": 2830 / 115}
"""How many times as many steps CraftEnv does with primitive masks alone as with its helper's masks and observations:
steps a second of either, measured once beside each other on one core of another machine."""

_LENGTH: Final = 12
_CARS: Final = 3
_HEADINGS: Final = ((1, 0), (0, 1), (-1, 0), (0, -1))


class _Vehicle:
    def __init__(self, number: int) -> None:
        self.place = (number * 3, number * 2)
        self.heading = number % 4
        self.loaded = number % 2 == 1


class _Yard:
    """A flat map of free and taken cells with vehicles, as one writes it without arrays."""

    def __init__(self, seed: int) -> None:
        cells = [(x, y) for x in range(_LENGTH) for y in range(_LENGTH)]
        self.taken = {cell: (5 * cell[0] + 3 * cell[1] + seed) % 7 == 0 for cell in cells}
        self.vehicles = [_Vehicle(number) for number in range(_CARS)]
        for vehicle in self.vehicles:
            self.taken[vehicle.place] = False

    def free(self, cell: tuple[int, int]) -> bool:
        return cell in self.taken and not self.taken[cell]

    def allows(self, vehicle: _Vehicle, action: int) -> bool:
        x, y = vehicle.place
        if action < 4:
            step = _HEADINGS[action]
            there = (x + step[0], y + step[1])
            return self.free(there) and all(other.place != there for other in self.vehicles)
        if action < 8:
            return not vehicle.loaded or all(self.free((x + a, y + b)) for a, b in _HEADINGS)
        return vehicle.loaded == (action % 2 == 0)

    def within_reach(self, vehicle: _Vehicle, depth: int) -> dict[tuple[int, int, int], int]:
        found = {(*vehicle.place, vehicle.heading): 0}
        front = list(found)
        for steps in range(1, depth + 1):
            beyond = []
            for x, y, heading in front:
                step = _HEADINGS[heading]
                for state in (
                    (x + step[0], y + step[1], heading),
                    (x, y, (heading + 1) % 4),
                    (x, y, (heading + 3) % 4),
                ):
                    if state not in found and self.free(state[:2]):
                        found[state] = steps
                        beyond.append(state)
            front = beyond
        return found

    def rows(self) -> NDArray[np.int64]:
        observed = []
        for vehicle in self.vehicles:
            things = [np.array([*vehicle.place, vehicle.heading, vehicle.loaded])]
            things += [np.array([*cell, 0, 1]) for cell in self.taken if self.taken[cell]]
            observed.append(np.concatenate(things))
        return np.stack(observed)


def unit(seed: int = 0) -> float:
    """Do one unit of the calibration work: masks, a search and observations of a few vehicles; return a check sum."""
    yard = _Yard(seed)
    total = float(yard.rows().sum())
    for vehicle in yard.vehicles:
        total += sum(yard.allows(vehicle, action) for action in range(15))
        total += sum(yard.within_reach(vehicle, 20).values())
    return total
