"""The gains of all skills: frozen, validated, read from YAML that a tuner can write."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, field, fields, replace
from functools import cache, lru_cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Any, Final, get_type_hints

import yaml
from pydantic import BeforeValidator

from craftsim.errors import InputError, suggestion
from craftsim.mjcf.parameters import MACHINE_SECTIONS, NearNominal, Positive, digest_of
from craftsim.storage.limits import Range
from craftsim.storage.records import record
from craftsim.storage.yaml import read_document


def _whole(value: Any) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() else value


Count = Annotated[int, Range(0, above=True), BeforeValidator(_whole)]
"""A whole number, which a file may also write as 2.0."""


class _Section(NearNominal):
    @classmethod
    def nominal(cls) -> Mapping[str, float]:
        """Return the nominal gains of the section."""
        return _nominal()[next(name for name, kind in SECTIONS.items() if kind is cls)]


@record()
class DriveGains(_Section):
    """Gains and limits of driving; SI units unless the comment says otherwise."""

    position_gain: Positive
    """1/s: speed commanded per metre of position error."""
    heading_gain: Positive
    """1/s: turn rate commanded per radian of heading error."""
    integral_gain: Positive
    """1/s^2: integral action on position and heading, once the path has ended."""
    sideways_slip: Positive
    """Factor of the wheel speeds for sideways motion: rollers turn against their bearings."""
    turn_slip: Positive
    """Factor of the wheel speeds for turning on the spot."""
    friction_speed: Positive
    """rad/s: wheel speed at which the compensation of the gears' dry friction reaches tanh(1) = 76 % of it."""
    max_speed: Positive
    max_acceleration: Positive
    max_slope_speed: Positive
    """m/s: highest speed of a move from or onto a slope: the wheels meet its foot at an angle."""
    max_slope_acceleration: Positive
    """m/s^2: on a slope, and therefore on the things that carry it."""
    max_tight_speed: Positive
    """m/s: highest speed of a move under something, or of a load past something."""
    max_tight_acceleration: Positive
    max_tight_slope_acceleration: Positive
    """m/s^2: of such a move with a load from or onto a slope. The grip must suffice to climb and to keep to the path:
    at the least friction of mild randomization, 0.68, a car can push by 4.5 m/s^2 on the incline; weight takes 2.7."""
    rocking: Positive
    """m^3/s^2: largest product of acceleration and height above the floor squared. A stack of n blocks yields by
    the car's push times its height in each of n joints, and tips in the end."""
    max_turn_speed: Positive
    max_turn_acceleration: Positive
    astray: Positive
    """m: distance of a car from its path at which the path of a load past something waits; never on a flat floor."""
    load_factor: Positive
    """Factor of the speed and acceleration limits of loaded cars."""
    position_tolerance: Positive
    """m: largest position error at rest at the end of a move."""
    heading_tolerance: Positive
    position_certainty: Positive
    """m: largest standard deviation of the estimated position at the end of a move."""
    heading_certainty: Positive
    """rad: largest standard deviation of the estimated heading at the end of a move."""
    settle_allowance: Positive
    """s: time beyond the profile's end after which a move that is not done has failed."""
    shake_after: Positive
    """s: time beyond the profile's end after which a car that has not arrived is shaken."""
    shake_speed: Positive
    """m/s: amplitude of the speed of shaking."""
    shake_rate: Positive
    """Hz: frequency of shaking (:func:`craftsim.skills.laws.shake`)."""
    blocked_error: Positive
    """m: distance behind the path that, for longer than ``blocked_time``, means an obstacle."""
    blocked_time: Positive
    """s."""
    slip_ratio: Positive
    """A car that fell behind slips, and is not blocked, if its wheels rolled by more than this many times its way plus
    ``slip_distance``, and their push would not have moved a free car that far."""
    slip_distance: Positive
    """m."""
    speed_at_rest: Positive
    """m/s: a car is at rest when its wheels together roll slower than this."""
    wheels_at_rest: Positive
    """rad/s: a car is also at rest when three wheels turn slower than this: the fourth may slip on the spot."""
    rest_periods: Count
    """Control periods of rest on the target after which a move is done."""
    brake_periods: Count
    """Control periods on the target after which a car brakes: while it corrects the last tenth of a millimetre, two
    wheels on a diagonal may slip on the spot for ever."""
    motor_share: Positive
    """Largest share of the wheel motors' torque and speed that paths use; the rest is for corrections."""


