"""What may not happen whatever an action is for: tipping, falling, hitting hard."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from craftsim.checking.contact_log import ContactLog
from craftsim.discrete.geometry import INCLINE_RAD
from craftsim.discrete.readback import TILT_TOLERANCE_RAD

TIPPED_RAD: Final = INCLINE_RAD + TILT_TOLERANCE_RAD
"""How far anything may lean, 0.33 rad: the incline, and as much more as still counts as standing on it. What should
stand still is held against narrower limits (:mod:`craftsim.checking.standing`)."""
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
    """Return all that was unsafe since the log began, each with what was allowed."""
    tipped = {name: tilt for name, tilt in log.tilts_rad.items() if tilt > TIPPED_RAD}
    fallen = {name: speed for name, speed in log.falls_m_s.items() if speed > FALL_M_S}
    hits = [(c.first, c.second, c.peak_n) for c in log.contacts if c.peak_n > log.limit_n]
    limit = f"allowed {log.limit_n:.0f}"
    return (
        *(
            Hazard((name,), f"{name} tipped ({tilt:.2f} rad, allowed {TIPPED_RAD:.2f})")
            for name, tilt in tipped.items()
        ),
        *(
            Hazard((name,), f"{name} fell ({v:.1f} m/s, allowed {FALL_M_S:.1f})")
            for name, v in fallen.items()
        ),
        *(Hazard((a, b), f"{a} and {b} hit each other ({force:.0f} N, {limit})") for a, b, force in hits),
    )
