"""The PhysicsWorld: one world of cars, blocks and slopes, compiled and running in MuJoCo.

It is composed from a Grid. After a reset the only change is ``mj_step`` under motor commands.
"""

from __future__ import annotations

import copy
import math
import threading
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from itertools import chain
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from craftsim.discrete.grid import Cell, Grid, Kind
from craftsim.discrete.readback import Poses
from craftsim.errors import CraftsimError, InputError
from craftsim.mjcf.machines import NOMINAL, Machines
from craftsim.models.baseline import Baseline
from craftsim.models.composition import check_extent, compile_spec, placements, world_spec
from craftsim.models.config import SimulationConfig
from craftsim.models.effects import IDEAL, Drivetrain, StepEffect, effects_of
from craftsim.models.floor import FLAT, Floor
from craftsim.models.parts import Joint, MachineNames, overlaps, parts_of
from craftsim.models.stepping import Stepping
from craftsim.models.wheel_contacts import install
from craftsim.workers.copying import Copyable

_SLEEP = int(mujoco.mjtEnableBit.mjENBL_SLEEP)
_BROKEN = [
    int(getattr(mujoco.mjtWarning, f"mjWARN_BAD{name}")) for name in ("QPOS", "QVEL", "QACC")
]
# MuJoCo's warnings go to the terminal alone; ``data.warning`` counts them. A log file that somebody has chosen stays.
_log = mujoco.MjLogConfig.get()
if _log.logfile == "MUJOCO_LOG.TXT":
    _log.logto_file = False
    _log.set()
_LOWERED_SHARE: Final = 0.01
"""Share of the weight under which everything comes down onto an uneven floor at a reset..."""
_LOWERED_S: Final = 0.8
"""...and for how long: a fall by 2 mm takes 0.2 s. Free falls of half a millimetre throw slopes aside by up to 3 mm."""
_STAY_AWAKE = int(mujoco.mjtSleepPolicy.mjSLEEP_NEVER)
_MAY_SLEEP = int(mujoco.mjtSleepPolicy.mjSLEEP_ALLOWED)


@dataclass(frozen=True)
class PhysicsState:
    """A saved state. MuJoCo's state vector leaves out which trees sleep, so the whole of MjData is kept."""

    data: mujoco.MjData
    capped_steps: int
    effects: tuple[NDArray[np.float64], ...]
    """State of each effect."""

    def __copy__(self) -> PhysicsState:
        return self

    def __deepcopy__(self, _: dict[int, Any]) -> PhysicsState:
        """Return the same: a state that is saved does not change."""
        return self

    def __getstate__(self) -> dict[str, Any]:
        counts = {name: getattr(self.data, name) for name in _COUNTS}
        statistics = {name: getattr(self.data, name).copy() for name in _STATISTICS}
        return vars(self) | {"counts": counts, "statistics": statistics}

    def __setstate__(self, state: dict[str, Any]) -> None:
        data = state["data"]
        for name, count in state.pop("counts").items():
            setattr(data, name, count)
        for name, numbers in state.pop("statistics").items():
            getattr(data, name)[:] = numbers
        vars(self).update(state)


# MuJoCo's own pickles of MjData leave these out. Without the first, all that sleeps would be awake.
_COUNTS: Final = ("ntree_awake", "nbody_awake", "nparent_awake", "nv_awake", "nl")
_STATISTICS: Final = ("solver_niter", "solver_nnz")


KEPT: Final = 4
"""Starts at rest that a process keeps, those used last: 1 MB each, and address space for more."""


@lru_cache(maxsize=KEPT)
def _kept(start: Hashable) -> list[tuple[PhysicsState, tuple[str, ...]]]:
    """Return where a start at rest, with its overlaps, is kept: an empty list, the first time."""
    return []


