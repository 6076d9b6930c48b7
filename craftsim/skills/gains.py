"""The gains of all skills: frozen, validated, and read from YAML that a tuner can write."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict, field, fields, replace
from functools import lru_cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import BeforeValidator

from craftsim.errors import InputError, suggestion
from craftsim.mjcf.machines import MACHINE_SECTIONS, NOMINAL, Machines
from craftsim.mjcf.parameters import (
    GRAVITY,
    REACH,
    NearNominal,
    Positive,
    SmartcarParameters,
    digest_of,
)
from craftsim.storage.limits import Range
from craftsim.storage.records import record
from craftsim.storage.yaml import read_document


def _whole(value: Any) -> Any:
    if isinstance(value, float) and value.is_integer():
        return int(value)
    return value


Count = Annotated[int, Range(0, above=True), BeforeValidator(_whole)]
"""A whole number, which a file may also write as 2.0."""


@record()
class DriveGains(NearNominal):
    """Gains and limits of driving; SI units unless the comment says otherwise."""

    position_gain: Positive = 10.0
    """1/s: speed commanded per metre of position error."""
    heading_gain: Positive = 10.0
    """1/s: turn rate commanded per radian of heading error."""
    integral_gain: Positive = 4.0
    """1/s^2: integral action on position and heading, once the path has ended."""
    friction_speed: Positive = 0.03
    """rad/s: wheel speed at which the compensation of the gears' dry friction reaches tanh(1) = 76 % of it. In
    proportion to the speed by which friction makes a wheel's servo droop, ``gear_friction_nm / wheel_gain_nms_rad``, if
    that is above the nominal 0.11 rad/s: less would make the loop oscillate."""
    max_speed: Positive = 0.84
    max_acceleration: Positive = 3.2
    max_slope_speed: Positive = 0.42
    """m/s: highest speed of a move from or onto a slope: the wheels meet its foot at an angle."""
    max_slope_acceleration: Positive = 1.8
    """m/s^2: on a slope, and therefore on the things that carry it."""
    max_tight_speed: Positive = 0.84
    """m/s: highest speed of a move under something, or of a load past something."""
    max_tight_acceleration: Positive = 3.2
    max_tight_slope_acceleration: Positive = 1.2
    """m/s^2: of such a move with a load from or onto a slope. The grip must suffice to climb and to keep to the path:
    at the least friction of mild randomization, 0.68, a car can push by 4.5 m/s^2 on the incline; weight takes 2.7."""
    rocking: Positive = 0.11
    """m^3/s^2: largest product of acceleration and height above the floor squared. A stack of n blocks yields by
    the car's push times its height in each of n joints, and tips in the end."""
    max_turn_speed: Positive = 5.0
    max_turn_acceleration: Positive = 22.0
    astray: Positive = 1.0
    """m: distance of a car from its path at which the path of a load past something waits; never on a flat floor."""
    load_factor: Positive = 0.80
    """Factor of the speed and acceleration limits of loaded cars."""
    position_tolerance: Positive = 0.0004
    """m: largest position error at rest at the end of a move."""
    heading_tolerance: Positive = 0.0012
    position_certainty: Positive = 0.00035
    """m: largest standard deviation of the estimated position at the end of a move."""
    heading_certainty: Positive = 0.0011
    """rad: largest standard deviation of the estimated heading at the end of a move."""
    settle_allowance: Positive = 5.0
    """s: time beyond the profile's end after which a move that is not done has failed."""
    shake_after: Positive = 10.0
    """s: time beyond the profile's end after which a car that has not arrived is shaken."""
    shake_speed: Positive = 0.03
    """m/s: amplitude of the speed of shaking."""
    shake_rate: Positive = 5.0
    """Hz: frequency of shaking (:func:`craftsim.skills.laws.shake`)."""
    blocked_error: Positive = 0.04
    """m: distance behind the path that, for longer than ``blocked_time``, means an obstacle."""
    blocked_time: Positive = 0.25
    """s."""
    slip_ratio: Positive = 2.0
    """A car that fell behind slips, and is not blocked, if its wheels rolled by more than this many times its way plus
    ``slip_distance``, and their push would not have moved a free car that far."""
    slip_distance: Positive = 0.01
    """m."""
    speed_at_rest: Positive = 0.0015
    """m/s: a car is at rest when its wheels together roll slower than this."""
    wheels_at_rest: Positive = 0.03
    """rad/s: a car is also at rest when three wheels turn slower than this: the fourth may slip on the spot."""
    rest_periods: Count = 2
    """Control periods of rest on the target after which a move is done."""
    brake_periods: Count = 30
    """Control periods on the target after which a car brakes: while it corrects the last tenth of a millimetre, two
    wheels on a diagonal may slip on the spot for ever."""
    motor_share: Positive = 0.9
    """Largest share of the wheel motors' speed, and of the torque that they give for sure, 85 %, that paths use; the
    rest is for corrections."""


