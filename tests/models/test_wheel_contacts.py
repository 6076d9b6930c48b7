"""Contacts of tyres: where friction acts, what is MuJoCo's own, and who sees them."""

import copy
import ctypes
import math
import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import mujoco
import mujoco.rollout
import numpy as np
import pytest
from discrete.drawn import draw

from craftsim.discrete.grid import Grid, Kind
from craftsim.mjcf.building import TOUCHES
from craftsim.mjcf.car import ACROSS, N_USER, TYRE
from craftsim.mjcf.machines import NOMINAL
from craftsim.models import wheel_contacts
from craftsim.models.composition import machine_spec, world_spec
from craftsim.models.config import SimulationConfig
from craftsim.models.exporting import mjcf_text
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


def puck(user=f"{TYRE} 1 0.02 1", **other) -> tuple[mujoco.MjModel, mujoco.MjData]:
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


SHAPES = {
    "plane": 'size="1 1 .1"',
    "box": 'size=".2 .15 .1"',
    "mesh": 'mesh="wedge"',
    "cylinder": 'size=".2 .1"',
    "hfield": 'hfield="hills"',
    "sphere": 'size=".15"',
    "capsule": 'size=".1 .1"',
    "ellipsoid": 'size=".2 .1 .15"',
}
STANDING = ("plane", "hfield")
PAIR = """
<mujoco>
  <option {options}><flag override="{override}"/></option>
  <size nuser_geom="4" memory="{memory}"/>
  <asset>
    <mesh name="wedge" vertex="-.2 -.2 -.1  .2 -.2 -.1  0 .2 -.1  0 0 .1"/>
    <hfield name="hills" nrow="4" ncol="4" size=".4 .4 .1 .1" elevation="0 1 0 1 0 1 0 1 0 1 1 0 0 0 1 1"/>
  </asset>
  <worldbody>{bodies}</worldbody>
  <contact>{contacts}</contact>
</mujoco>"""
TAKEN_OVER = (
    "dist",
    "pos",
    "solref",
    "solreffriction",
    "solimp",
    "includemargin",
    "adhesion",
    "exclude",
    "geom",
    "geom1",
    "geom2",
    "flex",
    "elem",
    "vert",
)


def drawn_parameters(rng):
    """Return parameters of contacts of a geom, as MJCF has them; a negative ``solref`` is a stiffness."""
    solref = rng.uniform(-900, -100, 2) if rng.random() < 0.4 else rng.uniform(0.01, 0.05, 2)
    low = rng.uniform(0.1, 0.9)
    parameters = {
        "friction": rng.uniform(0, 1, 3),
        "solref": solref,
        "solimp": (low, low + 0.05, 0.003, 0.4, 3),
        "solmix": [rng.choice([0, 1e-16, 0.5, 1, 3])],
        "priority": [rng.integers(-1, 2)],
        "condim": [rng.choice([1, 3, 4, 6])],
        "margin": [rng.choice([0, 0.01, 0.03])],
        "gap": [rng.choice([0, 0.01])],
        "adhesion": [rng.choice([0, 0, 1, 3])],
    }
    return " ".join(f'{name}="{" ".join(map(str, values))}"' for name, values in parameters.items())


def drawn_pair(rng, shape):
    """Return two models of a wheel and another geom with drawn parameters: the wheel is a tyre in the second."""
    options = f'o_margin="{rng.uniform(0, 0.03)}" o_solref="{rng.uniform(0.01, 0.05)} 1.1" '
    options += 'o_solimp=".7 .8 .003 .4 3" o_friction=".6 .6 .02 .003 .004"'
    override = "enable" if rng.random() < 0.3 else "disable"
    joint = "" if shape in STANDING else "<freejoint/>"
    mass = "" if shape in STANDING else 'mass="1"'
    other = f'<body name="other">{joint}<geom type="{shape}" {mass} {SHAPES[shape]} {drawn_parameters(rng)}/></body>'
    parameters = drawn_parameters(rng)
    excluded = '<exclude body1="wheel" body2="other"/>' if rng.random() < 0.1 else ""
    is_first = rng.random() < 0.5
    models = []
    for mark in (0.0, TYRE):
        tyre = f'<geom size=".1" mass="1" user="{mark} 1 0.02 1" {parameters}/>'
        bodies = [f'<body name="wheel"><freejoint/>{tyre}</body>', other]
        if not is_first:
            bodies.reverse()
        figures = {"options": options, "override": override, "memory": "-1"}
        text = PAIR.format(bodies="".join(bodies), contacts=excluded, **figures)
        models.append(mujoco.MjModel.from_xml_string(text))
    return models


