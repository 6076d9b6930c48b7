"""Contacts of tyres: where friction acts, what is MuJoCo's own, and who sees them."""

import ctypes
import math
import subprocess
import sys
from dataclasses import replace

import mujoco
import mujoco.rollout
import numpy as np
import pytest
from drawn import draw

from craftsim.discrete.grid import Grid, Kind
from craftsim.mjcf.car import ACROSS, N_USER, TYRE
from craftsim.mjcf.parameters import NOMINAL
from craftsim.models import wheel_contacts
from craftsim.models.composition import world_spec
from craftsim.models.config import SimulationConfig
from craftsim.models.exporting import text_of
from craftsim.models.wheel_contacts import install, tyres_of
from craftsim.models.world import PhysicsWorld

CAR = NOMINAL.cars[0]
GRAVITY = 9.81
PUCK = """
<mujoco>
  <option cone="elliptic" impratio="300"/>
  <size nuser_geom="{n_user}"/>
  <worldbody>
    <geom name="floor" type="{floor}" size="5 5 .1" pos="0 0 {below}" friction="{floor_friction} .01 .001"
          solref=".01 1.5" solimp=".8 .9 .002" solmix="3" priority="{priority}"/>
    <body pos="0 0 .1">
      <freejoint/>
      <inertial pos="0 0 0" mass="2" diaginertia="1000 1000 1000"/>
      <geom name="tyre" type="{shape}" size="{size}" friction="{friction} .005 .0001" solref=".02 1" user="{user}"/>
    </body>
  </worldbody>
</mujoco>"""


def puck(user=f"{TYRE} 1 0.02", **other) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return a wheel, too heavy to turn, on a floor."""
    figures = {"n_user": N_USER, "floor": "plane", "below": 0, "floor_friction": 0.4, "priority": 0}
    figures |= {"shape": "sphere", "size": ".1", "friction": 0.8, "user": user, **other}
    model = mujoco.MjModel.from_xml_string(PUCK.format(**figures))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


@pytest.fixture(autouse=True)
def installed():
    install()


SHAPES = (("sphere", ".1"), ("ellipsoid", ".1 .03 .1"))
FLOORS = (("plane", 0), ("box", -0.1))


@pytest.mark.parametrize(("shape", "size"), SHAPES)
@pytest.mark.parametrize(("floor", "below"), FLOORS)
@pytest.mark.parametrize("priority", [-1, 0, 1])
def test_all_but_the_tangents_and_the_friction_across_is_as_mujoco_has_it(
    shape, size, floor, below, priority
):
    """The same wheel without the mark is MuJoCo's own."""
    place = {"shape": shape, "size": size, "floor": floor, "below": below, "priority": priority}
    _, marked = puck(**place)
    _, plain = puck(user="0 1 0.02", **place)
    assert marked.ncon == plain.ncon == 1
    ours, theirs = marked.contact[0], plain.contact[0]
    for name in ("dist", "includemargin", "dim", "exclude", "geom1", "geom2"):
        assert getattr(ours, name) == getattr(theirs, name), name
    for name in ("pos", "solref", "solimp", "solreffriction", "geom", "flex", "elem", "vert"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)
    np.testing.assert_allclose(ours.frame[:3], theirs.frame[:3], atol=1e-15)
    assert ours.friction[0] == theirs.friction[0]
    assert ours.friction[1] == 0.02
    frame = ours.frame.reshape(3, 3)
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)


@pytest.mark.parametrize(("shape", "size"), SHAPES)
@pytest.mark.parametrize("side", [1, -1])
def test_a_sliding_wheel_is_braked_along_its_roller_alone(shape, size, side):
    """At mu 0.8 it loses mu g t along the roller's axis, at 45 degrees to the axle, 0.02 g t across it. Band: 3 %."""
    for angle, friction in ((45, 0.8), (135, 0.02)):
        model, data = puck(user=f"{TYRE} {side} 0.02", shape=shape, size=size)
        towards = math.radians(angle)
        # Below the axle t = r x y points forward, so that a roller of s = 1 lies along (1, 1).
        direction = np.array([math.cos(towards), side * math.sin(towards)])
        data.qvel[:2] = 3.0 * direction
        mujoco.mj_step(model, data, 100)
        lost = 3.0 - data.qvel[:2] @ direction
        assert lost == pytest.approx(friction * GRAVITY * 0.2, rel=0.03)
        assert abs(data.qvel[:2] @ [-direction[1], direction[0]]) < 0.02


def test_the_rollers_axis_follows_the_place_of_the_contact(ramp):
    """On an incline it lies in the incline's plane, at 45 degrees to the fall line, by each wheel's side."""
    physics = PhysicsWorld(ramp(1), SimulationConfig(sleep=False))
    model, data = physics.model, physics.data
    forward = data.body("car0/smartcar").xmat.reshape(3, 3)[:, 0]
    left = data.body("car0/smartcar").xmat.reshape(3, 3)[:, 1]
    sides = {}
    for contact in data.contact:
        tyre = next((geom for geom in contact.geom if geom in tyres_of(model)), None)
        if tyre is not None:
            axis, normal = contact.frame[3:6], contact.frame[:3]
            assert abs(axis @ normal) < 1e-12
            assert abs(axis @ forward) == pytest.approx(math.sqrt(0.5), abs=0.01)
            sides[model.geom(tyre).name[-2:]] = np.sign((axis @ forward) * (axis @ left))
    assert sides == {"fl": 1, "rr": 1, "fr": -1, "rl": -1} or sides == {"fl": -1, "rr": -1, "fr": 1, "rl": 1}


