"""The table of measurements: what is measured of an action, with unit, sampler, limit and words.

A row is a field of :class:`MeasuredValues`, which an attempt has. From the rows derive what is held against a limit,
reasons, records, data frames, statistics, reports and a table of the documentation. To measure something else, add a
sampler and a row.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.contacts import apart
from craftsim.checking.watched import Watched
from craftsim.compiled.arrays import Floats
from craftsim.compiled.jit import plain
from craftsim.discrete.kernel.state import AIR, F_LOAD
from craftsim.discrete.readback import CellFit, Poses, Reading
from craftsim.mjcf.machines import Machines
from craftsim.models.composition import lift_m

NO_BYSTANDER: Final = -math.inf
"""Sample of what is no bystander."""
_ROW: Final = "measurement"
"""Key of a field's metadata."""
_apart: Final = plain(apart)


class Unit(NamedTuple):
    """A unit: how names of fields end with it, and how reports show values."""

    suffix: str
    """End of the names of fields, after an underscore; empty for a number without unit."""
    shown: str
    """Unit in reports and texts."""
    factor: float = 1.0
    """Number of shown units in one."""

    def text(self, value: float) -> str:
        """Return a value with the shown unit."""
        return f"{self.factor * value:.2f} {self.shown}".rstrip()


METRES: Final = Unit("m", "mm", 1e3)
RADIANS: Final = Unit("rad", "mrad", 1e3)
NEWTONS: Final = Unit("n", "N")
SECONDS: Final = Unit("s", "s")
NUMBER: Final = Unit("", "")


@dataclass(frozen=True, eq=False)
class Ending:
    """An action and the world at its end: what samplers see."""

    action: Watched
    machines: Machines
    poses: Poses
    rows: Floats
    """(n, 7) poses of cars and objects."""
    boards_m: Floats
    """(cars,) heights of the boards above their lower stops; nan where it is not known."""
    reading: Reading
    furthest: Floats
    """(n, 2) of each car and object: largest distance in metres, and angle in radians, from where it was left."""
    way_m: float
    """Largest distance of the acting car from the line between its cells."""
    way_lean_rad: float
    """Its largest lean beyond that of the ground."""
    reported: NDArray[np.bool_]
    """(objects, 2): which reach out, and which lean, because of an earlier action."""
    excused: Set[int]
    """Rows of the cars and objects that are no bystanders."""
    capped_steps: int = 0
    """Unconverged physics steps since the world was set up."""
    peak_force_n: float = 0.0
    """Largest force between two machines."""

    @property
    def car(self) -> CellFit:
        """The car that acted."""
        return self.reading.cars[self.action.step.car]

    @cached_property
    def things(self) -> list[CellFit]:
        """What the action handled."""
        n_cars = len(self.reading.cars)
        return [self.reading.objects[row - n_cars] for row in self.action.handled]

    @cached_property
    def bystanders(self) -> NDArray[np.intp]:
        """(m,): rows of the other cars and objects."""
        is_bystander = np.ones(len(self.rows), np.bool_)
        is_bystander[list(self.excused)] = False
        return np.flatnonzero(is_bystander)

    @cached_property
    def moved(self) -> Floats:
        """(m, 2) of each bystander: distance in metres, and angle in radians, from the start of the action."""
        start_rows = self.action.poses[self.bystanders]
        end_rows = self.rows[self.bystanders]
        moved = np.zeros((len(end_rows), 2))
        has_moved = (start_rows != end_rows).any(axis=1)
        for row in np.flatnonzero(has_moved).tolist():
            moved[row] = _apart(start_rows[row].tolist(), end_rows[row].tolist())
        return moved

    @cached_property
    def out_of_place(self) -> Floats:
        """(m, 2) of each bystander: excess reach, and lean; of a car, and where reported, NO_BYSTANDER."""
        n_cars = len(self.reading.cars)
        out_of_place = np.full((len(self.rows), 2), NO_BYSTANDER)
        out_of_place[n_cars:] = np.where(self.reported, NO_BYSTANDER, self.reading.bounded)
        return out_of_place[self.bystanders]


Of = Literal["car", "thing", "bystander", "contact", "action"]
Sampler = Callable[[Ending], Any]