def sorted_contacts(data):
    return sorted(data.contact, key=lambda contact: (contact.dist, *contact.pos))


def softness_of_friction(model, contact) -> np.ndarray:
    """Return the reference of a tyre's friction: that of the geom with the smaller time constant, where both have one.

    Of geoms of different priority the higher one decides alone. An override holds for friction, too.
    """
    if model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE:
        return contact.solreffriction
    first, second = contact.geom
    priorities = model.geom_priority[[first, second]]
    if priorities[0] > priorities[1]:
        second = first
    elif priorities[0] < priorities[1]:
        first = second
    references = model.geom_solref[[first, second]]
    if references[:, 0].min() <= 0:
        return np.zeros(2)
    return references[references[:, 0].argmin()]


@pytest.mark.parametrize("shape", SHAPES)
def test_all_but_the_tangents_and_the_friction_across_is_as_mujoco_has_it(shape):
    """Of any pose and parameters, overrides, priorities, margins and stiffnesses among them."""
    rng = np.random.default_rng(list(SHAPES).index(shape))
    n_turned = 0
    for _ in range(30):
        models = drawn_pair(rng, shape)
        plain = mujoco.MjData(models[0])
        marked = mujoco.MjData(models[1])
        for _ in range(5):
            for place in range(0, models[0].nq, 7):
                quat = rng.normal(size=4)
                plain.qpos[place : place + 3] = rng.uniform(-0.17, 0.17, 3)
                plain.qpos[place + 3 : place + 7] = quat / np.linalg.norm(quat)
            marked.qpos[:] = plain.qpos
            mujoco.mj_forward(models[0], plain)
            mujoco.mj_forward(models[1], marked)
            assert plain.ncon == marked.ncon
            for theirs, ours in zip(sorted_contacts(plain), sorted_contacts(marked), strict=True):
                is_taken = ours.friction[0] != ours.friction[1]
                for name in TAKEN_OVER:
                    expected = getattr(theirs, name)
                    if name == "solreffriction" and is_taken:
                        expected = softness_of_friction(models[1], theirs)
                    np.testing.assert_array_equal(getattr(ours, name), expected, err_msg=name)
                np.testing.assert_allclose(ours.frame[:3], theirs.frame[:3], atol=1e-14)
                assert ours.friction[0] == theirs.friction[0]
                np.testing.assert_array_equal(ours.friction[2:], theirs.friction[2:])
                frame = ours.frame.reshape(3, 3)
                np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
                assert np.linalg.det(frame) == pytest.approx(1.0)
                if not is_taken:
                    # Beside the tread, or less along the roller than across it.
                    continue
                n_turned += 1
                assert ours.friction[1] == 0.02
                is_tether = theirs.adhesion > 0 and theirs.dist >= theirs.includemargin
                assert ours.dim == (1 if is_tether else 3)
    assert n_turned > 50


