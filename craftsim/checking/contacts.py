"""Contacts, tilt, vertical speed, drift and ways of machines while an action runs, and their hazards.

Contacts are read after every physics step, motion after every control period, at 50 Hz.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Collection, Iterable, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.checking.thresholds import impact_limit_n
from craftsim.compiled.arrays import Floats, Records
from craftsim.compiled.jit import Record, compiled, layout, plain, records
from craftsim.discrete.geometry import CELL_PITCH_M, INCLINE_RAD
from craftsim.discrete.grid import Cell, Grid, Kind, cell_of
from craftsim.discrete.kernel.state import KIND
from craftsim.discrete.readback import TILT_TOLERANCE_RAD, Poses, Reading, cells_at
from craftsim.mjcf.building import GROUND
from craftsim.mjcf.parameters import ContactParameters
from craftsim.models.parts import WALL
from craftsim.models.world import PhysicsWorld
from craftsim.skills.state import GRAVITY
from craftsim.storage.writing import whole
from craftsim.workers.copying import Copyable

TIPPED_RAD: Final = INCLINE_RAD + TILT_TOLERANCE_RAD
"""Limit of the tilt of anything: the incline and the tolerance of standing on it; :class:`Drift` has narrower ones."""
FALL_M_S: Final = 0.5
"""Limit of the downward speed of anything: a drop of 13 mm. Descents and boards stay below 0.14 m/s."""

Hazard = tuple[tuple[str, ...], str]
"""An unsafe event: the names of the machines concerned, and a text with the limit."""
Numbers = NDArray[np.integer]

PAIR: Final = layout(f8="since_s peak_n borne_n x y z", i8="touching touched blow")
"""Two machines a < b, record a * n_machines + b: time of the first contact (inf without one), peak force, and what one
bears of the other at rest without being hit; the net force while it is summed, and whether they touch. The columns
``touched`` and ``blow`` are lists of pairs."""
MOTION: Final = layout(i8="qpos qvel", f8="down_m_s upright")
"""A machine: indices of its free joint in qpos and in qvel, its least vertical speed and cosine of tilt so far."""
_WORST: Final = layout(i8="n_machines", f8="limit_n hardest_n hit_n recent_n down_m_s upright")
"""Of all machines: their number, the limit of forces, the largest force since the log began, the largest beyond what is
borne, the largest since the last control period, and the least of both fields of MOTION."""

_REACH_M: Final = 1.5 * CELL_PITCH_M
"""Largest distance of any part of a machine from its middle: that of a flap's tip."""


class Contact(NamedTuple):
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


