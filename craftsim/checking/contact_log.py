"""What touches what while an action runs, how hard, and how far things lean and how fast they fall.

The log looks at contacts after every physics step, and at motion between control periods, at 50 Hz: a thing that falls
by 25 mm or more is faster than 0.5 m/s when it is looked at.
"""

from __future__ import annotations

import csv
import math
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.checking.forces import PossibleForce, impact_limit_n
from craftsim.models.site import Site
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

    def __init__(self, site: Site) -> None:
        """Prepare for a Site, and begin."""
        self.site = site
        model = site.model
        machines = site.machine_names
        self.names, machine = machines.names, machines.of_geom
        """Of all machines: what is fixed first, then those that move in the order of their bodies."""
        low, high = np.minimum.outer(machine, machine), np.maximum.outer(machine, machine)
        self._pair = np.where(low == high, -1, low * len(self.names) + high)
        """By two geoms: the pair of their machines, -1 inside one machine."""
        self._sign = np.where(machine[:, None] < machine, 1.0, -1.0)
        """By two geoms: whether a contact's normal, which points at the second geom, points at the second machine."""
        self._possible = PossibleForce(site, machines.roots)
        self._limit_n = impact_limit_n(site.machines)
        joints = [int(model.body_jntadr[body]) for body in machines.roots]
        self._pose_address = np.array([model.jnt_qposadr[j] for j in joints], np.intp)
        self._velocity_address = np.array([model.jnt_dofadr[j] for j in joints], np.intp)
        self.begin()

    def begin(self) -> None:
        """Forget everything, and note what touches now."""
        n = len(self.names)
        self._since = np.full(n * n, math.inf)
        self._peak = np.zeros(n * n)
        self._impossible: dict[int, tuple[float, float]] = {}
        self._fall = np.zeros(n - 2)
        self._upright = np.ones(n - 2)
        self._start_s = self.site.time_s
        self._note(self.site.awake_copy())
        self._at_start = np.isfinite(self._since)

    def look(self) -> None:
        """Note what touches and how hard; call it after each physics step, such as by being an executor's observer."""
        self._note(self.site.data)

    def sample(self, _: Site | None = None) -> None:
        """Note contacts and motion; call it after each control period, such as by being an executor's observer."""
        data = self.site.data
        self._note(data)
        np.minimum(self._fall, data.qvel[self._velocity_address + 2], out=self._fall)
        tilt_x, tilt_y = data.qpos[self._pose_address + 4], data.qpos[self._pose_address + 5]
        np.minimum(self._upright, 1 - 2 * (tilt_x * tilt_x + tilt_y * tilt_y), out=self._upright)

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
        return float(self._peak.max())

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
        return -float(self._fall.min(initial=0.0))

    @property
    def tilt_rad(self) -> float:
        """The furthest that any machine leaned."""
        return math.acos(max(-1.0, float(self._upright.min(initial=1.0))))

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
        """Note the machines of all contacts, and the net force of each two.

        Normal forces are summed as vectors. A boss that is wedged between pads presses on them with forces that cancel
        out: they squeeze the two machines, and move neither.
        """
        contact = data.contact
        address = contact.efc_address
        if not len(address):
            return
        pairs = self._pair[contact.geom1, contact.geom2]
        counts = np.flatnonzero((pairs >= 0) & (address >= 0))
        if not len(counts):
            return
        pairs = pairs[counts]
        # With elliptic friction cones the first row of a contact is its normal force, and the first three numbers of
        # its frame are the normal (MuJoCo, mj_contactForce).
        pushes = data.efc_force[address[counts]] * self._sign[contact.geom1[counts], contact.geom2[counts]]
        vectors = pushes * contact.frame[counts, :3].T
        net = [np.bincount(pairs, part, minlength=len(self._peak)) for part in vectors]
        forces = np.sqrt(net[0] ** 2 + net[1] ** 2 + net[2] ** 2)
        if (forces > self._peak).any():
            self._check(forces)
            np.maximum(self._peak, forces, out=self._peak)
        if np.isinf(self._since[pairs]).any():
            self._since[pairs] = np.minimum(self._since[pairs], self.site.time_s)

    def _check(self, forces: NDArray[np.float64]) -> None:
        """Note which of the forces that are new peaks, and as hard as a hazard, nothing could have produced."""
        for pair in np.flatnonzero((forces > self._peak) & (forces > self._limit_n)).tolist():
            machines = [machine - 2 for machine in divmod(pair, len(self.names)) if machine >= 2]
            possible = self._possible.newtons(machines)
            if forces[pair] > possible:
                self._impossible[pair] = float(forces[pair]), possible


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
