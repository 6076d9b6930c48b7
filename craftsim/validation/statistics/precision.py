"""How far physics is from the prediction where it agrees with it, and how hard things touched."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from craftsim.validation.statistics.durations import Durations
from craftsim.validation.statistics.records import AttemptRecord, Record, as_predicted

ERRORS: Final = (
    "car_error_m",
    "heading_error_rad",
    "height_error_m",
    "placed_error_m",
    "bystander_displacement_m",
    "thing_heading_rad",
    "reach_m",
    "bystander_turn_rad",
    "drift_m",
)
"""Fields of an attempt that say how far physics was from the prediction; older records lack the last four."""


@dataclass(frozen=True)
class Distribution:
    """How a figure is distributed: number of values, median, 95th and 99th percentile, and maximum."""

    n: int
    median: float
    p95: float
    p99: float
    max: float

    @classmethod
    def of(cls, values: Iterable[float]) -> Distribution | None:
        """Return the distribution of some values, None of none."""
        known = np.fromiter(values, float)
        if not known.size:
            return None
        return cls(known.size, *(float(q) for q in np.quantile(known, (0.5, 0.95, 0.99, 1.0))))


@dataclass(frozen=True)
class Precision:
    """Errors of the attempts that did as predicted, and the peak contact forces of all."""

    car_error_mm: Distribution | None
    """Distance of the car from where it was predicted, in the plane."""
    heading_error_mrad: Distribution | None
    height_error_mm: Distribution | None
    placed_error_mm: Distribution | None
    """Of what was set down, folded or unfolded."""
    bystander_displacement_mm: Distribution | None
    """The furthest that anything moved which the action does not concern."""
    duration_error_s: Distribution | None
    """Distance of an attempt's duration from the median of its kind (verb, load, level and slope): what a planner
    errs by that takes durations from the table."""
    peak_force_n: Distribution | None
    """Of all attempts, also those that did not do as predicted."""
    thing_heading_mrad: Distribution | None = None
    """Of what was set down, folded or unfolded, and of what is carried against its car."""
    reach_mm: Distribution | None = None
    """How much nearer the same comes to a neighbouring cell than it should."""
    bystander_turn_mrad: Distribution | None = None
    drift_mm: Distribution | None = None
    """The furthest that anything which the action does not concern was from where it was left, at any time."""


def drift(records: Iterable[Record]) -> dict[str, Distribution | None]:
    """Return how far off in mm things were set down, folded or unfolded in each third of the runs: does it grow?"""
    thirds = {name: array("d") for name in ("first", "middle", "last")}
    for attempts in (record["attempts"] for record in records):
        for number, attempt in enumerate(attempts):
            if attempt["performed"] and attempt["placed_error_m"] is not None:
                thirds[list(thirds)[3 * number // len(attempts)]].append(1e3 * attempt["placed_error_m"])
    return {name: Distribution.of(errors) for name, errors in thirds.items()}


def precision(attempts: Iterable[AttemptRecord]) -> Precision:
    """Return the errors of some attempts."""
    forces, durations = array("d"), Durations()

    def noting_forces() -> Iterator[AttemptRecord]:
        for attempt in attempts:
            if attempt["peak_force_n"] is not None:
                forces.append(attempt["peak_force_n"])
            durations.add(attempt)
            yield attempt

    found = errors(noting_forces())
    return Precision(
        car_error_mm=Distribution.of(found["car_error_m"]),
        heading_error_mrad=Distribution.of(found["heading_error_rad"]),
        height_error_mm=Distribution.of(found["height_error_m"]),
        placed_error_mm=Distribution.of(found["placed_error_m"]),
        bystander_displacement_mm=Distribution.of(found["bystander_displacement_m"]),
        duration_error_s=Distribution.of(durations.deviations()),
        peak_force_n=Distribution.of(forces),
        thing_heading_mrad=Distribution.of(found["thing_heading_rad"]),
        reach_mm=Distribution.of(found["reach_m"]),
        bystander_turn_mrad=Distribution.of(found["bystander_turn_rad"]),
        drift_mm=Distribution.of(found["drift_m"]),
    )


def errors(attempts: Iterable[AttemptRecord]) -> dict[str, array[float]]:
    """Return the errors of the attempts that did as predicted, in thousandths, by field; they keep no attempt."""
    found = {name: array("d") for name in ERRORS}
    for attempt in filter(as_predicted, attempts):
        for name, values in found.items():
            if (error := attempt.get(name)) is not None:
                values.append(1e3 * abs(error))
    return found
