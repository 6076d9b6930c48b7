"""Which gains are tuned, within which bounds and in which situations, and which are not, and why.

The position of a gain is on a logarithmic scale: 0 is the start, 1 the start times its span, -1 divided by it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from fnmatch import fnmatchcase
from typing import Any, Final, Literal

from craftsim.audit.situation import Row, shipped
from craftsim.audit.survey import row_of
from craftsim.mjcf.parameters import REACH
from craftsim.skills.gains import SECTIONS, Gains, load_gains

GainGroup = Literal["drive", "board", "hinge", "all"]
GAIN_GROUPS: Final[Mapping[GainGroup, tuple[str, ...]]] = {
    "drive": ("drive",),
    "board": ("board",),
    "hinge": ("hinge",),
    "all": ("drive", "board", "hinge"),
}
"""The sections of the gains that are tuned together."""


def _fixed() -> dict[str, str]:
    reasons = shipped("fixed_gains.yaml")
    fixed: dict[str, str] = {}
    for section, kind in SECTIONS.items():
        for field in fields(kind):
            name = f"{section}.{field.name}"
            for reason, patterns in reasons.items():
                if any(fnmatchcase(name, pattern) for pattern in patterns):
                    fixed.setdefault(name, reason)
    return fixed


FIXED: Final[Mapping[str, str]] = _fixed()
"""The gains that are never tuned, with the reason; all others are."""

_SPAN: Final = 8.0
"""By what factor a gain is changed at most, up or down."""
_MOST: Final = {"drive.load_factor": 1.0, "drive.motor_share": 1.0}
"""Fractions."""


@dataclass(frozen=True)
class TunableGain:
    """A gain that is tuned."""

    section: str
    field: str
    start: float
    span: float
    low: float
    """Smallest value that is tried."""
    high: float

    @property
    def name(self) -> str:
        """Such as ``drive.position_gain``."""
        return f"{self.section}.{self.field}"

    def of(self, gains: Gains) -> float:
        """Return its gain among others."""
        return float(getattr(getattr(gains, self.section), self.field))

    @property
    def bounds(self) -> tuple[float, float]:
        """The positions at its smallest and its largest value."""
        return self.position(self.low), self.position(self.high)

    def position(self, value: float) -> float:
        """Return the position that gives a value."""
        return math.log(value / self.start) / math.log(self.span)

    def value(self, position: float) -> float:
        """Return the gain at a position, to the six digits that a file shows; beyond its bounds the nearest within."""
        return float(f"{min(max(self.start * self.span**position, self.low), self.high):.6g}")


def tunable_gains(group: GainGroup, start: Gains) -> tuple[TunableGain, ...]:
    """Return the tuned gains of a group, in the order of the gains, around a start."""
    nominal = load_gains()
    gains = []
    names: list[tuple[str, str]] = []
    for section in GAIN_GROUPS[group]:
        names += [(section, field.name) for field in fields(SECTIONS[section])]
    for section, field in names:
        name = f"{section}.{field}"
        if name in FIXED:
            continue
        value = float(getattr(getattr(start, section), field))
        usual = float(getattr(getattr(nominal, section), field))
        span = _SPAN
        # What a file of gains may hold (craftsim.mjcf.parameters.NearNominal).
        low = max(value / span, usual / REACH)
        high = min(value * span, usual * REACH)
        high = max(value, min(high, _MOST.get(name, math.inf)))
        gains.append(TunableGain(section, field, value, span, low, high))
    return tuple(gains)


def with_values(start: Gains, tunable: Sequence[TunableGain], values: Mapping[str, float]) -> Gains:
    """Return gains with other values for some of them, by name; the others are those of ``start``."""
    values_of: dict[str, dict[str, float]] = {}
    for gain in tunable:
        section_values = values_of.setdefault(gain.section, {})
        if gain.name in values:
            section_values[gain.field] = values[gain.name]
    sections: dict[str, Any] = {}
    for section, section_values in values_of.items():
        sections[section] = replace(getattr(start, section), **section_values)
    return replace(start, **sections, source="tuned")


def values_at(tunable: Sequence[TunableGain], positions: Iterable[float]) -> dict[str, float]:
    """Return the gains at these positions, by name."""
    return {
        gain.name: gain.value(float(position))
        for gain, position in zip(tunable, positions, strict=True)
    }


_SECTIONS: Final = {
    section: tuple(map(row_of, rows)) for section, rows in shipped("tuning.yaml").items()
}
"""Those of ``craftsim/data/tuning.yaml``, by the section of the gains."""


def situations(group: GainGroup) -> tuple[Row, ...]:
    """Return the situations in which a group is tried: single actions, each where another gain matters."""
    rows = []
    for section in GAIN_GROUPS[group]:
        for row in _SECTIONS[section]:
            rows.append(row)
    return tuple(rows)