class ContactLog(Copyable):
    """Contacts between the machines of a PhysicsWorld, not inside one, and their motion, from :meth:`begin` on."""

    _bound = ("_awake", "_begun_s")

    def __init__(self, physics: PhysicsWorld) -> None:
        """Prepare for a world, and begin."""
        self.physics = physics
        machines = physics.machine_names
        model = physics.model
        self.names = machines.names
        """All machines: two that are fixed, then those that move in the order of their bodies."""
        self._machine = machines.of_geom
        self._roots = list(machines.roots)
        self._weigh()
        joints = model.body_jntadr[self._roots]
        self._pairs = records(len(self.names) ** 2, PAIR)
        is_car = np.array([name.startswith("car ") for name in self.names])
        self._is_of_car = (is_car[:, None] | is_car).ravel()
        self._motion = records(len(self._roots), MOTION)
        self._motion["qpos"] = model.jnt_qposadr[joints]
        self._motion["qvel"] = model.jnt_dofadr[joints]
        self._worst = records(1, _WORST)
        self._worst["n_machines"] = len(self.names)
        self.limit_n = impact_limit_n(physics.machines)
        """Limit of the force between two machines, beyond the weight of a stack that one bears."""
        self._worst["limit_n"] = self.limit_n
        self.period_n = 0.0
        """The largest force between any two machines in the last control period."""
        self._at_start = np.zeros(len(self._pairs), np.bool_)
        self.begin()

    def _bind(self) -> None:
        self._begun_s = math.nan

    def begin(self) -> None:
        """Forget everything, and note what touches now, and what stacks bear.

        What a car presses on is not borne: its weight is within the limit.
        """
        self._impossible: dict[int, tuple[float, float]] = {}
        self._pairs["borne_n"] = math.inf
        self._motion["down_m_s"] = 0.0
        self._motion["upright"] = 1.0
        for name in ("hardest_n", "hit_n", "recent_n", "down_m_s"):
            self._worst[name] = 0.0
        self._worst["upright"] = 1.0
        self._looked_s = math.nan
        self._bind()
        self._pairs["borne_n"][self._is_of_car] = 0.0
        self._forget(np.ones(len(self._pairs), np.bool_))
        stacked = ~self._is_of_car
        self._pairs["borne_n"][stacked] = self._pairs["peak_n"][stacked]

    def begin_with(self, machines: Collection[str]) -> None:
        """Begin anew for these machines: their action begins while others run."""
        is_concerned = np.isin(self.names, list(machines))
        self._forget((is_concerned[:, None] | is_concerned).ravel())

    def _forget(self, pairs: NDArray[np.bool_]) -> None:
        self._pairs["since_s"][pairs] = math.inf
        self._pairs["peak_n"][pairs] = 0.0
        if self._begun_s != self.physics.data.time:
            self._begun_s = self.physics.data.time
            self._awake = self.physics.awake_copy()
        self._note(self._awake)
        self._at_start[pairs] = np.isfinite(self._pairs["since_s"][pairs])

    def look(self) -> None:
        """Note contacts; call it after each physics step, as an executor's ``step_observer``."""
        self._looked_s = self.physics.data.time
        self._note(self.physics.data)

    def sample(self, _: PhysicsWorld | None = None) -> None:
        """Note contacts and motion; call it after each control period, as an executor's observer."""
        data = self.physics.data
        if self._looked_s != data.time:
            self.look()
        self._begun_s = math.nan
        self.period_n = float(self._worst["recent_n"][0])
        self._worst["recent_n"] = 0.0
        note_motion(data.qpos, data.qvel, self._motion, self._worst)

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """All contacts, in the order of their beginnings."""
        pairs = np.flatnonzero(np.isfinite(self._pairs["since_s"]))
        since_s = self._pairs["since_s"][pairs].tolist()
        peaks_n = self._pairs["peak_n"][pairs].tolist()
        at_start = self._at_start[pairs].tolist()
        contacts = []
        for number, pair in enumerate(pairs.tolist()):
            first, second = divmod(pair, len(self.names))
            names = self.names[first], self.names[second]
            contacts.append(Contact(*names, since_s[number], peaks_n[number], at_start[number]))
        return tuple(sorted(contacts, key=lambda contact: contact.since_s))

    def news(self, machines: Collection[str]) -> tuple[Contact, ...]:
        """Return the contacts of these machines that did not exist when the log began."""
        news = []
        for contact in self.contacts:
            if not contact.at_start and (contact.first in machines or contact.second in machines):
                news.append(contact)
        return tuple(news)

    @property
    def peak_n(self) -> float:
        """The largest force between any two machines, the ground included; 0 without contacts."""
        return float(self._worst["hardest_n"][0])

    @property
    def impossible(self) -> tuple[str, ...]:
        """A line for each force that is physically impossible."""
        lines = []
        for pair, (force, possible) in self._impossible.items():
            first, second = divmod(pair, len(self.names))
            lines.append(
                f"{self.names[first]} and {self.names[second]} press on each other with {force:.0f} N, more than "
                f"weights, motors and motion could ({possible:.0f} N)"
            )
        return tuple(lines)

    @property
    def fall_m_s(self) -> float:
        """The largest downward speed of any machine."""
        return -float(self._worst["down_m_s"][0])

    @property
    def tilt_rad(self) -> float:
        """The largest tilt of any machine."""
        return math.acos(max(-1.0, float(self._worst["upright"][0])))

    def is_unsafe(self) -> bool:
        """Return whether anything was unsafe since the log began."""
        hit_n = float(self._worst["hit_n"][0])
        return self.tilt_rad > TIPPED_RAD or self.fall_m_s > FALL_M_S or hit_n > self.limit_n

    def hazards(self) -> tuple[Hazard, ...]:
        """Return all that was unsafe since the log began."""
        if not self.is_unsafe():
            return ()
        hazards: list[Hazard] = []
        for name, upright in zip(self.names[2:], self._motion["upright"].tolist(), strict=True):
            tilt = math.acos(max(-1.0, upright))
            if tilt > TIPPED_RAD:
                hazards.append(
                    ((name,), f"{name} tipped ({tilt:.2f} rad, allowed {TIPPED_RAD:.2f})")
                )
        for name, up_m_s in zip(self.names[2:], self._motion["down_m_s"].tolist(), strict=True):
            if -up_m_s > FALL_M_S:
                hazards.append(
                    ((name,), f"{name} fell ({-up_m_s:.1f} m/s, allowed {FALL_M_S:.1f})")
                )
        allowed_n = self.limit_n + self._pairs["borne_n"]
        hits = np.flatnonzero(self._pairs["peak_n"] > allowed_n)
        by_time = np.argsort(self._pairs["since_s"][hits], kind="stable")
        for pair in hits[by_time].tolist():
            first, second = divmod(pair, len(self.names))
            names = self.names[first], self.names[second]
            forces = f"{self._pairs['peak_n'][pair]:.0f} N, allowed {allowed_n[pair]:.0f}"
            hazards.append((names, f"{names[0]} and {names[1]} hit each other ({forces})"))
        return tuple(hazards)

    def write(self, path: Path) -> None:
        """Write the contacts as CSV with a line of headings; raise InputError where the disk does not take it."""
        with whole(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(Contact._fields)
            writer.writerows(self.contacts)

    def _note(self, data: mujoco.MjData) -> None:
        """Note contacts; check whether new peaks above the limit are physically possible."""
        if not data.ncon:
            return
        contact = data.contact
        n_blows = note_contacts(
            (contact.geom1, contact.geom2, contact.frame, contact.efc_address),
            data.efc_force,
            data.time,
            self._machine,
            self._pairs,
            self._worst,
        )
        for pair in self._pairs["blow"][:n_blows].tolist():
            machines = [machine - 2 for machine in divmod(pair, len(self.names)) if machine >= 2]
            possible = self._possible_n(machines)
            force = float(self._pairs["peak_n"][pair])
            if force > possible:
                self._impossible[pair] = force, possible

    def _weigh(self) -> None:
        physics = self.physics
        model = self.physics.model
        self._mass = model.body_subtreemass[self._roots]
        self._dof = model.body_dofadr[self._roots].astype(np.intp)
        self._tree = model.dof_treeid[self._dof]
        at_tree = {int(tree): i for i, tree in enumerate(self._tree)}
        self._rest = GRAVITY * self._mass
        limit = model.actuator_forcerange[:, 1]
        for car in physics.cars:
            wheels = limit[car.wheel_actuators].sum() / car.parameters.wheel_radius_m
            self._rest[at_tree[car.base.tree]] += wheels + limit[car.board.actuator]
        lever_m = physics.machines.slope.gear_radius_m
        for slope in physics.slopes:
            self._rest[at_tree[slope.base.tree]] += limit[slope.hinge.actuator] / lever_m

    def _possible_n(self, machines: Sequence[int]) -> float:
        """Return the largest possible force between machines in the last step, given weights, motors and motion.

        Touching machines pass forces on, so all of one island count. Weights, wheels, boards and hinges load a contact
        up to twice as much when applied at once. What moves loses its momentum over one physics step at least: m v / h,
        times :func:`stopping_ratio`. Larger forces come from a solver that has not converged.
        """
        data = self.physics.data
        step = self.physics.config.timestep_s
        islands = data.tree_island[self._tree]
        touching = np.isin(islands, islands[list(machines)])
        dofs = self._dof[touching, None] + np.arange(6)
        speed = data.qvel[dofs] - step * data.qacc[dofs]  # before the step
        motion = np.linalg.norm(speed[:, :3], axis=1) + _REACH_M * np.linalg.norm(
            speed[:, 3:], axis=1
        )
        static_n = self._rest[touching].sum()
        momentum = (self._mass[touching] * motion).sum()
        return float(
            2 * static_n + stopping_ratio(self.physics.machines.contact, step) / step * momentum
        )


def stopping_ratio(contact: ContactParameters, timestep_s: float) -> float:
    """Return the speed that a contact takes from a thing in one step, as a share of its approach speed.

    MuJoCo's contact is a spring and damper per unit of mass, b = 2 / (d T) and k = 1 / (d T z)^2, of time constant T,
    damping ratio z and largest impedance d (its documentation, "Solver parameters"). At a depth of one step's way it
    takes b v h + k v h^2 in a step of length h: 1.27 v with the nominal figures.
    """
    step = timestep_s / (contact.impedance_max * contact.time_constant_s)
    return 2 * step + (step / contact.damping_ratio) ** 2


@compiled
def note_contacts(
    contact: tuple[Any, ...],
    efc_force: Floats,
    time_s: float,
    machine: Numbers,
    pairs: Record,
    worst: Record,
) -> int:
    """Note the net force of each pair of touching machines; return the number of new peaks above the limit.

    Normal forces are summed as vectors: those of a boss that is wedged between pads cancel out. ``frame`` (n, 9) starts
    with the normal, which points at ``geom2``; at ``efc_address`` is the normal force (MuJoCo, mj_contactForce).
    ``machine`` (n_geom,) is that of each geom. ``pairs.blow`` lists the pairs of new peaks.
    """
    geom1, geom2, frame, efc_address = contact
    n_touched = 0
    n_machines = worst[0].n_machines
    for i in range(len(geom1)):
        row = efc_address[i]
        first = machine[geom1[i]]
        second = machine[geom2[i]]
        if row < 0 or first == second:
            continue
        pair = min(first, second) * n_machines + max(first, second)
        if not pairs[pair].touching:
            pairs[pair].touching = 1
            pairs[n_touched].touched = pair
            n_touched += 1
        push = efc_force[row] if first < second else -efc_force[row]
        pairs[pair].x += push * frame[i, 0]
        pairs[pair].y += push * frame[i, 1]
        pairs[pair].z += push * frame[i, 2]
    n_blows = 0
    hardest = 0.0
    for i in range(n_touched):
        pair = pairs[i].touched
        x = pairs[pair].x
        y = pairs[pair].y
        z = pairs[pair].z
        force = math.sqrt(x * x + y * y + z * z)
        pairs[pair].x = 0.0
        pairs[pair].y = 0.0
        pairs[pair].z = 0.0
        pairs[pair].touching = 0
        pairs[pair].since_s = min(pairs[pair].since_s, time_s)
        hardest = max(hardest, force)
        hit = force - pairs[pair].borne_n
        worst[0].hit_n = max(worst[0].hit_n, hit)
        if force > pairs[pair].peak_n:
            pairs[pair].peak_n = force
            if hit > worst[0].limit_n:
                pairs[n_blows].blow = pair
                n_blows += 1
    worst[0].hardest_n = max(worst[0].hardest_n, hardest)
    worst[0].recent_n = max(worst[0].recent_n, hardest)
    return n_blows


@compiled
def note_motion(qpos: Floats, qvel: Floats, motion: Record, worst: Record) -> None:
    """Note the vertical speed and the tilt of each machine."""
    for i in range(len(motion)):
        at = motion[i].qpos
        tilt_x = qpos[at + 4]
        tilt_y = qpos[at + 5]
        motion[i].down_m_s = min(motion[i].down_m_s, qvel[motion[i].qvel + 2])
        motion[i].upright = min(motion[i].upright, 1 - 2 * (tilt_x * tilt_x + tilt_y * tilt_y))
        worst[0].down_m_s = min(worst[0].down_m_s, motion[i].down_m_s)
        worst[0].upright = min(worst[0].upright, motion[i].upright)


WAY: Final = layout(f8="start_x start_y end_x end_y steepest_rad away_m lean_rad")
"""The way of a car's action: the middles of its first and last cell, and the lean of the steepest ground between them.
Its largest distance from the line between the two so far, and its largest lean beyond that of the ground."""


class Drift(Copyable):
    """The distances of cars and things from the places where they should stand, and of acting cars from their ways.

    A place is the pose, with the board of a car or the hinge of a slope, at the start, or at the last :meth:`leave`:
    many small movements add up.
    """

    _bound = ("_note_away",)

    def __init__(self, physics: PhysicsWorld) -> None:
        self._physics = physics
        self._places = physics.pose_places
        self._speeds = physics.speed_places
        n_machines = len(self._places)
        self._joints = np.full(n_machines, -1)
        """(n,): index of each car's board and each slope's hinge in MjData.qpos; -1 for what has none."""
        for row, car in enumerate(physics.cars):
            self._joints[row] = car.board.qpos
        first_slope = n_machines - len(physics.slopes)
        for row, slope in enumerate(physics.slopes, first_slope):
            self._joints[row] = slope.hinge.qpos
        self._place_poses = np.zeros((n_machines, 8))
        """(n, 8): the places, with the height of the board or the angle of the hinge."""
        self.furthest = np.zeros((n_machines, 2))
        """(n, 2): the largest distance in metres, and angle in radians, of each machine from its place."""
        self.ways = records(len(physics.cars), WAY)
        """(n,) WAY of each car since its action began."""
        self._bind()
        self.leave(range(n_machines))

    def _bind(self) -> None:
        data = self._physics.data
        self._note_away = partial(
            _note_away,
            data.qpos,
            self._places,
            self._joints,
            self._place_poses,
            self.furthest,
            self.ways,
        )

    def speed_m_s(self) -> float:
        """Return how fast the fastest machine moves now."""
        velocity = self._physics.data.qvel[self._speeds]
        return float(np.sqrt((velocity * velocity).sum(axis=1).max(initial=0.0)))

    def leave(self, machines: Iterable[int]) -> None:
        """Take the present poses of these as their places."""
        rows = list(machines)
        self._place_poses[rows, :7] = self._physics.data.qpos[self._places[rows]]
        self._place_poses[rows, 7] = self._physics.data.qpos[self._joints[rows]]
        self.furthest[rows] = 0.0

    def take_over(self, drift: Drift) -> None:
        """Take over the places from another object for the same PhysicsWorld."""
        self._place_poses[:] = drift._place_poses
        self.furthest[:] = drift.furthest

    def settle(self, machines: slice | list[int]) -> None:
        """Forget earlier distances of these: only the present ones count."""
        self.furthest[machines] = 0.0
        self.look()

    def leave_hinges(self, machines: list[int]) -> None:
        """Take the present hinges of these as their places, and forget earlier distances of these."""
        self._place_poses[machines, 7] = self._physics.data.qpos[self._joints[machines]]
        self.settle(machines)

    def follow(self, car: int, start: Cell, end: Cell, steepest_rad: float) -> None:
        """Watch a car on its way from cell to cell, over ground of this lean at most."""
        start_x, start_y = _middle_of(start)
        end_x, end_y = _middle_of(end)
        self.ways[car] = start_x, start_y, end_x, end_y, steepest_rad, 0.0, 0.0

    def look(self, _: PhysicsWorld | None = None) -> None:
        """Note the distances and leans of everything; call it after each control period."""
        self._note_away()


def _middle_of(cell: Cell) -> tuple[float, float]:
    """Return x and y of a cell's middle in metres."""
    return (cell[0] + 0.5) * CELL_PITCH_M, (cell[1] + 0.5) * CELL_PITCH_M


@compiled
def _note_away(
    qpos: Floats,
    places: NDArray[np.integer],
    joints: NDArray[np.integer],
    place_poses: Floats,
    furthest: Floats,
    ways: Records,
) -> None:
    """Note the distance of each machine, its pose in qpos at ``places`` (n, 7), from its place in ``place_poses``."""
    for i in range(len(places)):
        start = places[i, 0]
        metres, radians = apart(qpos[start : start + 7], place_poses[i])
        if joints[i] >= 0:
            change = abs(qpos[joints[i]] - place_poses[i, 7])
            # The cars come first; a board slides, and a hinge turns.
            if i < len(ways):
                metres = max(metres, change)
            else:
                radians = max(radians, change)
        furthest[i, 0] = max(furthest[i, 0], metres)
        furthest[i, 1] = max(furthest[i, 1], radians)
    for i in range(len(ways)):
        way = ways[i]
        at = places[i, 0]
        along_x = way.end_x - way.start_x
        along_y = way.end_y - way.start_y
        from_x = qpos[at] - way.start_x
        from_y = qpos[at + 1] - way.start_y
        square = along_x * along_x + along_y * along_y
        if square > 0.0:
            share = min(1.0, max(0.0, (from_x * along_x + from_y * along_y) / square))
            from_x -= share * along_x
            from_y -= share * along_y
        way.away_m = max(way.away_m, math.hypot(from_x, from_y))
        upright = 1 - 2 * (qpos[at + 4] * qpos[at + 4] + qpos[at + 5] * qpos[at + 5])
        lean = math.acos(min(1.0, max(-1.0, upright)))
        way.lean_rad = max(way.lean_rad, lean - way.steepest_rad)


@compiled
def apart(pose: Floats, other_pose: Floats) -> tuple[float, float]:
    """Return the distance in metres between two poses (7,), and the angle in radians, exact for small ones."""
    x = pose[0] - other_pose[0]
    y = pose[1] - other_pose[1]
    z = pose[2] - other_pose[2]
    metres = math.sqrt(x * x + y * y + z * z)
    a = pose[3]
    b = pose[4]
    c = pose[5]
    d = pose[6]
    e = other_pose[3]
    f = other_pose[4]
    g = other_pose[5]
    h = other_pose[6]
    w = a * e + b * f + c * g + d * h
    x = a * f - b * e - c * h + d * g
    y = a * g - c * e - d * f + b * h
    z = a * h - d * e - b * g + c * f
    return metres, 2.0 * math.atan2(math.sqrt(x * x + y * y + z * z), abs(w))


_apart: Final = plain(apart)


def pose_rows(poses: Poses) -> Floats:
    """Return the poses of cars and objects, (n, 7)."""
    cars = np.hstack([poses.car_positions, poses.car_quaternions])
    objects = np.hstack([poses.positions, poses.quaternions])
    return np.vstack([cars.reshape(-1, 7), objects.reshape(-1, 7)])


def distances(before: Poses, after: Poses) -> Floats:
    """Return how far everything was moved and turned, (n, 2); a hinge counts as a turn."""
    start_rows = pose_rows(before)
    end_rows = pose_rows(after)
    pairs = zip(end_rows.tolist(), start_rows.tolist(), strict=True)
    moved = np.array([_apart(end, start) for end, start in pairs]).reshape(-1, 2)
    n_cars = len(before.car_positions)
    turned = np.abs(after.hinges - before.hinges)
    moved[n_cars:, 1] = np.fmax(moved[n_cars:, 1], turned)  # nan without a hinge
    return moved


def unexpected_contacts(
    contacts: Collection[Contact],
    names: Sequence[str],
    before: Reading,
    after: Reading,
    predicted: Grid,
    cars: Collection[int],
) -> tuple[Contact, ...]:
    """Return the contacts that the prediction does not explain, largest force first.

    Cars that act, and the objects (``names``) that they handle, may touch each other and what bears them: what stands
    below ``before`` or, as another car may have put it there meanwhile, ``after``.
    """
    if not contacts:
        return ()
    grid = before.grid
    filled_by = _filled_by((before, after), names)
    explained: set[frozenset[str]] = set()
    for car in cars:
        car_name = f"car {car}"
        stops = [cell_of(grid, car), cell_of(predicted, car)]
        cells_of = {car_name: stops}
        for index in handled(before, predicted, car):
            cells = cells_at(grid, stops[0])
            for cell in stops:
                cells += cells_at(predicted, cell)
            cells_of[names[index]] = cells
        explained |= {frozenset(pair) for pair in product(cells_of, repeat=2)}
        for name, cells in cells_of.items():
            for x, y, z in cells:
                for bearer in filled_by.get((x, y, z - 1), ()):
                    explained.add(frozenset((name, bearer)))
        for cell in stops:
            if grid.kind_at(cell) in (Kind.FOOT, Kind.BODY):
                for ramp in filled_by[cell]:
                    explained.add(frozenset((car_name, ramp)))
    unexpected = [c for c in contacts if frozenset((c.first, c.second)) not in explained]
    return tuple(sorted(unexpected, key=lambda contact: -contact.peak_n))


def _filled_by(readings: Sequence[Reading], names: Sequence[str]) -> dict[Cell, set[str]]:
    """Return the names of what fills each cell in any reading, the ground included; a carried object fills none."""
    kinds = readings[0].grid.kind
    filled_by = {(int(x), int(y), 0): {GROUND} for x, y in np.ndindex(*kinds.shape[:2])}
    for x, y, z in np.argwhere(kinds == Kind.WALL):
        filled_by[int(x), int(y), int(z)] = {WALL}
    for reading in readings:
        for index, cell, _ in reading.standing:
            for filled_cell in cells_at(reading.grid, cell):
                filled_by.setdefault(filled_cell, set()).add(names[index])
    return filled_by


def handled(before: Reading, predicted: Grid, car: int) -> list[int]:
    """Return the indices of the objects that an action handles: the car's load, what it takes, folds or shoves."""
    start_cell = cell_of(before.grid, car)
    end_cell = cell_of(predicted, car)
    loads = [index for index, fit in enumerate(before.objects) if fit.carrier == car]
    shoved = []
    if end_cell != start_cell:
        shoved = _changing(before, predicted, end_cell)
    return [*loads, *_changing(before, predicted, start_cell), *shoved]


def under(before: Reading, predicted: Grid, car: int) -> list[int]:
    """Return the indices of the objects below a car on its way, down to the ground; a foot in its own cell, too."""
    stands = sorted((cell_of(before.grid, car), cell_of(predicted, car)))
    tops = {cell[:2]: cell[2] for cell in stands}
    indices = []
    for index, cell, foot in before.standing:
        if cell[2] < tops.get(cell[:2], 0) or (foot is not None and foot in stands):
            indices.append(index)
    return indices


def _changing(before: Reading, predicted: Grid, cell: Cell) -> list[int]:
    """Return the indices of the objects in a cell that should hold something else afterwards."""
    x, y, z = cell
    if (
        z >= predicted.cells.shape[2]
        or before.grid.cells[x, y, z, KIND] == predicted.cells[x, y, z, KIND]
    ):
        return []
    return [index for index, place, _ in before.standing if place == cell]