@record()
class UnevenGains(NearNominal):
    """Driving where cars find their floor uneven (:mod:`craftsim.skills.estimator`): limits besides those of
    :class:`DriveGains`. A car without springs hops there, and its lowered board clears by a millimetre what it passes
    under."""

    tilt: Positive = 0.0008
    """rad: a floor is uneven if a car leans by more than this, in the mean over ``tilt_time``, on level ground."""
    tilt_time: Positive = 1.0
    """s: time of that mean: sensors of pitch and roll are noisy, and rollers rattle."""
    max_speed: Positive = 0.5
    max_acceleration: Positive = 2.0
    max_slope_speed: Positive = 0.15
    """m/s: of a move from or onto a slope."""
    max_slope_acceleration: Positive = 0.2
    max_tight_speed: Positive = 0.15
    """m/s: of a move under something, or of a load past something."""
    max_tight_acceleration: Positive = 0.15
    max_turn_speed: Positive = 2.5
    max_turn_acceleration: Positive = 3.0
    astray: Positive = 0.001
    """m: of a load past something, but not on slopes. A car beside its path by half of this drives to and fro along it,
    beyond this it slows down, and at twice this it stops. Half of it is the noise of an estimate in motion, and twice
    it is less than the 2.5 mm between two loads."""
    shake_after: Positive = 0.4
    """s: on two wheels of a diagonal a car without springs only arrives if it is shaken soon."""
    loose: Positive = 0.5
    """Standard deviation of the speed of sideways slip as a fraction of the wheels' speed: a car on two wheels of a
    diagonal goes at 45 degrees to its path for a second or longer."""


@record()
class BoardGains(NearNominal):
    """Gains of the lifting board."""

    gain: Positive = 25.0
    """1/s: board speed commanded per metre of remaining travel, up to the motor's limit."""
    acceleration: Positive = 0.5
    """m/s^2: limit of the increase of the commanded speed."""
    reached: Positive = 0.0012
    """m: the board has arrived when it is this close to its end, and slower than ``still``. In proportion to its sag
    under the heaviest load, its weight over ``board_stiffness_n_m``, if that is above the nominal 0.59 mm."""
    still: Positive = 0.0015
    """m/s."""
    allowance: Positive = 2.0
    """s: time beyond that of the travel at full speed after which the board has failed."""


@record()
class HingeGains(NearNominal):
    """Gains of a slope's hinge."""

    gain: Positive = 6.0
    """1/s: hinge speed commanded per radian of remaining travel, up to the motor's limit."""
    acceleration: Positive = 1.0
    """rad/s^2: limit of the increase of the commanded speed."""
    reached: Positive = 0.01
    """rad: the flap has arrived when it is this close to its end, and slower than ``still`` over ``still_time``."""
    still: Positive = 0.01
    """rad/s."""
    still_time: Positive = 0.1
    """s: longer than a control period, because angles are noisy."""
    undocked: Positive = 0.1
    """s: time without contact to the slope after which it is not there; shorter gaps come from a plug that chatters."""
    allowance: Positive = 4.0
    """s: time beyond that of the travel at full speed after which the hinge has failed."""


@record()
class StopGains(NearNominal):
    """Limits of coming to rest."""

    wheels_at_rest: Positive = 0.03
    """rad/s: a car is at rest when no wheel turns faster."""
    allowance: Positive = 1.0
    """s: time after which wheels that still turn have failed."""


