"""Newton's law and the balance of work in every physics step of actions, from MuJoCo's arrays alone.

The tests of test_honesty.py look at models and sources. These look at what moves: each change of speed must come from
motors, damping, dry friction and contacts, and each change of place from the speed.
"""

from collections import Counter

import mujoco
import numpy as np
import pytest
from discrete.drawn import draw

from craftsim.checking.judge import Judge
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.mjcf.machines import NOMINAL
from craftsim.models.world import PhysicsWorld
from craftsim.skills.executor import Executor

CAR = NOMINAL.cars[0]
FREE = int(mujoco.mjtJoint.mjJNT_FREE)
PITCH_M = 0.3225
SOLVER_N = 0.5
"""What the solver's tolerance leaves of a force, of hundreds of newtons."""
MAY_CHANGE = {"tree_sleep_policy"}
"""Arrays of a model that change while a world with ideal motors runs: which trees a command keeps awake."""


def parameters(model: mujoco.MjModel) -> dict[str, bytes]:
    """Return all arrays of a model, and those of its options, by name."""
    arrays = {}
    for holder in (model, model.opt):
        for name in dir(holder):
            value = getattr(holder, name)
            if isinstance(value, np.ndarray) and name not in MAY_CHANGE:
                arrays[name] = value.tobytes()
    for name in ("density", "viscosity", "disableflags", "enableflags", "timestep"):
        arrays[name] = np.array(getattr(model.opt, name)).tobytes()
    return arrays


class Balance:
    """An observer of physics steps that finds what moves a world but may not, and adds up the work of each kind."""

    def __init__(self, physics: PhysicsWorld) -> None:
        self.model = physics.model
        self.data = physics.data
        self.physics = physics
        self.found: Counter[str] = Counter()
        """How often each law was broken, by its name."""
        self.work_j = {"motors": 0.0, "damping": 0.0, "contacts and dry friction": 0.0}
        self.parameters = parameters(self.model)
        self.motor_limits_nm = {}
        for motor in range(self.model.nu):
            name = self.model.actuator(motor).name
            limit = NOMINAL.slope.hinge_torque_nm
            if "wheel" in name:
                limit = CAR.wheel_torque_nm
            elif name.endswith("board"):
                limit = CAR.board_force_n
            self.motor_limits_nm[motor] = limit
        self.bases = np.flatnonzero(self.model.jnt_type == FREE)
        self._inertia = np.zeros((self.model.nv, self.model.nv))
        self._periods = 0
        self._keep()

    def _keep(self) -> None:
        self._qpos = self.data.qpos.copy()
        self._qvel = self.data.qvel.copy()
        self._asleep = self.data.tree_asleep >= 0

    def _expect(self, law: str, excess: np.ndarray | float, band: float) -> None:
        self.found[law] += int(np.max(np.abs(excess), initial=0.0) > band)

    def look(self) -> None:
        """Hold the last step against the laws; call it after each."""
        model = self.model
        data = self.data
        asleep = data.tree_asleep >= 0
        moves = (~asleep & ~self._asleep)[model.dof_treeid]
        step_s = model.opt.timestep
        place = self._qpos.copy()
        mujoco.mj_integratePos(model, place, data.qvel, step_s)
        self._expect("places follow from speeds", place - data.qpos, 1e-12)
        if (asleep == self._asleep).all():
            # Where something falls asleep or wakes, MuJoCo leaves accelerations of another order behind.
            gained = data.qvel - self._qvel - step_s * data.qacc
            self._expect("speeds follow from accelerations", gained[moves], 1e-12)
            mujoco.mj_fullM(model, data, self._inertia)
            forces = data.qfrc_actuator + data.qfrc_passive + data.qfrc_constraint - data.qfrc_bias
            lacking = self._inertia @ data.qacc - forces
            self._expect("masses times accelerations are forces", lacking[moves], SOLVER_N)
        damped = data.qfrc_passive + model.dof_damping * self._qvel
        self._expect("nothing but damping is passive", damped[moves], 1e-12)
        for motor, limit in self.motor_limits_nm.items():
            excess = abs(data.actuator_force[motor]) - limit
            self._expect("motors keep their limits", max(excess, 0.0), 1e-12)
        self._look_at_bases(moves)
        speed = np.where(moves, (data.qvel + self._qvel) / 2, 0.0)
        self.work_j["motors"] += step_s * float(speed @ data.qfrc_actuator)
        self.work_j["damping"] += step_s * float(speed @ data.qfrc_passive)
        self.work_j["contacts and dry friction"] += step_s * float(speed @ data.qfrc_constraint)
        self._keep()

    def _look_at_bases(self, moves: np.ndarray) -> None:
        """Hold what acts on each machine as a whole against the sum of its contact forces."""
        model = self.model
        data = self.data
        pushed = np.zeros((model.nbody, 3))
        force = np.zeros(6)
        roots = model.body_rootid[model.geom_bodyid]
        for number, (first, second) in enumerate(data.contact.geom.tolist()):
            mujoco.mj_contactForce(model, data, number, force)
            in_world = data.contact.frame[number].reshape(3, 3).T @ force[:3]
            pushed[roots[first]] -= in_world
            pushed[roots[second]] += in_world
        for base in self.bases:
            dof = model.jnt_dofadr[base]
            if moves[dof]:
                lacking = data.qfrc_constraint[dof : dof + 3] - pushed[model.jnt_bodyid[base]]
                self._expect("contacts alone push machines", lacking, 1e-9)
                motors = data.qfrc_actuator[dof : dof + 6]
                self._expect("no motor acts on a machine as a whole", motors, 0.0)

    def look_at_parameters(self, _: PhysicsWorld) -> None:
        """Hold the parameters against those of the start in every fifth control period; call it after each."""
        self._periods += 1
        if self._periods % 5 == 0:
            self.found["parameters stay"] += int(parameters(self.model) != self.parameters)

    def energy_j(self) -> float:
        """Return the potential and kinetic energy, motors' rotors included."""
        data = self.physics.awake_copy()
        mujoco.mj_fullM(self.model, data, self._inertia)
        heights = self.model.body_mass @ data.xipos[:, 2]
        return float(9.81 * heights + data.qvel @ self._inertia @ data.qvel / 2)

    @property
    def broken(self) -> set[str]:
        """The laws that were broken."""
        return {law for law, times in self.found.items() if times}