def test_every_way_to_look_at_a_world_finds_the_same_contacts():
    """mj_step, mj_forward, a copy, a rollout in another thread: friction of 0.8 along the roller, hardly any across."""
    physics = PhysicsWorld(Grid.empty((3, 1, 1), 1), SimulationConfig(sleep=False))
    model = physics.model
    expected = [CAR.roller_friction, CAR.friction_across]

    def check(data):
        assert data.ncon == 4
        np.testing.assert_allclose(data.contact.friction[:, :2], np.tile(expected, (4, 1)), rtol=1e-9)

    check(physics.data)
    data = mujoco.MjData(model)
    data.qpos[:] = physics.data.qpos
    mujoco.mj_forward(model, data)
    check(data)
    mujoco.mj_step(model, data)
    check(data)
    check(physics.awake_copy())
    state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, physics.data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    control = np.tile([0.0, 3.0, 3.0, 3.0, 3.0], (1, 20, 1))
    rolled, _ = mujoco.rollout.rollout(
        model, [mujoco.MjData(model), mujoco.MjData(model)], state[None], control
    )
    physics.data.ctrl[:] = control[0, 0]
    mujoco.mj_step(model, physics.data, 20)
    mujoco.mj_getState(model, physics.data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    np.testing.assert_allclose(rolled[0, -1], state, atol=1e-9)


def test_a_sleeping_car_is_woken_by_what_touches_it():
    """MuJoCo wakes what the contacts of a step touch, tyres among them: a slope that is shoved into a car's wheels."""
    grid = draw((5, 1, 2), [(Kind.BLOCK, (0, 0, 1))], [(0, 0, 1, 0), (3, 0, 1, 2)])
    physics = PhysicsWorld(grid)
    for _ in range(40):
        physics.advance()
    tree = physics.cars[1].base.tree
    assert physics.data.tree_asleep[tree] >= 0
    physics.drive(0, [4.0] * 4)
    for _ in range(300):
        physics.advance()
        if physics.data.tree_asleep[tree] < 0:
            break
    assert physics.data.tree_asleep[tree] < 0


def test_models_without_tyres_are_left_alone():
    """A ball of another program: to the bit what a process without craftsim gets."""
    program = (
        "import mujoco, sys\n"
        "model = mujoco.MjModel.from_xml_string(sys.argv[1])\n"
        "data = mujoco.MjData(model)\n"
        "data.qvel[:] = 0.3\n"
        "mujoco.mj_step(model, data, 200)\n"
        "print(data.qpos.tobytes().hex())\n"
    )
    figures = {"floor": "plane", "below": 0, "floor_friction": 0.4, "priority": 0, "shape": "ellipsoid"}
    figures |= {"size": ".1 .03 .1", "friction": 0.8}
    for n_user, user in ((0, ""), (3, "0 1 0.02"), (1, f"{TYRE}")):
        text = PUCK.format(n_user=n_user, user=user, **figures)
        apart = subprocess.run(
            [sys.executable, "-c", program, text], capture_output=True, text=True, check=True
        ).stdout.strip()
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        data.qvel[:] = 0.3
        mujoco.mj_step(model, data, 200)
        assert data.qpos.tobytes().hex() == apart


def test_plain_mujoco_sees_tyres_with_equal_friction_both_ways(tmp_path):
    """What an exported world lacks in a process without craftsim, as docs/explanation/drives.md says."""
    path = tmp_path / "world.xml"
    spec = world_spec(Grid.empty((3, 1, 1), 1), SimulationConfig(sleep=False))
    path.write_text(text_of(spec), encoding="utf-8")
    program = (
        "import mujoco, sys\n"
        "model = mujoco.MjModel.from_xml_path(sys.argv[1])\n"
        "data = mujoco.MjData(model)\n"
        "mujoco.mj_step(model, data, 50)\n"
        "print(data.ncon, abs(data.contact.friction[:, 0] - data.contact.friction[:, 1]).max())\n"
    )
    printed = subprocess.run(
        [sys.executable, "-c", program, str(path)], capture_output=True, text=True, check=True
    ).stdout.split()
    assert printed == ["4", "0.0"]


@pytest.mark.parametrize("name", ["_MODEL", "_DATA", "_CONTACT"])
def test_a_layout_that_is_not_as_described_is_refused(monkeypatch, name):
    """A word that nobody knows of, before all others."""
    known = getattr(wheel_contacts, name)
    members = [("unknown", ctypes.c_int64), *known._fields_]
    monkeypatch.setattr(wheel_contacts, name, type("Other", (ctypes.Structure,), {"_fields_": members}))
    with pytest.raises(ImportError, match=r"lays its structures out otherwise.*install another release"):
        wheel_contacts._check_layout()


def test_friction_across_is_what_a_bearing_takes_under_a_quarter_of_the_car():
    """0.004 Nm on a roller of 9 mm: 0.44 N of 25 N."""
    assert CAR.friction_across == pytest.approx(0.0176, rel=0.01)
    heavier = replace(CAR, roller_bearing_friction_nm=0.008)
    physics = PhysicsWorld(Grid.empty((2, 1, 1), 1), machines=replace(NOMINAL, cars=(heavier,)))
    tyres = tyres_of(physics.model)
    np.testing.assert_allclose(physics.model.geom_user[tyres, ACROSS], 2 * CAR.friction_across, rtol=1e-9)