@record()
class UnevenGains(_Section):
    """Driving where cars find their floor uneven (:mod:`craftsim.skills.estimator`): limits besides those of
    :class:`DriveGains`. A car without springs hops there, and its lowered board clears by a millimetre what it passes
    under."""

    tilt: Positive
    """rad: a floor is uneven if a car leans by more than this, in the mean over ``tilt_time``, on level ground."""
    tilt_time: Positive
    """s: time of that mean: sensors of pitch and roll are noisy, and rollers rattle."""
    max_speed: Positive
    max_acceleration: Positive
    max_slope_speed: Positive
    """m/s: of a move from or onto a slope."""
    max_slope_acceleration: Positive
    max_tight_speed: Positive
    """m/s: of a move under something, or of a load past something."""
    max_tight_acceleration: Positive
    max_turn_speed: Positive
    max_turn_acceleration: Positive
    astray: Positive
    """m: of a load past something, but not on slopes. A car beside its path by half of this drives to and fro along it,
    beyond this it slows down, and at twice this it stops. Half of it is the noise of an estimate in motion, and twice
    it is less than the 2.5 mm between two loads."""
    shake_after: Positive
    """s: on two wheels of a diagonal a car without springs only arrives if it is shaken soon."""
    loose: Positive
    """Standard deviation of the speed of sideways slip as a fraction of the wheels' speed: a car on two wheels of a
    diagonal goes at 45 degrees to its path for a second or longer."""


@record()
class BoardGains(_Section):
    """Gains of the lifting board."""

    gain: Positive
    """1/s: board speed commanded per metre of remaining travel, up to the motor's limit."""
    acceleration: Positive
    """m/s^2: limit of the increase of the commanded speed."""
    reached: Positive
    """m: the board has arrived when it is this close to its end, and slower than ``still``."""
    still: Positive
    """m/s."""
    allowance: Positive
    """s: time beyond that of the travel at full speed after which the board has failed."""


@record()
class HingeGains(_Section):
    """Gains of a slope's hinge."""

    gain: Positive
    """1/s: hinge speed commanded per radian of remaining travel, up to the motor's limit."""
    acceleration: Positive
    """rad/s^2: limit of the increase of the commanded speed."""
    reached: Positive
    """rad: the flap has arrived when it is this close to its end, and slower than ``still`` over ``still_time``."""
    still: Positive
    """rad/s."""
    still_time: Positive
    """s: longer than a control period, because angles are noisy."""
    undocked: Positive
    """s: time without contact to the slope after which it is not there; shorter gaps come from a plug that chatters."""
    allowance: Positive
    """s: time beyond that of the travel at full speed after which the hinge has failed."""


@record()
class StopGains(_Section):
    """Limits of coming to rest."""

    wheels_at_rest: Positive
    """rad/s: a car is at rest when no wheel turns faster."""
    allowance: Positive
    """s: time after which wheels that still turn have failed."""


@record()
class HoldGains(_Section):
    """Holding a car that is parked on an incline."""

    level: Positive
    """rad: a car that leans less than this stays by itself."""
    tipped: Positive
    """rad: a car that leans more than this is not held: the incline is 0.28."""
    gain: Positive
    """1/s: wheel speed commanded per radian that a wheel has turned."""
    dead_band: Positive
    """rad: a wheel that has turned less than this, 5 micrometres of way, is not moved."""
    crept: Positive
    """m: a car further than this from where it was parked, by its estimate, goes back. Three times
    ``position_certainty``, so that noise does not trigger it, and a third of the 2.5 mm between two loads."""
    crept_heading: Positive
    """rad: the same for its heading; over half the length of a load, 160 mm, that is 0.6 mm."""
    crept_time: Positive
    """s: least duration of that: creep takes seconds for a millimetre, and a passing car shakes for less."""


@record()
class LocalisationGains(_Section):
    """What the pose estimate assumes of odometry; what it assumes of localisations is a SensorNoise."""

    slip: Positive
    """Standard deviation of the odometry's error in one period as a fraction of the way; slip is one-sided and adds up,
    so it is several times what the rollers lose."""
    position_drift: Positive
    """m: standard deviation of the unmeasured motion of a resting car in one period."""
    heading_drift: Positive
    """rad: standard deviation of its unmeasured rotation."""
    placement: Positive
    """m: standard deviation of the places of blocks and slopes from the middles of their cells."""