def watched(things: list, size: tuple[int, int, int]) -> tuple[Judge, Balance]:
    """Return a world with a car in its first cell, and who watches its steps."""
    physics = PhysicsWorld(draw(size, things, [(0, 0, 1, 0, 0, 0, 0)]))
    judge = Judge(Executor(physics), Rules(), watch_contacts=False)
    balance = Balance(physics)
    judge.executor.step_observer = balance.look
    judge.executor.observers.append(balance.look_at_parameters)
    return judge, balance


def test_motors_and_contacts_alone_move_a_car_that_carries_a_block_onto_a_ramp():
    """No law is broken in any step, and the work of all that acts is the energy gained. Band: 2 mJ, of 30 J."""
    things = [
        (Kind.BLOCK, (1, 0, 1), 0),
        (Kind.BODY, (3, 0, 1), 2),
        (Kind.BLOCK, (4, 0, 1), 0),
    ]
    judge, balance = watched(things, (5, 1, 3))
    start_j = balance.energy_j()
    works = []
    for action in (Action.MOVE_RIGHT, Action.LIFT, Action.MOVE_RIGHT):
        before = dict(balance.work_j)
        assert judge.perform(0, action).agrees
        works.append({kind: work - before[kind] for kind, work in balance.work_j.items()})
    assert balance.broken == set()
    gained_j = balance.energy_j() - start_j
    assert gained_j > 4.0
    assert sum(balance.work_j.values()) == pytest.approx(gained_j, abs=2e-3)
    drive, lift, _ = works
    # Four gears turn against their dry friction; the tyres' slip takes less than 1 % of that.
    gears_j = 4 * CAR.gear_friction_nm * PITCH_M / CAR.wheel_radius_m
    assert drive["contacts and dry friction"] == pytest.approx(-gears_j, rel=0.01)
    # Of m g h of board and block the sag of the board's position loop, 0.3 mm, takes less than 2 %.
    raised_m = CAR.board_rest_m + CAR.board_travel_m - NOMINAL.block.underside_m
    lifted_j = 9.81 * NOMINAL.block.mass_kg * raised_m
    lifted_j += 9.81 * CAR.board_mass_kg * CAR.board_travel_m
    assert sum(lift.values()) == pytest.approx(lifted_j, rel=0.02)


def write_a_speed(physics: PhysicsWorld) -> None:
    physics.data.qvel[0] += 1e-6


def write_a_place(physics: PhysicsWorld) -> None:
    physics.data.qpos[0] += 1e-6


def push(physics: PhysicsWorld) -> None:
    physics.data.xfrc_applied[physics.cars[0].base.body, 0] = 1.0


def blow(physics: PhysicsWorld) -> None:
    physics.model.opt.density = 100.0
    physics.model.opt.wind[0] = 0.5


def lean(physics: PhysicsWorld) -> None:
    physics.model.opt.gravity[0] = 0.01


def drive_the_chassis(physics: PhysicsWorld) -> None:
    """Let a wheel's motor pull at the whole car."""
    motor = physics.cars[0].wheel_actuators[0]
    physics.model.actuator_trnid[motor, 0] = physics.model.body_jntadr[physics.cars[0].base.body]
    physics.model.actuator_gear[motor, 0] = 20.0


def strengthen_motors(physics: PhysicsWorld) -> None:
    physics.model.actuator_forcerange *= 2.0


def hold_the_chassis(physics: PhysicsWorld) -> None:
    """Let the air hold a car as dry friction does."""
    physics.model.dof_frictionloss[physics.cars[0].base.dof] = 1.0


@pytest.mark.parametrize(
    ("plant", "law"),
    [
        (write_a_speed, "speeds follow from accelerations"),
        (write_a_place, "places follow from speeds"),
        (push, "masses times accelerations are forces"),
        (blow, "nothing but damping is passive"),
        (lean, "parameters stay"),
        (drive_the_chassis, "no motor acts on a machine as a whole"),
        (strengthen_motors, "motors keep their limits"),
        (hold_the_chassis, "contacts alone push machines"),
    ],
)
def test_what_is_planted_between_two_periods_is_found(plant, law):
    judge, balance = watched([], (3, 1, 1))
    judge.executor.begin(0, Action.MOVE_RIGHT)
    judge.executor.advance()
    assert balance.broken == set()
    for _ in range(5):
        plant(balance.physics)
        judge.executor.advance()
    assert law in balance.broken
