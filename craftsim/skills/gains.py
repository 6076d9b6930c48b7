"""The gains of all skills: frozen, validated, read from YAML that a tuner can write."""

from __future__ import annotations

import math
import os
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cache, lru_cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import Final, get_type_hints

import yaml

from craftsim.errors import InputError, suggestion
from craftsim.mjcf.machine_files import MACHINE_SECTIONS
from craftsim.mjcf.parameters import check_reach, digest_of
from craftsim.storage.yaml import numbers, read_keys


@dataclass(frozen=True)
class DriveGains:
    """Gains and limits of driving; SI units unless the comment says otherwise."""

    position_gain: float
    """1/s: speed commanded per metre of position error."""
    heading_gain: float
    """1/s: turn rate commanded per radian of heading error."""
    integral_gain: float
    """1/s^2: integral action on position and heading, once the path has ended."""
    sideways_slip: float
    """By how much the wheels must outrun ideal kinematics to go sideways: rollers turn against their bearings."""
    turn_slip: float
    """The same for turning on the spot."""
    friction_speed: float
    """rad/s: wheel speed at which the compensation of the gears' dry friction reaches tanh(1) = 76 % of it."""
    max_speed: float
    max_acceleration: float
    max_slope_speed: float
    """m/s: highest speed of a move from or onto a slope: the wheels meet its foot at an angle."""
    max_slope_acceleration: float
    """m/s^2: on a slope, and therefore on the things that carry it."""
    max_tight_speed: float
    """m/s: highest speed of a move under something, or of a load past something."""
    max_tight_acceleration: float
    max_tight_slope_acceleration: float
    """m/s^2: of such a move with a load from or onto a slope. A car that needs all of its grip to climb has none left
    to keep to its path: at the friction of 0.68 that is the least of mild randomization, it can push by 4.5 m/s^2 on
    the incline, and its weight takes 2.7."""
    rocking: float
    """m^3/s^2: largest product of acceleration and height above the floor squared. A stack of n blocks gives way under
    a car by its push times its height in each of n joints, and tips in the end."""
    max_turn_speed: float
    max_turn_acceleration: float
    load_factor: float
    """Loaded cars keep to this fraction of the speed and acceleration limits."""
    position_tolerance: float
    """m: a move is done when it is this close at rest."""
    heading_tolerance: float
    position_certainty: float
    """m: a move is not done before the car knows its position to within this standard deviation."""
    heading_certainty: float
    """rad: and its heading."""
    settle_allowance: float
    """s: time beyond the profile's end after which a move that is not done has failed."""
    shake_after: float
    """s: a car that has not arrived so long after the profile's end is shaken..."""
    shake_speed: float
    """m/s: ...to and fro with this amplitude of its speed..."""
    shake_rate: float
    """Hz: ...and so often (:func:`craftsim.skills.laws.shake`)."""
    blocked_error: float
    """m: falling this far behind the path, for longer than ``blocked_time``, means that something is in the way."""
    blocked_time: float
    """s."""
    slip_ratio: float
    """A car that fell behind slips, and is not blocked, if its wheels rolled by more than this many times its way..."""
    slip_distance: float
    """m: ...and this much, and their push would not have moved a free car that far."""
    speed_at_rest: float
    """m/s: a car is at rest when its wheels together roll slower than this..."""
    wheels_at_rest: float
    """rad/s: ...or three of them turn slower than this: the fourth may slip on the spot."""
    rest_periods: float
    """Control periods: a move is done when the car has been at rest on its target for so long."""
    brake_periods: float
    """Control periods: a car that has been on its target for so long brakes. While it corrects the last tenth of a
    millimetre, two wheels on a diagonal may slip on the spot for ever."""
    motor_share: float
    """Paths use at most this fraction of the wheel motors' torque and speed; the rest is for corrections."""


@dataclass(frozen=True)
class UnevenGains:
    """Driving where cars feel that their floor is uneven (:mod:`craftsim.skills.estimator`): limits besides those of
    :class:`DriveGains`. A car without springs hops there, and its lowered board clears by a millimetre what it passes
    under."""

    tilt: float
    """rad: a floor is uneven if a car leans by more than this on what should be level..."""
    tilt_time: float
    """s: ...in the mean over this time: what sensors of pitch and roll read is noisy, and rollers rattle."""
    max_speed: float
    max_acceleration: float
    max_slope_speed: float
    """m/s: of a move from or onto a slope."""
    max_slope_acceleration: float
    max_tight_speed: float
    """m/s: of a move under something, or of a load past something."""
    max_tight_acceleration: float
    max_turn_speed: float
    max_turn_acceleration: float
    shake_after: float
    """s: on two wheels of a diagonal a car without springs does not get to its goal, unless it is shaken soon."""


@dataclass(frozen=True)
class BoardGains:
    """Gains of the lifting board."""

    gain: float
    """1/s: board speed commanded per metre of remaining travel, up to the motor's limit."""
    acceleration: float
    """m/s^2: how fast the commanded speed may grow."""
    reached: float
    """m: the board has arrived when it is this close to its end..."""
    still: float
    """m/s: ...and slower than this."""
    allowance: float
    """s: time beyond that of the travel at full speed after which the board has failed."""