def test_an_explicit_pair_keeps_its_parameters_and_has_its_first_friction_along_the_roller():
    """It has itself a coefficient for each tangent."""
    bodies = (
        '<geom name="floor" type="plane" size="5 5 .1"/>'
        '<body pos="0 0 .099"><freejoint/><geom name="tyre" size=".1" user="{} 1 0.02 1"/></body>'
    )
    pair = '<pair geom1="tyre" geom2="floor" condim="4" friction=".5 .3 .01 .001 .001" solref=".03 1" margin=".01"/>'
    worlds = []
    for mark in (0.0, TYRE):
        figures = {"options": "", "override": "disable", "memory": "-1"}
        text = PAIR.format(bodies=bodies.format(mark), contacts=pair, **figures)
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        worlds.append(data)
    plain = worlds[0].contact[0]
    marked = worlds[1].contact[0]
    for name in (*TAKEN_OVER, "friction", "dim"):
        np.testing.assert_array_equal(getattr(marked, name), getattr(plain, name), err_msg=name)
    np.testing.assert_allclose(marked.frame[3:6], [math.sqrt(0.5), math.sqrt(0.5), 0.0], atol=1e-12)


SENSED = """
<mujoco>
  <option cone="elliptic"/>
  <size nuser_geom="4"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1"/>
    <body pos="0 0 .099"><freejoint/><geom name="tyre" size=".1" user="{} 1 0.02 1"/></body>
    <body pos="1 0 .099"><freejoint/><geom name="box" type="box" size=".1 .1 .1"/></body>
  </worldbody>
  <sensor>
    <distance geom1="tyre" geom2="floor" cutoff="1"/>
    <distance geom1="tyre" geom2="box" cutoff="2"/>
  </sensor>
</mujoco>"""


def test_distances_of_a_tyre_are_mujocos_and_add_no_contact():
    """Sensors of distance call the functions of collisions too, after the contacts have become constraints."""
    states = []
    for mark in (0.0, TYRE):
        model = mujoco.MjModel.from_xml_string(SENSED.format(mark))
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 100)
        points = np.zeros(6)
        distance = mujoco.mj_geomDistance(model, data, 0, 1, 1.0, points)
        states.append([*data.sensordata, distance, *points, data.ncon, data.nefc, *data.qpos])
    np.testing.assert_allclose(states[1], states[0], atol=1e-12)


def test_distances_of_other_shapes_are_what_a_process_without_craftsim_gets():
    """MuJoCo's mj_geomDistance looks at which function is in the table."""
    program = (
        "import mujoco, sys\n"
        "exec(sys.argv[1])\n"
        "for shape, size in (('ellipsoid', '.1 .03 .08'), ('box', '.1 .07 .05'), ('cylinder', '.1 .05')):\n"
        '    other = f\'<geom type="{shape}" size="{size}"/>\'\n'
        '    ellipsoid = \'<body pos=".02 .01 .03"><geom type="ellipsoid" size=".1 .03 .08"/></body>\'\n'
        "    text = f'<mujoco><worldbody>{other}{ellipsoid}</worldbody></mujoco>'\n"
        "    model = mujoco.MjModel.from_xml_string(text)\n"
        "    data = mujoco.MjData(model)\n"
        "    mujoco.mj_kinematics(model, data)\n"
        "    print(mujoco.mj_geomDistance(model, data, 0, 1, 1.0, None))\n"
    )
    installing = "from craftsim.models.wheel_contacts import install; install()"
    printed = []
    for first in ("", installing):
        words = [sys.executable, "-c", program, first]
        printed.append(subprocess.run(words, capture_output=True, text=True, check=True).stdout)
    assert printed[0] == printed[1]


def many_wheels(n: int, memory: str = "-1") -> mujoco.MjModel:
    """Return a model of many wheels on a floor, that roll in different directions."""
    wheels = ""
    for number in range(n):
        side = 1 - 2 * (number % 2)
        place = f"{0.3 * (number % 20)} {0.3 * (number // 20)} 0.099"
        wheels += (
            f'<body pos="{place}"><freejoint/><geom size=".1" user="{TYRE} {side} 0.02 1"/></body>'
        )
    bodies = f'<geom type="plane" size="5 5 .1"/>{wheels}'
    figures = {"options": 'cone="elliptic"', "override": "disable", "memory": memory}
    text = PAIR.format(bodies=bodies, contacts="", **figures)
    return mujoco.MjModel.from_xml_string(text)