@record()
class HealthGains(_Section):
    """When every skill gives up."""

    tipped: Positive
    """rad: a car that leans further than this, in pitch or roll, has tipped."""
    board_raised: Positive
    """m: above this height the board may carry something."""
    load_share: Positive
    """A raised board carries a load if it feels this fraction of the lightest load's weight beyond its own."""
    load_lost: Positive
    """s: a load that is not felt for longer is lost; shorter dips come from bumps and acceleration."""


@record()
class RecoveryGains(_Section):
    """What follows a failure that may be temporary."""

    tries: Count
    """Largest number of tries; before each further try the car goes back to where it began."""


@record()
class Gains:
    """The gains of all skills; hashable. Raises InputError for a gain that is not positive or far from the nominal one.

    Example:
        >>> import craftsim
        >>> gains = craftsim.load_gains()
        >>> gains.source, gains.drive.max_speed > 0
        ('robust', True)
    """

    drive: DriveGains
    uneven: UnevenGains
    board: BoardGains
    hinge: HingeGains
    stop: StopGains
    hold: HoldGains
    localisation: LocalisationGains
    health: HealthGains
    recovery: RecoveryGains
    source: str = field(default="robust", compare=False)

    @property
    def digest(self) -> str:
        """SHA-256 of all gains, in hexadecimal: equal for equal gains, wherever they came from."""
        return digest_of({section: asdict(getattr(self, section)) for section in SECTIONS})


SECTIONS: Final[dict[str, type]] = {
    name: kind for name, kind in get_type_hints(Gains).items() if name != "source"
}
"""Of :class:`Gains`, by name."""


PRESETS: Final = ("robust", "fast")
"""Gains that ship with craftsim, by name: the nominal ones, which slow down where the floor is uneven, and those that
take it for flat."""
_CAREFUL: Final = {f.name for f in fields(UnevenGains)} & {f.name for f in fields(DriveGains)}


@lru_cache(maxsize=64)
def careful(gains: Gains) -> Gains:
    """Return gains that drive as on an uneven floor everywhere."""
    drive, uneven = gains.drive, gains.uneven
    limits = {name: min(getattr(drive, name), getattr(uneven, name)) for name in _CAREFUL}
    return replace(gains, drive=replace(drive, **limits))


def load_gains(path: Path | str | None = None) -> Gains:
    """Return the nominal gains, overridden by those of a YAML file or a preset if one is given.

    The file holds the sections of :class:`Gains`, or holds them under a key ``gains`` beside the machines' figures
    (:func:`craftsim.mjcf.parameters.load_machines`). A preset is a name: ``robust``, which are the
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
    nominal = _nominal()
    if path is None or str(path) == "robust":
        return Gains(**{name: kind(**nominal[name]) for name, kind in SECTIONS.items()})
    if str(path) == "fast":
        with as_file(files("craftsim.data").joinpath("gains/fast.yaml")) as shipped:
            return replace(load_gains(shipped), source="fast")
    path = Path(path)
    if not path.suffix and not os.path.exists(path):
        known = ", ".join(PRESETS)
        raise InputError(
            f"unknown gains '{path}'{suggestion(str(path), PRESETS)}; there are {known}, or give a YAML file"
        )
    document = read_document(path)
    plain, given = document.plain, [name for name in document.plain if name in SECTIONS]
    if "gains" in plain:
        if given:
            document.fail(
                (given[0],), "gains stand both at the top and under 'gains'; give them in one place"
            )
        gains = document.over({"gains": nominal}).to(_File).gains
        given = [name for name in plain["gains"] if name in SECTIONS]
    else:
        own = {key: value for key, value in plain.items() if key not in MACHINE_SECTIONS}
        gains = replace(document, plain=own).over(nominal).to(Gains)
    return replace(gains, source=str(path) if given else "robust")


@record(kw_only=True)
class _File:
    gains: Gains
    smartcar: Any = None
    cars: Any = None
    block: Any = None
    slope: Any = None
    contact: Any = None


@cache
def _nominal() -> dict[str, dict[str, float]]:
    shipped = files("craftsim.data").joinpath("gains/robust.yaml").read_text(encoding="utf-8")
    nominal: dict[str, dict[str, float]] = yaml.safe_load(shipped)
    return nominal