@dataclass(frozen=True)
class Measurement:
    """A row of the table of measurements."""

    of: Of
    """What it is of: the acting car, what the action handles, anything else, contacts with that, or the action."""
    unit: Unit
    sample: Sampler
    """Returns the value at an action's end, or None; of bystanders (m,) values."""
    limit: str = ""
    """Field of :class:`craftsim.checking.thresholds.Thresholds`; empty without a limit."""
    excess: str = ""
    """Text of a value above its limit, where {} is the value; the name of a bystander comes before it."""
    label: str = ""
    """Label in tables of errors; empty leaves it out of statistics."""
    column: str = ""
    """Head of the column of an episode's largest value; empty leaves it out of an episode's figures."""
    episode_stem: str = ""
    """Name without unit in an episode's figures, where it differs."""
    name: str = ""
    """The field's."""

    @property
    def shown_name(self) -> str:
        """The name with the shown unit, such as ``drift_mm`` for ``drift_m``."""
        return f"{self._stem}{self._shown_suffix}"

    @property
    def shown_label(self) -> str:
        """The label with the shown unit."""
        return f"{self.label}, {self.unit.shown}".removesuffix(", ")

    @property
    def largest_name(self) -> str:
        """Key of the largest value in an episode's figures, such as ``max_drift_mm``."""
        return f"max_{self.episode_stem or self._stem}{self._shown_suffix}"

    @property
    def _stem(self) -> str:
        return self.name.removesuffix(f"_{self.unit.suffix}")

    @property
    def _shown_suffix(self) -> str:
        return f"_{self.unit.shown.lower()}".removesuffix("_")

    def limit_in(self, limits: Any) -> float:
        """Return the limit, given Thresholds."""
        limit: float = getattr(limits, self.limit)
        return limit


def _row(of: Of, unit: Unit, sample: Sampler, **words: str) -> dict[str, Measurement]:
    """Return the metadata of a field that is a row."""
    return {_ROW: Measurement(of, unit, sample, **words)}


def _car_offset_m(ending: Ending) -> float:
    return ending.car.offset_m


def _car_heading_rad(ending: Ending) -> float:
    return abs(ending.car.heading_rad)


def _car_height_m(ending: Ending) -> float:
    return abs(ending.car.height_m)


def _car_tilt_rad(ending: Ending) -> float:
    return ending.car.tilt_rad


def _board_height_m(ending: Ending) -> float | None:
    step = ending.action.step
    if step.after.cars[step.car, F_LOAD] != AIR:
        return None  # the height of the load counts
    height_m = float(ending.boards_m[step.car])
    if math.isnan(height_m):
        return None
    return abs(height_m)


def _way_m(ending: Ending) -> float:
    if ending.action.outcome is None:
        return 0.0
    return ending.way_m


def _way_lean_rad(ending: Ending) -> float:
    if ending.action.outcome is None:
        return 0.0
    return ending.way_lean_rad


def _placed_offset_m(ending: Ending) -> float | None:
    # What the car should not carry afterwards is set down, folded, unfolded or shoved.
    step = ending.action.step
    if ending.things and step.after.cars[step.car, F_LOAD] == AIR:
        return ending.things[0].offset_m
    return None


def _seat_offset_m(ending: Ending) -> float | None:
    offsets_m = [fit.offset_m for fit in ending.things if fit.carrier is not None]
    return max(offsets_m, default=None)


def _largest_of_things(ending: Ending, value: Callable[[CellFit], float]) -> float | None:
    return max(map(value, ending.things), default=None)


def _thing_heading_rad(ending: Ending) -> float | None:
    return _largest_of_things(ending, lambda fit: abs(fit.heading_rad))


def _thing_tilt_rad(ending: Ending) -> float | None:
    return _largest_of_things(ending, lambda fit: max(fit.tilt_rad, fit.hinge_rad))


def _thing_height_m(ending: Ending) -> float | None:
    n_cars = len(ending.reading.cars)
    machines = ending.machines
    heights_m = []
    for row in ending.action.handled:
        fit = ending.reading.objects[row - n_cars]
        height_m = fit.height_m
        if fit.carrier is not None:
            kind = ending.poses.kinds[row - n_cars]
            height_m -= lift_m(kind, machines.car(fit.carrier), machines)
        heights_m.append(abs(height_m))
    return max(heights_m, default=None)


def _thing_reach_m(ending: Ending) -> float | None:
    return _largest_of_things(ending, lambda fit: fit.reach_m)


def _moved_m(ending: Ending) -> Floats:
    return ending.moved[:, 0]


def _turned_rad(ending: Ending) -> Floats:
    return ending.moved[:, 1]


def _drift_m(ending: Ending) -> Floats:
    return ending.furthest[ending.bystanders, 0]


def _drift_rad(ending: Ending) -> Floats:
    return ending.furthest[ending.bystanders, 1]