@dataclass(frozen=True)
class HingeGains:
    """Gains of a slope's hinge."""

    gain: float
    """1/s: hinge speed commanded per radian of remaining travel, up to the motor's limit."""
    acceleration: float
    """rad/s^2: how fast the commanded speed may grow."""
    reached: float
    """rad: the flap has arrived when it is this close to its end..."""
    still: float
    """rad/s: ...and slower than this..."""
    still_time: float
    """s: ...over this time: the difference of two readings says little, for they are noisy."""
    undocked: float
    """s: a slope that is not felt for longer is not there; shorter gaps come from a plug that chatters."""
    allowance: float
    """s: time beyond that of the travel at full speed after which the hinge has failed."""


@dataclass(frozen=True)
class StopGains:
    """Limits of coming to rest."""

    wheels_at_rest: float
    """rad/s: a car is at rest when no wheel turns faster."""
    allowance: float
    """s: time after which wheels that still turn have failed."""


@dataclass(frozen=True)
class HoldGains:
    """Holding a car that is parked on an incline."""

    level: float
    """rad: a car that leans less than this stays where it is by itself."""
    tipped: float
    """rad: a car that leans more than this is not held: the incline is 0.28."""
    gain: float
    """1/s: wheel speed commanded per radian that a wheel has turned."""
    dead_band: float
    """rad: a wheel that has turned less than this, 5 micrometres of way, is not moved."""
    crept: float
    """m: a car that believes to be further than this from where it was left goes back. Three times the certainty with
    which a move ends (``position_certainty``), so that what it sees is its way and no noise; and a third of the 2.5 mm
    between two loads in neighbouring cells."""
    crept_heading: float
    """rad: the same for its heading; over half the length of a load, 160 mm, that is 0.6 mm."""
    crept_time: float
    """s: for so long without a pause; creep takes seconds for a millimetre, and what a passing car shakes is back."""


@dataclass(frozen=True)
class LocalisationGains:
    """What the pose estimate assumes of odometry; what it assumes of localisations is a SensorNoise of its own."""

    slip: float
    """Standard deviation of the odometry's error in one period as a fraction of the way; slip is one-sided and adds up,
    so it is several times what the rollers lose."""
    position_drift: float
    """m: standard deviation of what moves a resting car unseen in one period."""
    heading_drift: float
    """rad: and of what turns it."""
    placement: float
    """m: standard deviation of the places of blocks and slopes from the middles of their cells."""


@dataclass(frozen=True)
class HealthGains:
    """When every skill gives up."""

    tipped: float
    """rad: a car that leans further than this, in pitch or roll, has tipped."""
    board_raised: float
    """m: above this height the board may carry something."""
    load_share: float
    """A raised board carries a load if it feels this fraction of the lightest load's weight beyond its own."""
    load_lost: float
    """s: a load that is not felt for longer is lost; shorter dips come from bumps and acceleration."""


@dataclass(frozen=True)
class RecoveryGains:
    """What becomes of an action that failed for a reason that may pass."""

    tries: float
    """How often it is tried; before each further try the car goes back to where it began."""


@dataclass(frozen=True)
class Gains:
    """The gains of all skills; hashable. Raises InputError for a gain that is no positive number near the nominal one.

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

    def __post_init__(self) -> None:
        for section in SECTIONS:
            for name, value in asdict(getattr(self, section)).items():
                _check(self.source, section, name, value)


SECTIONS: Final[dict[str, type]] = {
    name: kind for name, kind in get_type_hints(Gains).items() if name != "source"
}
"""Of :class:`Gains`, by name."""


def _check(where: str, section: str, name: str, value: object) -> None:
    """Raise InputError, beginning with ``where``, for a gain that is no positive number near the nominal one."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
        given = f"{value:g}" if isinstance(value, float) else repr(value)
        raise InputError(f"{where}: {section}.{name} must be a positive number, not {given}")
    check_reach(f"{where}: {section}.{name}", value, _nominal()[section][name])


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
    (:func:`craftsim.mjcf.machine_files.load_machines`). A preset is a name: ``robust``, which are the
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
    document = read_keys(path, [*SECTIONS, "gains", "source", *MACHINE_SECTIONS])
    sections, at = [name for name in document.plain if name in SECTIONS], tuple[str, ...]()
    if "gains" in document.plain:
        if sections:
            text = "gains stand both at the top and under 'gains'; give them in one place"
            document.fail((sections[0],), text)
        at = ("gains",)
        sections = [name for name in document.mapping([*SECTIONS, "source"], *at) if name in SECTIONS]
    merged = {}
    for name, kind in SECTIONS.items():
        own: dict[str, float] = {}
        if name in sections:
            own = numbers(document, name, [f.name for f in fields(kind)], *at, name)
        for key, value in own.items():
            _check(f"{path}:{document.lines[*at, name, key]}", name, key, value)
        merged[name] = kind(**(nominal[name] | own))
    return Gains(**merged, source=str(path) if sections else "robust")


@cache
def _nominal() -> dict[str, dict[str, float]]:
    shipped = files("craftsim.data").joinpath("gains/robust.yaml").read_text(encoding="utf-8")
    nominal: dict[str, dict[str, float]] = yaml.safe_load(shipped)
    return nominal