@pytest.mark.parametrize("n_threads", [1, 3, 8])
def test_a_pool_of_threads_finds_the_same_contacts_in_the_same_order(n_threads):
    """MuJoCo may look for the contacts of one world in several threads: the same world, bit for bit."""
    model = many_wheels(300)
    alone = mujoco.MjData(model)
    alone.qvel[:] = np.random.default_rng(0).normal(0, 0.3, model.nv)
    together = mujoco.MjData(model)
    together.qvel[:] = alone.qvel
    mujoco.mju_threadpool(together, n_threads)
    for _ in range(30):
        mujoco.mj_step(model, alone)
        mujoco.mj_step(model, together)
        np.testing.assert_array_equal(together.contact.geom, alone.contact.geom)
    assert together.qpos.tobytes() == alone.qpos.tobytes()


def test_contacts_for_which_there_is_no_memory_are_a_warning():
    """As MuJoCo's own."""
    model = many_wheels(60, memory="46K")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    n_missing = 60 - data.ncon
    assert 0 < n_missing < 60
    assert data.warning.number[int(mujoco.mjtWarning.mjWARN_CONTACTFULL)] == n_missing


ANEW = """
import threading
import mujoco
import sys
from craftsim.models.wheel_contacts import install
threads = [threading.Thread(target=install) for _ in range(8)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
install()
model = mujoco.MjModel.from_xml_string(sys.argv[1])
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
print(data.ncon, *data.contact.friction[0, :2])
"""


@pytest.mark.parametrize(
    "environment", [{}, {"NUMBA_CACHE_DIR": "/dev/null/none"}, {"NUMBA_DISABLE_JIT": "1"}], ids=str
)
def test_any_process_may_install_them(environment):
    """In several threads at once, twice, where compiled code cannot be kept, and in plain Python."""
    figures = {"n_user": N_USER, "floor": "plane", "below": 0, "floor_friction": 0.4, "priority": 0}
    figures |= {"shape": "sphere", "size": ".101", "friction": 0.8, "user": f"{TYRE} 1 0.02 1"}
    words = [sys.executable, "-c", ANEW, PUCK.format(**figures)]
    done = subprocess.run(
        words, env={**os.environ, **environment}, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["1", "0.8", "0.02"]


@pytest.mark.parametrize("side", [1, -1])
def test_a_sliding_wheel_is_braked_along_its_roller_alone(side):
    """At mu 0.8 it loses mu g t along the roller's axis, at 45 degrees to the axle, 0.02 g t across it. Band: 3 %.

    Across it is slow: beyond 149 mm/s this contact has less friction.
    """
    for angle, friction, speed in ((45, 0.8, 3.0), (135, 0.02, 0.1)):
        model, data = puck(user=f"{TYRE} {side} 0.02 1")
        # As soft as each other: with harder friction than normal a wheel that slides at 3 m/s hops.
        model.geom_solref[:] = 0.0125, 1.375
        towards = math.radians(angle)
        # Below the axle t = r x y points forward, so that a roller of s = 1 lies along (1, 1).
        direction = np.array([math.cos(towards), side * math.sin(towards)])
        data.qvel[:2] = speed * direction
        mujoco.mj_step(model, data, 100)
        lost = speed - data.qvel[:2] @ direction
        assert lost == pytest.approx(friction * GRAVITY * 0.2, rel=0.03)
        assert abs(data.qvel[:2] @ [-direction[1], direction[0]]) < 0.02


ON_BOX = """
<mujoco>
  <size nuser_geom="4"/>
  <worldbody>
    <body name="box" quat="{turn[0]} {turn[1]} {turn[2]} {turn[3]}"><geom type="box" size="1 1 .1"/></body>
    <body><freejoint/><geom size=".1" user="{tyre} {side} 0.02 .05"/></body>
  </worldbody>
</mujoco>"""


def turned(axis, angle) -> np.ndarray:
    """Return the rotation by an angle about an axis, as a matrix."""
    quat = np.zeros(4)
    matrix = np.zeros(9)
    mujoco.mju_axisAngle2Quat(quat, np.array(axis, float), angle)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)