class PhysicsWorld(Copyable):
    """A compiled world with typed handles of its parts.

    ``cars`` are in the order of car ids; ``blocks``, ``flags`` and ``slopes`` in the order of :func:`placements`.
    ``model`` and ``data`` are MuJoCo's own, to look at.

    A copy (``copy.deepcopy``, or a pickle in any process) is a world of its own that goes on as this one does, bit for
    bit.

    Example:
        >>> import craftsim
        >>> physics = craftsim.PhysicsWorld(craftsim.Grid.empty((3, 1, 1), n_cars=1))
        >>> physics.drive(0, [5, 5, 5, 5])  # all wheels forward, rad/s
        >>> physics.advance()  # one control period
        >>> round(physics.time_s, 2)
        0.32
    """

    _bound = (
        "data",
        "effects",
        "judge",
        "_warnings",
        "_ctrl",
        "_stepping",
        "_spare",
        "_rested",
        "_turn",
    )

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
            floor: how uneven it can be; it is level until it is drawn (craftsim/models/randomization.py).

        Raises InputError for a world that is larger than physics takes, for figures of another number of cars than the
        grid has, for figures of which MuJoCo makes no world, and for a floor that is too fine.
        """
        check_extent(grid, goals)
        machines.check_number(grid.n_cars)
        self.config = config or SimulationConfig()
        self.machines = machines
        self.size = grid.size
        self.uneven = False
        """Whether wheels may come off the ground, as :meth:`set_baseline` says."""
        self.lift_m = 0.0
        """Height above its place at which a reset puts everything that moves, to come down onto an uneven floor."""
        self.overlaps: tuple[str, ...] = ()
        """What stood in something else at the last reset, before it came to rest: such a start cannot be."""
        self.capped_steps = 0
        """Physics steps since the reset in which the solver gave up, at ``config.solver_iterations``. MuJoCo keeps this
        figure of the first 20 islands that move at a time."""
        self.walls = np.argwhere(grid.kind == Kind.WALL)
        """(n, 3): cells of the fixed obstacles."""
        self.floor = floor
        self._spec = partial(world_spec, grid.copy(), self.config, machines, tuple(goals), floor)
        self.model = compile_spec(self._spec(visual=False))
        self.data = mujoco.MjData(self.model)
        self.cars, self.slopes, tables = parts_of(self.model, machines)
        placed = placements(grid, machines)
        starts = [placement.joint for placement in placed if placement.kind == "smartcar"]
        starts += [placement.joint for placement in placed if placement.kind == "slope"]
        boards = [car.board for car in self.cars]
        hinges = [slope.hinge for slope in self.slopes]
        self._start_joints = list(zip(boards + hinges, starts, strict=True))
        self._commanded = b""
        """Motors that had a command in the last period, a byte each; empty where that is not known."""
        self.blocks = tables[Kind.BLOCK]
        self.tables = tuple(chain(*tables.values()))
        """Blocks, flags, and what else has a block's shape and is carried, by kind."""
        self.table_kinds = tuple(chain(*((kind,) * len(bodies) for kind, bodies in tables.items())))
        """The kind of each of them."""
        bases = [car.base for car in self.cars], self.tables, [slope.base for slope in self.slopes]
        self.pose_places = np.array([body.qpos for body in chain(*bases)], np.intp)[
            :, None
        ] + np.arange(7)
        """(n, 7): where in qpos the pose lies of everything that moves: cars by id; then tables and slopes."""
        self.speed_places = np.array([body.dof for body in chain(*bases)], np.intp)[
            :, None
        ] + np.arange(3)
        """(n, 3): where in qvel their speeds lie."""
        self.machine_names = MachineNames.of(self.model)
        """The machines by their geoms."""
        self.compiled = Baseline.of(self.model)
        """The parameters of the model as it was compiled; not to be changed."""
        self.baseline = self.compiled
        """Those that the world has: the model is the baseline with what the effects make of it. A changed copy takes
        its place by :meth:`set_baseline`."""
        self.drivetrain = IDEAL
        """Shortcomings of wheel motors and gears, on top of what the baseline says of them."""
        self.effects: Sequence[StepEffect] = ()
        """Effects that change the model's parameters as the world runs, in this order."""
        self._bind()
        self._begin_effects()
        joints = self.model.actuator_trnid[:, 0]
        self._tree_of_motor = self.model.dof_treeid[self.model.jnt_dofadr[joints]].astype(np.intp)
        if reset:
            self.reset()

    def _bind(self) -> None:
        self.judge: Any = None
        """The judge between calls of :func:`craftsim.perform`; None in a copy, and after a reset or restore."""
        self._turn = threading.Lock()
        """Held while a control period runs."""
        self._warnings = self.data.warning.number
        self._ctrl = self.data.ctrl
        install()
        self._stepping = Stepping(self.model, self.data, self.config.solver_iterations)
        for array in vars(self.compiled).values():
            array.flags.writeable = False
        grid, config, machines, goals, floor = self._spec.args
        standing = (array.tobytes() for array in (grid.kind, grid.yaw, grid.cars))
        self._rested = _kept((grid.size, *standing, goals, config, machines, floor))

    def __getstate__(self) -> dict[str, Any]:
        return super().__getstate__() | {"saved": self.save()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        saved = state.pop("saved")
        # The model is a copy of the original's, with all that effects had written into it.
        model = state["model"]
        policy = model.tree_sleep_policy.copy()
        self.data = mujoco.MjData(model)
        super().__setstate__(state)
        self.effects = effects_of(self, self.drivetrain)
        self.restore(saved)
        # Restoring a state rouses what is commanded; the original may not have done so yet.
        model.tree_sleep_policy[:] = policy
        self._commanded = state["_commanded"]

    def reset(self) -> None:
        """Put everything back to its start, and let it come to rest for ``config.settle_s`` with all motors at zero."""
        self.judge = None
        self.baseline.write(self.model)
        mujoco.mj_resetData(self.model, self.data)
        self._commanded = b""
        self._rouse()
        self.data.qpos[self.pose_places[:, 2]] += self.lift_m
        for joint, position in self._start_joints:
            self.data.qpos[joint.qpos] = self.data.act[joint.activation] = position
        mujoco.mj_forward(self.model, self.data)
        self.overlaps = overlaps(self.machine_names, self.data)
        self.capped_steps = 0
        for effect in self.effects:
            effect.start(self)
        if self.lift_m:
            self._come_down()
        self.run(round(self.config.settle_s / self.config.timestep_s))

    def _come_down(self) -> None:
        """Let everything down onto an uneven floor as gently as by hand, under little of its weight."""
        options = self.model.opt
        gravity = options.gravity.copy()
        flags = options.enableflags
        options.gravity[:] = _LOWERED_SHARE * gravity
        options.enableflags = flags & ~_SLEEP
        self.run(round(_LOWERED_S / self.config.timestep_s))
        options.gravity[:] = gravity
        options.enableflags = flags
        self.data.time = 0.0

    def reset_compiled(self) -> None:
        """Go back to the parameters as they were compiled, ideal motors and gears, and the start at rest.

        All physics worlds of one start share what has come to rest.
        """
        self.drivetrain = IDEAL
        self.set_baseline(self.compiled)
        if self._rested:
            state, self.overlaps = self._rested[0]
            self.restore(state)
        else:
            self.reset()
            self._rested.append((self.save(), self.overlaps))

    @cached_property
    def _spare(self) -> mujoco.MjData:
        return mujoco.MjData(self.model)

    def set_baseline(self, baseline: Baseline, uneven: bool = False, lift_m: float = 0.0) -> None:
        """Have other parameters from now on, and what MuJoCo derives from them; the state stays as it is.

        Args:
            baseline: the parameters, not to be changed afterwards.
            uneven: whether wheels may come off the ground, so that cars stray a little.
            lift_m: how high above its place a reset puts everything that moves.
        """
        self.baseline = baseline
        self.uneven = uneven
        self.lift_m = lift_m
        model = self.model
        baseline.write(model)
        # MuJoCo keeps a pair's friction as it was compiled; as at any contact, the rougher of the two decides.
        sliding = model.geom_friction[:, 0]
        rougher = np.maximum(sliding[model.pair_geom1], sliding[model.pair_geom2])
        model.pair_friction[:, :2] = rougher[:, None]
        mujoco.mj_setConst(model, self._spare)
        self._stepping.distant.measure()
        self._begin_effects()

    def set_drivetrain(self, drivetrain: Drivetrain) -> None:
        """Let the wheels' motors and gears lack this from now on, on top of what the baseline says of them."""
        if drivetrain == self.drivetrain:
            return
        self.drivetrain = drivetrain
        self.baseline.write(self.model)
        self._begin_effects()

    def _begin_effects(self) -> None:
        self.effects = effects_of(self, self.drivetrain)
        for effect in self.effects:
            effect.start(self)

    def seen_model(self) -> mujoco.MjModel:
        """Return the model of this world as it was compiled, with what is only seen; it has the same positions."""
        return compile_spec(self._spec(visual=True))

    @property
    def diverged(self) -> bool:
        """Whether the simulation has broken down since the reset: MuJoCo then starts over from its first state."""
        return any(self._warnings[_BROKEN].tolist())

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
        """Run one control period of physics under the commands that stand; ``observe`` is called after every step.

        Raises CraftsimError while another one runs, in another thread or in what ``observe`` calls.
        """
        if not self._turn.acquire(blocking=False):
            raise CraftsimError(
                "a PhysicsWorld is advanced by one thread at a time, and not by what observes its steps; "
                "give each thread a copy of its own (copy.deepcopy)"
            )
        try:
            self._advance(observe)
        finally:
            self._turn.release()

    def _advance(self, observe: Callable[[], None] | None) -> None:
        before = self._commanded
        self._commanded = self._ctrl.astype(bool).tobytes()
        if self._commanded != before and self.config.sleep:
            self._rouse()
        self.run(self.config.steps_per_period, observe)

    def run(self, n_steps: int, observe: Callable[[], None] | None = None) -> None:
        """Run physics steps, which nothing else does; ``observe`` is called after each. Raises FatalError of MuJoCo."""
        if self.effects or observe is not None:
            at_once = 1
        else:
            at_once = max(n_steps, 1)
        for _ in range(n_steps // at_once):
            self.capped_steps += self._stepping.run(at_once)
            for effect in self.effects:
                effect.after_step(self)
            if observe is not None:
                observe()

    def save(self) -> PhysicsState:
        """Return a copy of the full state: restoring it and going on gives the same numbers, bit for bit."""
        effects = tuple(effect.state.copy() for effect in self.effects)
        return PhysicsState(copy.copy(self.data), self.capped_steps, effects)

    def restore(self, state: PhysicsState) -> None:
        """Go back to a state that this PhysicsWorld, or another one composed from an equal grid and config, has saved.

        The parameters stay as they are. Raises InputError for a state of another world, or of another kind of
        drivetrain.
        """
        if not self._fits(state):
            raise InputError(
                "this state was saved by a PhysicsWorld with other parts; restore it on one of an equal grid"
            )
        self.judge = None
        mujoco.mj_copyData(self.data, self.model, state.data)
        self._stepping.distant.forget()
        for effect, saved in zip(self.effects, state.effects, strict=True):
            effect.state = saved
            effect.after_step(self)
        self.capped_steps = state.capped_steps
        self._commanded = b""
        self._rouse()

    def _fits(self, state: PhysicsState) -> bool:
        """Return whether a saved state has as many positions, motors and states of effects as this world."""
        same_data = (
            state.data.qpos.shape == self.data.qpos.shape
            and state.data.ctrl.shape == self.data.ctrl.shape
        )
        sizes = [len(effect.state) for effect in self.effects]
        return same_data and sizes == [len(saved) for saved in state.effects]

    def awake_copy(self) -> mujoco.MjData:
        """Return a copy, until the next call, of the state with contacts of sleeping machines, which MuJoCo omits."""
        mujoco.mj_copyData(self._spare, self.model, self.data)
        flags = self.model.opt.enableflags
        self.model.opt.enableflags = flags & ~_SLEEP
        mujoco.mj_forward(self.model, self._spare)
        self.model.opt.enableflags = flags
        return self._spare

    def poses(self) -> Poses:
        """Return the true poses of everything that moves."""
        poses = self.data.qpos[self.pose_places]
        n = len(self.cars)
        hinges = [self.data.qpos[slope.hinge.qpos] for slope in self.slopes]
        return Poses(
            car_positions=poses[:n, :3],
            car_quaternions=poses[:n, 3:],
            kinds=self.table_kinds + (Kind.FSLOPE,) * len(self.slopes),
            positions=poses[n:, :3],
            quaternions=poses[n:, 3:],
            hinges=np.array([math.nan] * len(self.tables) + hinges),
        )

    def free_body_state(self, body: Joint) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return copies of a body's position (3,) in metres and unit quaternion (4,), w first, in the world frame."""
        pose = self.data.qpos[body.qpos : body.qpos + 7].copy()
        return pose[:3], pose[3:]

    def _rouse(self) -> None:
        """Keep commanded trees awake, and let the others sleep. The next step wakes commanded ones that sleep."""
        self.model.tree_sleep_policy[self._tree_of_motor] = _MAY_SLEEP
        busy = self._tree_of_motor[self._ctrl != 0.0]
        self.model.tree_sleep_policy[busy] = _STAY_AWAKE