def _reach_m(ending: Ending) -> Floats:
    return ending.out_of_place[:, 0]


def _lean_rad(ending: Ending) -> Floats:
    return ending.out_of_place[:, 1]


def _contact_force_n(ending: Ending) -> float:
    return max((contact.peak_n for contact in ending.action.contacts), default=0.0)


def _duration_ratio(ending: Ending) -> float | None:
    nominal_s = ending.action.step.duration_s
    if not nominal_s:
        return None  # what the rules forbid there has none
    return _duration_s(ending) / nominal_s


def _duration_s(ending: Ending) -> float:
    outcome = ending.action.outcome
    if outcome is None:
        return 0.0
    return round(outcome.duration_s, 6)


def _peak_force_n(ending: Ending) -> float:
    return ending.peak_force_n


def _capped_steps(ending: Ending) -> int:
    return ending.capped_steps - ending.action.capped_before


def _tries(ending: Ending) -> int:
    outcome = ending.action.outcome
    if outcome is None:
        return 0
    return outcome.tries


@dataclass(frozen=True)
class MeasuredValues:
    """What is measured of an action: the rows. A reason names excesses in their order."""

    car_error_m: float = field(
        metadata=_row(
            "car",
            METRES,
            _car_offset_m,
            limit="place_m",
            excess="the car is {} off",
            label="car's place",
            column="cars off, mm",
        )
    )
    """Distance of the car from its cell's centre."""
    heading_error_rad: float = field(
        metadata=_row(
            "car",
            RADIANS,
            _car_heading_rad,
            limit="turn_rad",
            excess="the car is turned by {}",
            label="car's heading",
            column="turned, mrad",
            episode_stem="car_heading_error",
        )
    )
    """Heading error of the car."""
    height_error_m: float = field(
        metadata=_row(
            "car",
            METRES,
            _car_height_m,
            limit="place_m",
            excess="the car's height is {} off",
            label="car's height",
        )
    )
    """Height error of the car."""
    tilt_error_rad: float | None = field(
        metadata=_row(
            "car",
            RADIANS,
            _car_tilt_rad,
            limit="turn_rad",
            excess="the car leans by {}",
        )
    )
    """Lean of the car against level or the incline."""
    board_height_m: float | None = field(
        metadata=_row(
            "car",
            METRES,
            _board_height_m,
            limit="place_m",
            excess="the board is {} above its stop",
        )
    )
    """Height of the board above its lower stop; None where it is not known, or should carry something."""
    way_m: float = field(
        metadata=_row(
            "car",
            METRES,
            _way_m,
            limit="way_m",
            excess="the car was {} off its way",
        )
    )
    """Largest distance of the car, at any time, from the line between its first and last cell; 0 if the
    skill was not started."""
    way_lean_rad: float = field(
        metadata=_row(
            "car",
            RADIANS,
            _way_lean_rad,
            limit="way_lean_rad",
            excess="the car leaned {} beyond its ground",
        )
    )
    """Largest lean of the car, at any time, beyond the steepest ground of its action; 0 if the skill was not
    started."""
    placed_error_m: float | None = field(
        metadata=_row(
            "thing",
            METRES,
            _placed_offset_m,
            label="place of what is set down",
            column="set down off, mm",
        )
    )
    """Distance of what was set down, folded or unfolded from its cell's centre; None for other actions."""
    seat_error_m: float | None = field(
        metadata=_row(
            "thing",
            METRES,
            _seat_offset_m,
            limit="seat_m",
            excess="the load is {} off its seat",
        )
    )
    """Distance of the load from its seat on the board; None without a load."""
    thing_heading_rad: float | None = field(
        metadata=_row(
            "thing",
            RADIANS,
            _thing_heading_rad,
            limit="turn_rad",
            excess="the thing is turned by {}",
            label="heading of what is handled",
        )
    )
    """Heading error of the handled thing: against the grid if set down, folded or unfolded, against the car if carried;
    None without one."""
    thing_tilt_rad: float | None = field(
        metadata=_row(
            "thing",
            RADIANS,
            _thing_tilt_rad,
            limit="turn_rad",
            excess="the thing leans, or its hinge stands, {} off",
        )
    )
    """Lean of the same, or, if larger, the distance of its hinge from its stop."""
    thing_height_m: float | None = field(
        metadata=_row(
            "thing",
            METRES,
            _thing_height_m,
            limit="place_m",
            excess="the thing's height is {} off",
        )
    )
    """Height of the same above its floor or seat."""
    reach_m: float | None = field(
        metadata=_row(
            "thing",
            METRES,
            _thing_reach_m,
            limit="place_m",
            excess="the thing is {} too near to a neighbouring cell",
            label="its reach out of its cell",
        )
    )
    """Excess reach of the same towards a neighbouring cell."""
    bystander_displacement_m: float = field(
        metadata=_row(
            "bystander",
            METRES,
            _moved_m,
            limit="place_m",
            excess="was moved by {}",
            label="movement of anything else",
            column="others moved, mm",
        )
    )
    """Largest displacement of a bystander: a thing that no action of that time concerns."""
    bystander_turn_rad: float | None = field(
        metadata=_row(
            "bystander",
            RADIANS,
            _turned_rad,
            limit="turn_rad",
            excess="was turned by {}",
            label="turn of anything else",
        )
    )
    """Largest rotation of a bystander about any axis."""
    drift_m: float | None = field(
        metadata=_row(
            "bystander",
            METRES,
            _drift_m,
            limit="place_m",
            excess="was {} away from where it was left",
            label="anything else from where it was left",
        )
    )
    """Largest distance of a bystander, or of a car's board, at any time since the action began, from where it was last
    put."""
    drift_rad: float | None = field(
        metadata=_row(
            "bystander",
            RADIANS,
            _drift_rad,
            limit="turn_rad",
            excess="was turned {} away from how it was left",
        )
    )
    """The same for its rotation."""
    bystander_reach_m: float | None = field(
        metadata=_row(
            "bystander",
            METRES,
            _reach_m,
            limit="place_m",
            excess="is {} too near to a neighbouring cell",
        )
    )
    """Excess reach of a bystander, unless an earlier action left it so."""
    bystander_tilt_rad: float | None = field(
        metadata=_row(
            "bystander",
            RADIANS,
            _lean_rad,
            limit="turn_rad",
            excess="leans, or its hinge stands, {} off",
        )
    )
    """Lean or hinge error of a bystander, unless an earlier action left it so."""
    contact_force_n: float = field(
        metadata=_row(
            "contact",
            NEWTONS,
            _contact_force_n,
            limit="contact_n",
            excess="{} between machines that should not touch",
        )
    )
    """Largest force between the car or what it handles, and what these should not touch."""
    duration_s: float = field(metadata=_row("action", SECONDS, _duration_s))
    """Simulated time that the skill took."""
    duration_ratio: float | None = field(
        metadata=_row(
            "action",
            NUMBER,
            _duration_ratio,
            limit="duration_ratio",
            excess="it took {} times as long as nominal",
        )
    )
    """Duration as a multiple of the nominal one; None where the rules forbid the action."""
    peak_force_n: float = field(metadata=_row("action", NEWTONS, _peak_force_n))
    """The largest force between two machines, the ground included, during the action."""
    capped_steps: int = field(metadata=_row("action", NUMBER, _capped_steps))
    """Physics steps that reached ``SimulationConfig.solver_iterations``."""
    tries: int = field(metadata=_row("action", NUMBER, _tries))
    """Number of tries of the skill."""