def quaternion(matrix) -> np.ndarray:
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, matrix.ravel())
    return quat


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("incline", [0.0, 0.3, 0.6])
def test_the_rollers_axis_is_at_45_degrees_to_heading_and_axle_on_a_face(side, incline):
    """In eight headings on an incline; however far the wheel has rolled."""
    base = turned((0, 1, 0), -incline)
    text = ON_BOX.format(turn=quaternion(base), tyre=TYRE, side=side)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for heading in np.arange(8) * math.pi / 4:
        chassis = base @ turned((0, 0, 1), heading)
        data.qpos[:3] = base[:, 2] * 0.199
        data.qpos[3:] = quaternion(chassis @ turned((0, 1, 0), 1.3))
        mujoco.mj_forward(model, data)
        expected = (chassis[:, 0] + side * chassis[:, 1]) / math.sqrt(2)
        np.testing.assert_allclose(data.contact[0].frame[3:6], expected, atol=1e-12)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("height", [0.2, 0.7, 1.2])
def test_the_rollers_axis_at_an_edge_is_that_of_the_place_that_touches(side, height):
    """In sixteen headings; where the axle points so far at the edge that it touches beside the tread, there is none."""
    model = mujoco.MjModel.from_xml_string(ON_BOX.format(turn=(1, 0, 0, 0), tyre=TYRE, side=side))
    data = mujoco.MjData(model)
    normal = np.array([math.cos(height), 0.0, math.sin(height)])
    for heading in np.arange(16) * math.pi / 8:
        pose = turned((0, 0, 1), heading)
        data.qpos[:3] = np.array([1.0, 0.0, 0.1]) + 0.099 * normal
        data.qpos[3:] = quaternion(pose)
        mujoco.mj_forward(model, data)
        if abs(0.1 * normal @ pose[:, 1]) > 0.05:
            assert data.ncon == 0
            continue
        contact = data.contact[0]
        tread = np.cross(-normal, pose[:, 1])
        length = np.linalg.norm(tread)
        axis = tread / length + side * pose[:, 1]
        axis -= normal * (axis @ normal)
        np.testing.assert_allclose(contact.frame[3:6], axis / np.linalg.norm(axis), atol=1e-12)
        assert contact.friction[1] == 0.02


def test_friction_across_times_speed_lifts_a_wheel_by_a_quarter_of_its_depth_at_rest_at_most(ramp):
    """A cone that slides at v acts as if its normal were damped at mu v: by 2 / (dmax timeconst) of solref, solimp.

    At rest a contact gives way to (1 - d0) / d0 g. Speeds are here those of mj_jac, of both bodies.
    """
    physics = PhysicsWorld(ramp(1), SimulationConfig(sleep=False))
    model = physics.model
    tyres = tyres_of(model)
    contact = NOMINAL.contact
    rest = GRAVITY * (1 - contact.impedance_min) / contact.impedance_min
    most = rest / 4 * contact.impedance_max * contact.time_constant_s / 2
    assert most / CAR.friction_across == pytest.approx(0.029, rel=0.01)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    smaller = []
    for share in (0.0, 0.01, 0.1, 1.0):
        data.qpos[:] = physics.data.qpos
        data.qvel[:] = share * rng.normal(size=model.nv)
        mujoco.mj_forward(model, data)
        for contact in data.contact:
            if not np.isin(contact.geom, tyres).any():
                continue
            speeds = []
            for geom in contact.geom:
                jacobian = np.zeros((3, model.nv))
                mujoco.mj_jac(model, data, jacobian, None, contact.pos, model.geom_bodyid[geom])
                speeds.append(jacobian @ data.qvel)
            sliding = abs((speeds[1] - speeds[0]) @ contact.frame[6:9])
            expected = min(CAR.friction_across, most / max(sliding, 1e-9))
            assert contact.friction[1] == pytest.approx(expected, rel=1e-6)
            smaller.append(expected < CAR.friction_across)
    assert 4 <= sum(smaller) <= len(smaller) - 4


