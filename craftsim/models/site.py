"""The Site: one world of cars, blocks and slopes, compiled and running in MuJoCo.

A Site is composed from a Grid. After a reset the only thing that changes it is ``mj_step`` under motor commands.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from craftsim.discrete.grid import Cell, Grid, Kind
from craftsim.errors import InputError
from craftsim.models.bearings import Bearings
from craftsim.models.compiled import compiled_parts
from craftsim.models.config import SimulationConfig
from craftsim.models.drivetrain import Drivetrains
from craftsim.models.extent import check_extent
from craftsim.models.grip import Grip
from craftsim.models.imperfection import FLAT, Drivetrain, Floor
from craftsim.models.overlaps import Overlap, overlaps
from craftsim.models.parameters import NOMINAL, Machines
from craftsim.models.parts import FreeBody
from craftsim.models.placement import placements
from craftsim.models.stepping import reaches

_SLEEP = int(mujoco.mjtEnableBit.mjENBL_SLEEP)
_BROKEN = [
    int(warning)
    for warning in (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
    )
]


def _without_log_file() -> None:
    """Let MuJoCo's warnings go to the terminal alone, not into a MUJOCO_LOG.TXT in the folder where one works.

    What they count is in ``data.warning`` all the same. A log file that somebody has chosen stays.
    """
    config = mujoco.MjLogConfig.get()
    if config.logfile == "MUJOCO_LOG.TXT":
        config.logto_file = False
        config.set()


_without_log_file()

_STAY_AWAKE = int(mujoco.mjtSleepPolicy.mjSLEEP_NEVER)
_MAY_SLEEP = int(mujoco.mjtSleepPolicy.mjSLEEP_ALLOWED)


@dataclass(frozen=True)
class SiteState:
    """A saved state. MuJoCo's state vector leaves out which trees sleep, so the whole of MjData is kept."""

    data: mujoco.MjData
    policies: NDArray[np.int32]
    capped_steps: int
    played: NDArray[np.float64] | None
    """By wheel, where its gear is in its backlash; None without."""


