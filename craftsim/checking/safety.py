"""What may not happen whatever an action is for: tipping, falling, hitting hard."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from craftsim.checking.contact_log import ContactLog
from craftsim.models.parameters import NOMINAL, Machines
from craftsim.skills.skill import GRAVITY

TIPPED_RAD: Final = 0.5
"""How far anything may lean: the incline is 0.28 rad, and a car on it slides before it leans further."""
FALL_M_S: Final = 0.5
"""How fast anything may move down: a drop of 13 mm. Descents and boards stay below 0.14 m/s."""


@lru_cache(maxsize=16)
def impact_limit_n(machines: Machines = NOMINAL) -> float:
    """Return how hard two machines may press on each other, in newtons; 627 N for the nominal ones.

    The heaviest loaded car weighs 112 N and its wheel motors push with 202 N at most. What is put on at once loads a
    stiff contact up to twice as much as it does at rest; more can only come from the motion of something that is
    stopped. Of the legal actions that ``craftsim audit --rules physical --only legal`` performs, 99 % stay below
    314 N, and the hardest reaches 482 N.
    """
    load = max(machines.block.mass_kg, machines.slope.mass_kg)
    return max(
        2 * ((car.mass_kg + load) * GRAVITY + 4 * car.wheel_torque_nm / car.wheel_radius_m)
        for car in machines.cars
    )


@dataclass(frozen=True)
class Hazard:
    """Something unsafe that happened."""

    machines: tuple[str, ...]
    """Those concerned, by the names of the contact log."""
    text: str


def is_unsafe(log: ContactLog) -> bool:
    """Return whether anything was unsafe since the log began; quicker than asking for all that was."""
    return (
        log.tilt_rad > TIPPED_RAD or log.fall_m_s > FALL_M_S or log.peak_n > impact_limit_n(log.site.machines)
    )


def hazards(log: ContactLog) -> tuple[Hazard, ...]:
    """Return all that was unsafe since the log began."""
    limit = impact_limit_n(log.site.machines)
    tipped = {name: tilt for name, tilt in log.tilts_rad.items() if tilt > TIPPED_RAD}
    fallen = {name: speed for name, speed in log.falls_m_s.items() if speed > FALL_M_S}
    hits = [(c.first, c.second, c.peak_n) for c in log.contacts if c.peak_n > limit]
    return (
        *(Hazard((name,), f"{name} tipped ({tilt:.1f} rad)") for name, tilt in tipped.items()),
        *(Hazard((name,), f"{name} fell ({speed:.1f} m/s)") for name, speed in fallen.items()),
        *(Hazard((a, b), f"{a} and {b} hit each other ({force:.0f} N)") for a, b, force in hits),
    )