@pytest.mark.parametrize(
    "turns", [(-1, 1, 1, -1), (-1, 1, -1, 1), (0, 1, 1, 0)], ids=["side", "turn", "askew"]
)
def test_wheels_stay_on_the_ground_in_every_step_while_their_rollers_turn(turns):
    """Up to 0.6 m/s along the wheels' rims, from rest at 0.5 m/s^2."""
    physics = PhysicsWorld(Grid.empty((9, 9, 1), 1), SimulationConfig(sleep=False))
    model = physics.model
    data = physics.data
    tyres = tyres_of(model)
    motors = list(physics.cars[0].wheel_actuators)
    for step in range(375):
        speed = min(0.5 * step * model.opt.timestep, 0.6) / CAR.wheel_radius_m
        data.ctrl[motors] = speed * np.array(turns)
        mujoco.mj_step(model, data)
        touching = np.isin(data.contact.geom, tyres).any(axis=1) & (data.contact.efc_address >= 0)
        assert (data.efc_force[data.contact.efc_address[touching]] > 0).sum() == 4


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
    assert sides == {"fl": 1, "rr": 1, "fr": -1, "rl": -1} or sides == {
        "fl": -1,
        "rr": -1,
        "fr": 1,
        "rl": 1,
    }


def test_every_way_to_look_at_a_world_finds_the_same_contacts():
    """mj_step, mj_forward, a copy, a rollout in another thread: friction of 0.8 along the roller, hardly any across."""
    physics = PhysicsWorld(Grid.empty((3, 1, 1), 1), SimulationConfig(sleep=False))
    model = physics.model
    expected = [CAR.roller_friction, CAR.friction_across]

    def check(data):
        assert data.ncon == 4
        np.testing.assert_allclose(
            data.contact.friction[:, :2], np.tile(expected, (4, 1)), rtol=1e-9
        )

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