MEASUREMENTS: Final[dict[str, Measurement]] = {
    row.name: replace(row.metadata[_ROW], name=row.name) for row in fields(MeasuredValues)
}
"""The rows by name."""
LIMITED: Final = tuple(row for row in MEASUREMENTS.values() if row.limit)
"""The rows that are held against a limit."""
LABELLED: Final = tuple(row for row in MEASUREMENTS.values() if row.label)
"""The rows of statistics: errors, with labels for tables."""
SUMMARIZED: Final = tuple(row for row in MEASUREMENTS.values() if row.column)
"""The rows whose largest values an episode's figures have."""


def sample_all(ending: Ending, names: Sequence[str]) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the values by row, and for those of bystanders the name of the one with the largest value.

    ``names`` are those of all cars and objects.
    """
    values: dict[str, Any] = {}
    bystanders: dict[str, str] = {}
    for name, measurement in MEASUREMENTS.items():
        sample = measurement.sample(ending)
        if measurement.of == "bystander":
            sample, bystanders[name] = _largest(sample, ending.bystanders, names)
        values[name] = sample
    return values, bystanders


def _largest(samples: Floats, rows: NDArray[np.intp], names: Sequence[str]) -> tuple[float, str]:
    """Return the largest of the samples of some rows, and that row's name; 0 and an empty name without bystanders."""
    if not len(samples):
        return 0.0, ""
    place = samples.argmax()  # nan is the largest
    value = float(samples[place])
    if value == NO_BYSTANDER:
        return 0.0, ""
    return value, names[rows[place]]