@record()
class HoldGains(NearNominal):
    """Holding a car that is parked on an incline."""

    level: Positive = 0.03
    """rad: a car that leans less than this stays by itself."""
    tipped: Positive = 0.4
    """rad: a car that leans more than this is not held: the incline is 0.28."""
    gain: Positive = 10.0
    """1/s: wheel speed commanded per radian that a wheel has turned."""
    dead_band: Positive = 0.0001
    """rad: a wheel that has turned less than this, 5 micrometres of way, is not moved."""
    crept: Positive = 0.001
    """m: a car further than this from where it was parked, by its estimate, goes back. Three times
    ``position_certainty``, so that noise does not trigger it, and a third of the 2.5 mm between two loads."""
    crept_heading: Positive = 0.004
    """rad: the same for its heading; over half the length of a load, 160 mm, that is 0.6 mm."""
    crept_time: Positive = 0.5
    """s: least duration of that: creep takes seconds for a millimetre, and a passing car shakes for less."""


@record()
class LocalisationGains(NearNominal):
    """Assumptions of the pose estimate about odometry; what it assumes of localisations is a SensorNoise."""

    slip: Positive = 0.06
    """Standard deviation of the odometry's error in one period as a fraction of the way; slip is one-sided and adds up,
    so it is several times what the rollers lose."""
    position_drift: Positive = 0.00002
    """m: standard deviation of the unmeasured motion of a resting car in one period."""
    heading_drift: Positive = 0.00006
    """rad: standard deviation of its unmeasured rotation."""
    placement: Positive = 0.001
    """m: standard deviation of the places of blocks and slopes from the middles of their cells."""


@record()
class HealthGains(NearNominal):
    """Limits at which every skill gives up."""

    tipped: Positive = 0.45
    """rad: a car that leans further than this, in pitch or roll, has tipped."""
    board_raised: Positive = 0.015
    """m: above this height the board may carry something."""
    load_share: Positive = 0.5
    """A raised board carries a load if it feels this fraction of the lightest load's weight beyond its own."""
    load_lost: Positive = 0.3
    """s: a load that is not felt for longer is lost; shorter dips come from bumps and acceleration."""


@record()
class RecoveryGains(NearNominal):
    """Recovery from a failure that may be temporary."""

    tries: Count = 2
    """Largest number of tries; before each further try the car goes back to where it began."""


@record()
class Gains:
    """The gains of all skills; hashable. Raises InputError for a gain that is not positive or far from the nominal one.

    The nominal ones are for any floor: fast where it is flat, and slow where cars feel that it is not. They were chosen
    by hand: the limits of ``uneven`` on tiles with 1 mm of lippage, its tilt between what cars feel on a flat floor
    (docs/explanation/imperfections.md) and there.

    Example:
        >>> import craftsim
        >>> gains = craftsim.load_gains()
        >>> gains.source, gains.drive.max_speed > 0
        ('robust', True)
    """

    drive: DriveGains = DriveGains()
    uneven: UnevenGains = UnevenGains()
    board: BoardGains = BoardGains()
    hinge: HingeGains = HingeGains()
    stop: StopGains = StopGains()
    hold: HoldGains = HoldGains()
    localisation: LocalisationGains = LocalisationGains()
    health: HealthGains = HealthGains()
    recovery: RecoveryGains = RecoveryGains()
    source: str = field(default="robust", compare=False)

    @property
    def digest(self) -> str:
        """SHA-256 of all gains, in hexadecimal: equal for equal gains, wherever they came from."""
        return digest_of({section: asdict(getattr(self, section)) for section in SECTIONS})


SECTIONS: Final[dict[str, type]] = {
    f.name: type(f.default) for f in fields(Gains) if f.name != "source"
}
"""Of :class:`Gains`, by name."""


PRESETS: Final = ("robust", "fast")
"""Gains that ship with craftsim, by name: the nominal ones, which slow down where the floor is uneven, and those that
take it for flat."""
_CAREFUL: Final = {f.name for f in fields(UnevenGains)} & {f.name for f in fields(DriveGains)}