def drive_awhile(physics, first: int, last: int) -> bytes:
    """Drive three cars in turn, between rests in which all fall asleep; return all states."""
    states = []
    n_asleep = []
    for period in range(first, last):
        for car in range(3):
            is_driven = period % 75 < 40 and (period // 75 + car) % 3 < 2
            physics.drive(car, [3.0, 3.0, 3.0, 3.0] if is_driven else [0.0] * 4)
        physics.advance()
        states.append(physics.data.qpos.tobytes())
        n_asleep.append(int((physics.data.tree_asleep >= 0).sum()))
    assert min(n_asleep) < max(n_asleep)
    return b"".join(states)


def test_a_world_in_which_cars_sleep_and_wake_goes_on_alike_however_it_is_copied():
    """Restored, copied, pickled, beside another world, and with a pool of MuJoCo's threads: bit for bit."""
    grid = draw((6, 4, 2), [(Kind.BLOCK, (2, 2, 1))], [(0, 0, 1, 0), (5, 3, 1, 2), (1, 3, 1, 1)])
    physics = PhysicsWorld(grid)
    drive_awhile(physics, 0, 60)
    saved = physics.save()
    worlds = [
        copy.deepcopy(physics),
        pickle.loads(pickle.dumps(physics)),
        PhysicsWorld(grid),
        PhysicsWorld(grid),
    ]
    for world in worlds[2:]:
        world.restore(saved)
    mujoco.mju_threadpool(worlds[3].data, 3)
    expected = drive_awhile(physics, 60, 220)
    physics.restore(saved)
    with ThreadPoolExecutor() as threads:
        trajectories = threads.map(lambda world: drive_awhile(world, 60, 220), [physics, *worlds])
    for trajectory in trajectories:
        assert trajectory == expected


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
    figures = {
        "floor": "plane",
        "below": 0,
        "floor_friction": 0.4,
        "priority": 0,
        "shape": "ellipsoid",
    }
    figures |= {"size": ".1 .03 .1", "friction": 0.8}
    for n_user, user in ((0, ""), (4, "0 1 0.02 1"), (1, f"{TYRE}")):
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
    path.write_text(mjcf_text(spec), encoding="utf-8")
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
    structure = getattr(wheel_contacts, name)
    members = [("unknown", ctypes.c_int64), *structure._fields_]
    monkeypatch.setattr(
        wheel_contacts, name, type("Other", (ctypes.Structure,), {"_fields_": members})
    )
    with pytest.raises(
        ImportError, match=r"lays its structures out otherwise.*install another release"
    ):
        wheel_contacts._check_layout()


def test_friction_across_is_what_a_bearing_takes_under_a_quarter_of_the_car():
    """0.004 Nm on a roller of 9 mm: 0.44 N of 25 N."""
    assert CAR.friction_across == pytest.approx(0.0176, rel=0.01)
    heavier = replace(CAR, roller_bearing_friction_nm=0.008)
    physics = PhysicsWorld(Grid.empty((2, 1, 1), 1), machines=replace(NOMINAL, cars=(heavier,)))
    tyres = tyres_of(physics.model)
    np.testing.assert_allclose(
        physics.model.geom_user[tyres, ACROSS], 2 * CAR.friction_across, rtol=1e-9
    )


def test_a_wall_beside_a_car_touches_the_flanks_of_its_wheels():
    """They are at 0.083 + 0.043 / 2 m, where the sphere of a tyre reaches 0.1326 m. Band: 0.6 mm: tyres are soft."""
    spec = machine_spec("smartcar", NOMINAL)
    flank_m = CAR.wheel_y_m + CAR.wheel_width_m / 2
    wall = spec.worldbody.add_geom(
        name="wall", type=mujoco.mjtGeom.mjGEOM_BOX, size=[1.0, 0.1, 0.5]
    )
    wall.pos = [0.0, flank_m + 0.05 + 0.1, 0.5]
    wall.contype, wall.conaffinity = TOUCHES["things"].values()
    model = spec.compile()
    data = mujoco.MjData(model)
    data.ctrl[:4] = 3.0 * np.array([-1, 1, 1, -1])
    touching = set()
    for _ in range(400):
        mujoco.mj_step(model, data)
        for pair in data.contact.geom:
            names = {model.geom(geom).name for geom in pair}
            if "wall" in names:
                touching |= names
    assert data.qpos[1] == pytest.approx(0.05, abs=6e-4)
    assert touching == {"wall", "guard_fl", "guard_rl"}


def test_a_tyre_gives_way_by_what_is_derived_and_grips_as_the_ground_does():
    """A quarter of the car presses it in as Hertz has it for a roller of polyurethane. Band: 10 %.

    With E = 90 MPa and Poisson's ratio 0.5; the roller curves by its own radius, and along its axis, at 45 degrees on
    the wheel, by twice the wheel's. Friction has the ground's time constant.
    """
    quarter_n = CAR.mass_kg * GRAVITY / 4
    modulus_pa = 90e6 / (1 - 0.5**2)
    radius_m = math.sqrt(CAR.roller_radius_m * 2 * CAR.wheel_radius_m)
    hertz_m = (9 * quarter_n**2 / (16 * modulus_pa**2 * radius_m)) ** (1 / 3)
    assert hertz_m == pytest.approx(0.095e-3, rel=0.02)
    spec = machine_spec("smartcar", NOMINAL)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 500)
    tyres = [model.geom(f"tyre_{corner}").id for corner in ("fl", "fr", "rl", "rr")]
    assert sorted(data.contact.geom2) == sorted(tyres)
    for contact in data.contact:
        assert contact.dist == pytest.approx(-hertz_m, rel=0.1)
        assert contact.solref[0] == pytest.approx(CAR.tyre_time_constant_s, rel=1e-5)
        assert contact.solreffriction[0] == NOMINAL.contact.time_constant_s
