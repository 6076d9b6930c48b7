"""What touches what while an action runs, how hard, and how far things lean and how fast they fall.

The log looks at contacts after every physics step, and at motion between control periods, at 50 Hz: a thing that falls
by 25 mm or more is faster than 0.5 m/s when it is looked at.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Collection
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import mujoco
import numpy as np

from craftsim.checking.contact_forces import note_contacts, note_motion
from craftsim.checking.forces import PossibleForce, impact_limit_n
from craftsim.models.world import Site
from craftsim.storage.writing import whole


@dataclass(frozen=True)
class Contact:
    """Two machines that touched each other."""

    first: str
    """Name of a machine, such as ``car 0``, ``block 3``, ``slope 1``, ``flag 0``, ``wall`` or ``ground``."""
    second: str
    since_s: float
    """Simulated time at which they were first seen to touch."""
    peak_n: float
    """Largest net normal force: the vector sum over all their points of contact."""
    at_start: bool
    """Whether they touched when the log began."""


class ContactLog:
    """Contacts between the machines of a Site, and their motion, from :meth:`begin` on.

    Contacts inside one machine, such as of a slope's flap with its base, are left out.
    """

    def __init__(self, site: Site, force: float = 1.0) -> None:
        """Prepare for a Site, and begin; ``force`` is the share of :func:`impact_limit_n` that is no blow yet."""
        self.site = site
        model = site.model
        machines = site.machine_names
        self.names, self._machine = machines.names, machines.of_geom
        """Of all machines: what is fixed first, then those that move in the order of their bodies."""
        self._possible = PossibleForce(site, machines.roots)
        self.limit_n = force * impact_limit_n(site.machines)
        """What counts as a blow."""
        joints = [int(model.body_jntadr[body]) for body in machines.roots]
        self._pose_address = np.array([model.jnt_qposadr[j] for j in joints], np.intp)
        self._velocity_address = np.array([model.jnt_dofadr[j] for j in joints], np.intp)
        self.period_n = 0.0
        """The largest force between any two machines in the last control period."""
        self.begin()

    def begin(self) -> None:
        """Forget everything, and note what touches now."""
        n = len(self.names)
        # Two machines are a pair; its number is n times the first's place in ``names`` plus the second's.
        self._since = np.full(n * n, math.inf)
        self._peak = np.zeros(n * n)
        self._net = np.zeros((n * n, 4))
        self._touched, self._blows = np.zeros((2, n * n), np.int64)
        self._hardest_n = self._hardest_since_n = 0.0
        self._impossible: dict[int, tuple[float, float]] = {}
        self._fall, self._upright = np.zeros(n - 2), np.ones(n - 2)
        self._worst = np.array([0.0, 1.0])
        """The least of each of the two."""
        self._note(self.site.awake_copy())
        self._looked_s = math.nan
        self._at_start = np.isfinite(self._since)

    def begin_with(self, machines: Collection[str]) -> None:
        """Forget what these touched, and note what they touch now: an action with them begins while others run."""
        n = len(self.names)
        rows = [self.names.index(name) for name in machines]
        for pairs, nothing in ((self._since, math.inf), (self._peak, 0.0)):
            square = pairs.reshape(n, n)
            square[rows], square[:, rows] = nothing, nothing
        self._note(self.site.awake_copy())
        touching = self._at_start.reshape(n, n)
        for own in (np.s_[rows], np.s_[:, rows]):
            touching[own] = np.isfinite(self._since.reshape(n, n)[own])

    def look(self) -> None:
        """Note what touches and how hard; call it after each physics step, such as by being an executor's observer."""
        data = self.site.data
        self._looked_s = data.time
        self._note(data)

    def sample(self, _: Site | None = None) -> None:
        """Note contacts and motion; call it after each control period, such as by being an executor's observer."""
        data = self.site.data
        if self._looked_s != data.time:
            self.look()
        self.period_n, self._hardest_since_n = self._hardest_since_n, 0.0
        note_motion(
            data.qpos,
            data.qvel,
            self._pose_address,
            self._velocity_address,
            self._fall,
            self._upright,
            self._worst,
        )

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """All that touched, those first that touched first."""
        n = len(self.names)
        found = [
            Contact(
                self.names[pair // n],
                self.names[pair % n],
                float(self._since[pair]),
                float(self._peak[pair]),
                bool(self._at_start[pair]),
            )
            for pair in np.flatnonzero(np.isfinite(self._since))
        ]
        return tuple(sorted(found, key=lambda contact: contact.since_s))

    @property
    def peak_n(self) -> float:
        """The largest force between any two machines, the ground included; 0 where nothing touched."""
        return self._hardest_n

    @property
    def impossible(self) -> tuple[str, ...]:
        """A line for each force that nothing here could have produced (:mod:`craftsim.checking.forces`)."""
        n = len(self.names)
        return tuple(
            f"{self.names[pair // n]} and {self.names[pair % n]} press on each other with {force:.0f} N, more than "
            f"weights, motors and motion could ({possible:.0f} N)"
            for pair, (force, possible) in self._impossible.items()
        )

    @property
    def fall_m_s(self) -> float:
        """The fastest that any machine moved down."""
        return -float(self._worst[0])

    @property
    def tilt_rad(self) -> float:
        """The furthest that any machine leaned."""
        return math.acos(max(-1.0, float(self._worst[1])))

    @property
    def falls_m_s(self) -> dict[str, float]:
        """The fastest that each machine moved down."""
        return {name: -float(v) for name, v in zip(self.names[2:], self._fall, strict=True)}

    @property
    def tilts_rad(self) -> dict[str, float]:
        """The furthest that each machine leaned."""
        tilts = np.arccos(np.clip(self._upright, -1.0, 1.0))
        return {name: float(tilt) for name, tilt in zip(self.names[2:], tilts, strict=True)}

    def write(self, path: Path) -> None:
        """Write the contacts as CSV with a line of headings; raise InputError where the disk does not take it."""
        with whole(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([field.name for field in fields(Contact)])
            writer.writerows(astuple(contact) for contact in self.contacts)

    def _note(self, data: mujoco.MjData) -> None:
        """Note what touches, and how hard; look closer at forces as hard as a hazard that are new peaks."""
        if not data.ncon:
            return
        contact = data.contact
        n_blows, hardest = note_contacts(
            contact.geom1,
            contact.geom2,
            contact.frame,
            contact.efc_address,
            data.efc_force,
            data.time,
            self._machine,
            len(self.names),
            self.limit_n,
            self._net,
            self._touched,
            self._since,
            self._peak,
            self._blows,
        )
        self._hardest_n = max(self._hardest_n, hardest)
        self._hardest_since_n = max(self._hardest_since_n, hardest)
        for pair in self._blows[:n_blows].tolist():
            machines = [machine - 2 for machine in divmod(pair, len(self.names)) if machine >= 2]
            possible = self._possible.newtons(machines)
            if self._peak[pair] > possible:
                self._impossible[pair] = float(self._peak[pair]), possible


def speed_m_s(site: Site) -> float:
    """Return how fast the fastest machine of a Site moves now."""
    handles = [
        *(car.base for car in site.cars),
        *site.blocks,
        *site.flags,
        *(slope.base for slope in site.slopes),
    ]
    velocity = site.data.qvel[np.array([body.dof for body in handles], np.intp)[:, None] + np.arange(3)]
    return float(np.sqrt((velocity * velocity).sum(axis=1).max(initial=0.0)))
