"""What may not happen whatever an action is for: tipping, falling, hitting hard."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from craftsim.checking.contact_log import ContactLog

TIPPED_RAD: Final = 0.5
"""How far anything may lean: the incline is 0.28 rad, and a car on it slides before it leans further."""
FALL_M_S: Final = 0.5
"""How fast anything may move down: a drop of 13 mm. Descents and boards stay below 0.14 m/s."""


@dataclass(frozen=True)
class Hazard:
    """Something unsafe that happened."""

    machines: tuple[str, ...]
    """Those concerned, by the names of the contact log."""
    text: str


def is_unsafe(log: ContactLog) -> bool:
    """Return whether anything was unsafe since the log began; quicker than asking for all that was."""
    return log.tilt_rad > TIPPED_RAD or log.fall_m_s > FALL_M_S or log.peak_n > log.limit_n


def hazards(log: ContactLog) -> tuple[Hazard, ...]:
    """Return all that was unsafe since the log began."""
    tipped = {name: tilt for name, tilt in log.tilts_rad.items() if tilt > TIPPED_RAD}
    fallen = {name: speed for name, speed in log.falls_m_s.items() if speed > FALL_M_S}
    hits = [(c.first, c.second, c.peak_n) for c in log.contacts if c.peak_n > log.limit_n]
    return (
        *(Hazard((name,), f"{name} tipped ({tilt:.1f} rad)") for name, tilt in tipped.items()),
        *(Hazard((name,), f"{name} fell ({speed:.1f} m/s)") for name, speed in fallen.items()),
        *(Hazard((a, b), f"{a} and {b} hit each other ({force:.0f} N)") for a, b, force in hits),
    )
