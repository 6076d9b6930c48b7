"""The gains of all skills: frozen, validated, read from YAML that a tuner can write."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, fields
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml

from craftsim.discrete.errors import InputError, suggestion


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
    blocked_error: float
    """m: falling this far behind the path means that something is in the way."""


@dataclass(frozen=True)
class BoardGains:
    """Gains of the lifting board."""

    gain: float
    """1/s: board speed commanded per metre of remaining travel, up to the published limit."""
    acceleration: float
    """m/s^2: how fast the commanded speed may grow."""


@dataclass(frozen=True)
class HingeGains:
    """Gains of a slope's hinge."""

    gain: float
    """1/s: hinge speed commanded per radian of remaining travel, up to the published limit."""
    acceleration: float
    """rad/s^2: how fast the commanded speed may grow."""


@dataclass(frozen=True)
class Gains:
    """The gains of all skills; hashable. Raises InputError for a gain that is not a positive finite number."""

    drive: DriveGains
    board: BoardGains
    hinge: HingeGains
    source: str = field(default="nominal", compare=False)

    def __post_init__(self) -> None:
        for section in ("drive", "board", "hinge"):
            for name, value in asdict(getattr(self, section)).items():
                if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
                    raise InputError(
                        f"{self.source}: {section}.{name} must be a positive number, not {value!r}"
                    )


def load_gains(path: Path | None = None) -> Gains:
    """Return the nominal gains, overridden by those of a YAML file if one is given.

    Raises InputError, naming the file and key, for what is not a known gain.
    """
    nominal = yaml.safe_load(
        files("craftsim.data").joinpath("gains/nominal.yaml").read_text(encoding="utf-8")
    )
    if path is None:
        return _build(nominal, {}, "nominal")
    try:
        given = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a YAML file of gains") from error
    except (yaml.YAMLError, ValueError) as error:
        # ValueError: bytes that are no UTF-8, or a date that no calendar has.
        raise InputError(f"{path}: not YAML: {error}") from error
    return _build(nominal, given if given is not None else {}, str(path))


def _build(nominal: dict[str, dict[str, float]], given: Any, source: str) -> Gains:
    sections: dict[str, type] = {"drive": DriveGains, "board": BoardGains, "hinge": HingeGains}
    if not isinstance(given, dict):
        raise InputError(f"{source}: expected the sections {', '.join(sections)}")
    merged: dict[str, Any] = {}
    for section in given:
        if section != "source" and section not in sections:  # a dump of Gains names where it came from
            raise InputError(f"{source}: unknown section {section!r}{suggestion(str(section), sections)}")
    for section, kind in sections.items():
        known = [f.name for f in fields(kind)]
        own = given.get(section, {})
        if not isinstance(own, dict):
            raise InputError(f"{source}: {section} must hold the keys {', '.join(known)}")
        for key in own:
            if key not in known:
                raise InputError(f"{source}: unknown gain {section}.{key}{suggestion(str(key), known)}")
        merged[section] = kind(**(nominal[section] | own))
    return Gains(**merged, source=source)