@lru_cache(maxsize=64)
def careful(gains: Gains) -> Gains:
    """Return gains that drive as on an uneven floor everywhere."""
    drive = gains.drive
    uneven = gains.uneven
    limits = {name: min(getattr(drive, name), getattr(uneven, name)) for name in _CAREFUL}
    return replace(gains, drive=replace(drive, **limits))


def _droop_rad_s(car: SmartcarParameters, machines: Machines) -> float:
    """Return by how much gear friction slows a wheel's servo."""
    return car.gear_friction_nm / car.wheel_gain_nms_rad


def _sag_m(car: SmartcarParameters, machines: Machines) -> float:
    """Return by how much the board sags under the heaviest load."""
    heaviest_kg = max(machines.block.mass_kg, machines.slope.mass_kg)
    return (car.board_mass_kg + heaviest_kg) * GRAVITY / car.board_stiffness_n_m


_Figure = Callable[[SmartcarParameters, Machines], float]
"""A figure of a car among machines."""
FOLLOWING: Final[dict[tuple[str, str], _Figure]] = {
    ("drive", "friction_speed"): _droop_rad_s,
    ("board", "reached"): _sag_m,
}
"""The gains that follow from a machine, by section and name, with the figure to which they are proportional."""


def gains_of_car(gains: Gains, car: SmartcarParameters, machines: Machines) -> Gains:
    """Return gains for a car: those of :data:`FOLLOWING` that are nominal, enlarged with their figure.

    A gain that differs from its nominal value was chosen, and stays. What depends on a car's mass, torque and
    friction otherwise is no gain: :mod:`craftsim.skills.limits`, the feed-forward of :mod:`craftsim.skills.laws`.
    """
    changed = gains
    for (section, name), figure in FOLLOWING.items():
        values = getattr(gains, section)
        nominal = getattr(SECTIONS[section](), name)
        factor = figure(car, machines) / figure(NOMINAL.cars[0], NOMINAL)
        if getattr(values, name) == nominal and factor > 1.0:
            enlarged = replace(values, **{name: nominal * min(factor, REACH)})
            changed = replace(changed, **{section: enlarged})
    return changed


def load_gains(path: Path | str | None = None) -> Gains:
    """Return the nominal gains, overridden by those of a YAML file or a preset if one is given.

    The file holds the sections of :class:`Gains`, or holds them under a key ``gains`` beside the machines' figures
    (:func:`craftsim.mjcf.machines.load_machines`). A preset is a name: ``robust``, which are the
    nominal ones, or ``fast``.

    Raises InputError, naming the file and key, for what is not a known gain, and for an unknown preset.

    Example:
        >>> import craftsim
        >>> _ = (folder / "slow.yaml").write_text("drive: {max_speed: 0.4}")
        >>> craftsim.load_gains(folder / "slow.yaml").drive.max_speed
        0.4
        >>> craftsim.load_gains("fast").source
        'fast'
    """
    if path is None or str(path) == "robust":
        return Gains()
    if str(path) == "fast":
        with as_file(files("craftsim.data").joinpath("gains/fast.yaml")) as shipped:
            return replace(load_gains(shipped), source="fast")
    path = Path(path)
    if not path.suffix and not os.path.exists(path):
        close = suggestion(str(path), PRESETS)
        presets = ", ".join(PRESETS)
        raise InputError(f"unknown gains '{path}'{close}; there are {presets}, or give a YAML file")
    document = read_document(path)
    plain = document.plain
    sections = [name for name in document.plain if name in SECTIONS]
    if "gains" in plain:
        if sections:
            conflict = "gains stand both at the top and under 'gains'; give them in one place"
            document.fail((sections[0],), conflict)
        gains = document.to(_File).gains
        sections = [name for name in plain["gains"] if name in SECTIONS]
    else:
        gain_values = {key: value for key, value in plain.items() if key not in MACHINE_SECTIONS}
        gains = replace(document, plain=gain_values).to(Gains)
    return replace(gains, source=str(path) if sections else "robust")


@record(kw_only=True)
class _File:
    gains: Gains
    smartcar: Any = None
    cars: Any = None
    block: Any = None
    slope: Any = None
    contact: Any = None