class Site:
    """A compiled world with typed handles of its parts.

    ``cars`` are in the order of car ids; ``blocks``, ``flags`` and ``slopes`` in the order of :func:`placements`.
    ``model`` and ``data`` are MuJoCo's own, to look at; commands go through :meth:`drive`, :meth:`move_board` and
    :meth:`turn_hinge`.

    Example:
        >>> import craftsim
        >>> site = craftsim.Site(craftsim.Grid.empty((3, 1, 1), n_cars=1))
        >>> site.drive(0, [5, 5, 5, 5])  # all wheels forward, rad/s
        >>> site.advance()  # one control period
        >>> round(site.time_s, 2)
        0.32
    """

    def __init__(
        self,
        grid: Grid,
        config: SimulationConfig | None = None,
        goals: Sequence[Cell] = (),
        reset: bool = True,
        machines: Machines = NOMINAL,
        floor: Floor = FLAT,
    ) -> None:
        """Compose, compile and reset the world of a grid.

        Args:
            grid: what stands where.
            config: how the physics is computed.
            goals: cells that get a marker without contact.
            reset: False leaves the first reset to the caller, who is about to change the physics.
            machines: figures of cars, blocks and slopes.
            floor: how uneven it can be; it is level until it is drawn (:class:`RandomizedSite`).

        Raises InputError for a world that is larger than physics takes, for figures of another number of cars than the
        grid has, for figures of which MuJoCo makes no world, and for a floor that is too fine.
        """
        check_extent(grid, goals)
        machines.check_number(grid.n_cars)
        self.config = config or SimulationConfig.of(machines.drive)
        self.machines = machines
        self.size = grid.size
        self.uneven = False
        """Whether wheels may come off the ground: the reduced drive's limits then follow each step."""
        self.lift_m = 0.0
        """How high above its place everything that moves is put by a reset, to come down onto an uneven floor."""
        self.overlaps: tuple[Overlap, ...] = ()
        """What stood in something else at the last reset, before it came to rest: such a start cannot be."""
        self.capped_steps = 0
        """Physics steps since the reset in which the solver gave up, at ``config.solver_iterations``. MuJoCo keeps this
        figure of the first 20 islands that move at a time."""
        self._placements = placements(grid, machines)
        self.walls = np.argwhere(grid.kind == Kind.WALL)
        """(n, 3): cells of the fixed obstacles."""
        kinds = tuple(placed.kind for placed in self._placements)
        uneven = None if floor.flat else (floor, grid.size)
        parts = compiled_parts(kinds, len(goals), self.config, machines, uneven)
        self.tiles, self._heights = parts.tiles, parts.qpos[:, 2]
        self.model, self.data = parts.placed(self.size, self._placements, goals)
        self._bearings = Bearings(self.model) if machines.drive == "rollers" else None
        self._grip: Grip | None = None
        if machines.drive == "reduced":
            for car in parts.cars:
                car.add_spin(self.model)
            mujoco.mj_setConst(self.model, self.data)
            self._grip = Grip(self.model, self.data, parts.cars)
        self._drivetrains: Drivetrains | None = None
        self._ctrl, self._steps_per_period = self.data.ctrl, self.config.steps_per_period
        self._policies = self.model.tree_sleep_policy.copy()
        self._commanded = b""
        """Which motors had a command in the last period, a byte each; empty where the policies may not fit it."""
        self._tree_of_motor = parts.tree_of_motor
        self.cars, self.slopes, self.blocks, self.flags = parts.cars, parts.slopes, parts.blocks, parts.flags
        self.machine_names = parts.names
        """The machines by their geoms."""
        if reset:
            self.reset()

    def reset(self) -> None:
        """Put everything back to its start, and let it come to rest for ``config.settle_s`` with all motors at zero."""
        self.show_figures()
        mujoco.mj_resetData(self.model, self.data)
        self._set_policies(self._policies)
        self.data.qpos[self._heights] += self.lift_m
        joints: dict[str, list[float]] = {"smartcar": [], "slope": []}
        for placed in self._placements:
            if placed.kind in joints:
                joints[placed.kind].append(placed.joint)
        drives = [car.board for car in self.cars] + [slope.hinge for slope in self.slopes]
        for drive, position in zip(drives, joints["smartcar"] + joints["slope"], strict=True):
            self.data.qpos[drive.qpos] = position
            self.data.act[drive.activation] = position
        mujoco.mj_forward(self.model, self.data)
        self.overlaps = tuple(overlaps(self.machine_names, self.data))
        self.capped_steps = 0
        if self._drivetrains is not None:
            self._drivetrains.start()
        self.follow()
        self._step(round(self.config.settle_s / self.config.timestep_s))

    @cached_property
    def _spare(self) -> mujoco.MjData:
        return mujoco.MjData(self.model)

    def show_figures(self) -> None:
        """Put figures into the model that its drive changes as it runs: motors, gears, the rollers' friction.

        A reset, :meth:`restore` or :meth:`follow` comes next.
        """
        if self._drivetrains is not None:
            self._drivetrains.show()
        if self._grip is not None:
            self._grip.begin()
        if self._bearings is not None:
            self._bearings.show()

    def follow(self) -> None:
        """Let the rollers' friction follow the contacts of the state, and motors and gears what they do; the limits of
        grip do so in :meth:`advance`.

        Who steps ``model`` and ``data`` on its own calls it after each ``mj_step``.
        """
        if self._drivetrains is not None:
            self._drivetrains.follow()
        if self._bearings is not None:
            self._bearings.follow(self.data)

    def take_figures(self) -> None:
        """Take over what somebody has changed in the model, such as motors' limits, before a reset.

        The rollers' friction counts if it was changed since it was shown (:meth:`show_figures`).
        """
        if self._grip is not None:
            self._grip = Grip(self.model, self.data, self.cars, self.uneven)
        if self._bearings is not None:
            self._bearings.take()
        if self._drivetrains is not None:
            self._drivetrains = self._drivetrains_of(self._drivetrains.lacks)

    def set_drivetrain(self, drivetrain: Drivetrain) -> None:
        """Let the wheels' motors and gears lack this from now on, on top of what the model says of them."""
        if self._drivetrains is None and drivetrain.ideal:
            return
        self.show_figures()
        self._drivetrains = None if drivetrain.ideal else self._drivetrains_of(drivetrain)
        self.follow()

    def _drivetrains_of(self, drivetrain: Drivetrain) -> Drivetrains:
        limits = self.model.actuator_forcerange if self._grip is None else self._grip.limits
        return Drivetrains(self.model, self.data, self.cars, drivetrain, limits)

    @property
    def diverged(self) -> bool:
        """Whether the simulation has broken down since the reset: MuJoCo then starts over from its first state."""
        return bool(self.data.warning.number[_BROKEN].any())

    @property
    def time_s(self) -> float:
        """Simulated time since the reset."""
        return float(self.data.time)

    def drive(self, car: int, wheel_speeds: ArrayLike) -> None:
        """Command the four wheels of a car, in rad/s, in the order of WHEELS; the servo clips to its own limits."""
        self.data.ctrl[self.cars[car].wheel_actuators] = wheel_speeds

    def move_board(self, car: int, speed: float) -> None:
        """Command the speed of a car's board in m/s, up positive."""
        self.data.ctrl[self.cars[car].board.actuator] = speed

    def turn_hinge(self, slope: int, speed: float) -> None:
        """Command the speed of a slope's hinge in rad/s, folding positive."""
        self.data.ctrl[self.slopes[slope].hinge.actuator] = speed

    def advance(self, observe: Callable[[], None] | None = None) -> None:
        """Run one control period of physics under the commands that stand; ``observe`` is called after every step."""
        if self._grip is not None:
            self._grip.limit()
        before, self._commanded = self._commanded, self._ctrl.astype(bool).tobytes()
        if self._commanded != before and self.config.sleep and self._rouse():
            # MuJoCo does not wake a tree because its motor is commanded; one step with sleep switched off does.
            self.model.opt.enableflags &= ~_SLEEP
            self._step(1, observe)
            self.model.opt.enableflags |= _SLEEP
            self._step(self._steps_per_period - 1, observe)
        else:
            self._step(self._steps_per_period, observe)

    def _step(self, count: int, observe: Callable[[], None] | None = None) -> None:
        """Run physics steps one by one: within ``mj_step`` of many, the figures of all but the last are lost."""
        model, data, cap = self.model, self.data, self.config.solver_iterations
        iterations = data.solver_niter
        for _ in range(count):
            mujoco.mj_step(model, data)
            self.follow()
            self.capped_steps += reaches(iterations, cap)
            if self._grip is not None and self.uneven:
                self._grip.limit()
            if observe is not None:
                observe()

    def save(self) -> SiteState:
        """Return a copy of the full state: restoring it and going on gives the same numbers, bit for bit."""
        played = None if self._drivetrains is None else self._drivetrains.played.copy()
        return SiteState(copy.copy(self.data), self.model.tree_sleep_policy.copy(), self.capped_steps, played)

    def restore(self, state: SiteState) -> None:
        """Go back to a state that this Site, or another one composed from an equal grid and config, has saved.

        Where motors and gears lack something, the other's lacked the same.
        """
        if (
            state.data.qpos.shape != self.data.qpos.shape
            or state.policies.shape != self.model.tree_sleep_policy.shape
        ):
            raise InputError(
                "this state was saved by a Site with other parts; restore it on one of an equal grid"
            )
        mujoco.mj_copyData(self.data, self.model, state.data)
        if self._drivetrains is not None:
            self._drivetrains.start(state.played)
        self.follow()
        self.capped_steps = state.capped_steps
        self._set_policies(state.policies)

    def awake_copy(self) -> mujoco.MjData:
        """Return a copy of the state in which contacts between sleeping machines, which MuJoCo leaves out, show.

        The next call overwrites it.
        """
        mujoco.mj_copyData(self._spare, self.model, self.data)
        flags = self.model.opt.enableflags
        self.model.opt.enableflags = flags & ~_SLEEP
        mujoco.mj_forward(self.model, self._spare)
        self.model.opt.enableflags = flags
        return self._spare

    def free_body_state(self, body: FreeBody) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return copies of a body's position (3,) in metres and unit quaternion (4,), w first, in the world frame."""
        pose = self.data.qpos[body.qpos : body.qpos + 7].copy()
        return pose[:3], pose[3:]

    def _set_policies(self, policies: NDArray[np.int32]) -> None:
        self.model.tree_sleep_policy[:] = policies
        self._commanded = b""

    def _rouse(self) -> bool:
        """Keep commanded trees awake, let the others sleep; return whether a commanded one is asleep."""
        self.model.tree_sleep_policy[self._tree_of_motor] = _MAY_SLEEP
        busy = self._tree_of_motor[self._ctrl != 0.0]
        self.model.tree_sleep_policy[busy] = _STAY_AWAKE
        return bool((self.data.tree_asleep[busy] >= 0).any())
