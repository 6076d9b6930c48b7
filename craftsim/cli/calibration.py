"""A fixed piece of work in plain Python, timed beside what is measured, so that a ratio has both sides from one run."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
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
_TURNS: Final = 10
_SHARE: Final = 0.25  # time of the calibration over that of the work it stands beside


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


def cells(rate: Mapping[str, float]) -> tuple[str, ...]:
    """Return the columns of a table from what :func:`measure` returns: steps/s, CraftEnv, times."""
    values = (rate["steps_a_second"], rate["reference_a_second"], rate["times"])
    return tuple(f"{value:,.{0 if value >= 100 else 1 if value >= 10 else 2}f}" for value in values)


def measure(step: Callable[[], None], n: int, seconds: float, task: str, helper: bool) -> dict[str, float]:
    """Return the rate of a function that takes ``n`` steps of a task, CraftEnv's ``helper`` included or not.

    It is called once before, so that compiling does not count, and timed for some CPU ``seconds``, so that other
    processes count for neither side, in turns with the calibration, because a processor's speed changes: by 1.8 times
    within a minute where REFERENCE_PER_UNIT was measured.
    """
    step()
    unit()
    calls = units = 0
    of_calls = of_units = 0.0
    for _ in range(_TURNS):
        done, spent = repeat(lambda _: step(), seconds / _TURNS)
        calls, of_calls = calls + done, of_calls + spent
        done, spent = repeat(unit, _SHARE * seconds / _TURNS)
        units, of_units = units + done, of_units + spent
    rate, units_a_second = n * calls / of_calls, units / of_units
    reference = units_a_second * REFERENCE_PER_UNIT[task] * (1.0 if helper else PRIMITIVE_TIMES_HELPER[task])
    return {
        "steps_a_second": rate,
        "units_a_second": units_a_second,
        "reference_a_second": reference,
        "per_unit": rate / units_a_second,
        "times": rate / reference,
    }


def repeat(work: Callable[[int], object], seconds: float) -> tuple[int, float]:
    """Return how often something was done within so many CPU seconds, once at least, and the time that it took."""
    begun = time.process_time()
    n = 0
    while True:
        work(n)
        n += 1
        spent = time.process_time() - begun
        if spent >= seconds and spent > 0:
            return n, spent
