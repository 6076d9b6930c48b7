"""Exported URDF in PyBullet, a simulator with other contacts: machines fall, slide, drive and fold as they do here."""

import csv
import math
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from craftsim.cli import main
from craftsim.mjcf.car import WHEELS
from craftsim.mjcf.machines import NOMINAL
from craftsim.models.composition import machine_spec
from craftsim.models.exporting import write_urdf

# The extra dev installs it where there are wheels: for Python 3.11 on Linux.
pybullet = pytest.importorskip("pybullet")

GRAVITY = 9.81
STEP_S = 0.002
ROLLERS = replace(NOMINAL, drive="rollers")
CAR, BLOCK, SLOPE = NOMINAL.car(0), NOMINAL.block, NOMINAL.slope


@contextmanager
def floor(incline_rad=0.0):
    """Make a floor whose friction is 1, so that a product of frictions is that of the machine, and tilt gravity."""
    client = pybullet.connect(pybullet.DIRECT)
    try:
        pybullet.setTimeStep(STEP_S)
        pybullet.setGravity(GRAVITY * math.sin(incline_rad), 0.0, -GRAVITY * math.cos(incline_rad))
        plane = pybullet.createMultiBody(0, pybullet.createCollisionShape(pybullet.GEOM_PLANE))
        pybullet.changeDynamics(plane, -1, lateralFriction=1.0)
        yield
    finally:
        pybullet.disconnect(client)


def load(path, height_m=0.0):
    # Otherwise PyBullet takes inertias from shapes.
    return pybullet.loadURDF(
        str(path), [0.0, 0.0, height_m], flags=pybullet.URDF_USE_INERTIA_FROM_FILE
    )


def run(time_s):
    for _ in range(round(time_s / STEP_S)):
        pybullet.stepSimulation()


def origin(machine):
    """Return position and rotation matrix of a machine's frame; PyBullet's own base is at the centre of mass."""
    place, turn = pybullet.getBasePositionAndOrientation(machine)
    local = pybullet.getDynamicsInfo(machine, -1)[3:5]
    place, turn = pybullet.multiplyTransforms(place, turn, *pybullet.invertTransform(*local))
    return np.array(place), np.array(pybullet.getMatrixFromQuaternion(turn)).reshape(3, 3)


def joints_of(machine):
    count = pybullet.getNumJoints(machine)
    return {pybullet.getJointInfo(machine, k)[1].decode(): k for k in range(count)}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("urdf")
    return {
        name: write_urdf(folder / f"{name}.urdf", machine_spec(name, ROLLERS))[0]
        for name in ("smartcar", "block", "slope", "wall")
    }


@pytest.mark.parametrize("name", ["smartcar", "block", "slope"])
def test_a_machine_is_free_falls_and_stands(name, files):
    with floor():
        machine = load(files[name], height_m=0.05)
        masses = [
            pybullet.getDynamicsInfo(machine, k)[0]
            for k in range(-1, pybullet.getNumJoints(machine))
        ]
        model = machine_spec(name, ROLLERS).compile()
        assert masses == pytest.approx(model.body_mass[1:].tolist())
        run(0.06)
        assert origin(machine)[0][2] == pytest.approx(0.05 - GRAVITY * 0.06**2 / 2, abs=1e-3)
        run(1.0)
        place, axes = origin(machine)
        assert place == pytest.approx([0.0, 0.0, 0.0], abs=2e-3)
        assert axes[2, 2] > math.cos(0.01)


def test_a_wall_is_fixed(files):
    with floor():
        wall = load(files["wall"], height_m=0.05)
        run(0.5)
        place, _ = pybullet.getBasePositionAndOrientation(wall)
        assert place == pytest.approx([0.0, 0.0, 0.05])


@pytest.mark.parametrize(
    ("name", "mu"),
    [("block", BLOCK.foot_friction), ("slope", SLOPE.friction)],
    ids=["block", "slope"],
)
def test_a_thing_slides_beyond_atan_mu_as_fast_as_coulomb_has_it(name, mu, files):
    time_s = 1.5
    for share in (0.95, 1.05):
        angle = math.atan(mu) * share
        with floor(angle):
            thing = load(files[name])
            run(0.5)
            before, _ = origin(thing)
            speed = pybullet.getBaseVelocity(thing)[0][0]
            run(time_s)
            slid = origin(thing)[0][0] - before[0]
        if share < 1:
            assert abs(slid) < 1e-3
        else:
            acceleration = GRAVITY * (math.sin(angle) - mu * math.cos(angle))
            assert slid == pytest.approx(speed * time_s + acceleration * time_s**2 / 2, rel=0.05)


DRIVES = {
    "forward": ((1, 1, 1, 1), (1.0, 0.0)),
    "backward": ((-1, -1, -1, -1), (-1.0, 0.0)),
    "left": ((-1, 1, 1, -1), (0.0, 1.0)),
    "right": ((1, -1, -1, 1), (0.0, -1.0)),
}


@pytest.mark.parametrize("way", DRIVES)
def test_a_car_drives_forward_and_sideways_on_its_rollers(way, files):
    signs, direction = DRIVES[way]
    speed_rad_s, time_s = 4.0, 2.0
    with floor():
        car = load(files["smartcar"], height_m=0.002)
        joints = joints_of(car)
        for name, joint in joints.items():
            if name.startswith("roller"):
                pybullet.setJointMotorControl2(car, joint, pybullet.VELOCITY_CONTROL, force=0)
        run(0.3)
        before, _ = origin(car)
        for wheel, sign in zip(WHEELS, signs, strict=True):
            pybullet.setJointMotorControl2(
                car,
                joints[wheel],
                pybullet.VELOCITY_CONTROL,
                targetVelocity=sign * speed_rad_s,
                force=CAR.wheel_torque_nm,
            )
        run(time_s)
        after, axes = origin(car)
    # Rollers turn with friction, and a wheel stands between two of them: some of the way is lost, sideways most.
    expected = CAR.wheel_radius_m * speed_rad_s * time_s
    moved = (after - before)[:2]
    assert moved @ direction == pytest.approx(expected, rel=0.1)
    assert np.hypot(*(moved - (moved @ direction) * np.array(direction))) < 0.05 * expected
    assert axes[0, 0] > math.cos(0.05)
    assert abs(after[2] - before[2]) < 2e-3


def test_board_and_hinge_move_within_their_limits(files):
    with floor():
        car, slope = load(files["smartcar"], height_m=0.002), load(files["slope"])
        for machine, kind, name in ((car, "smartcar", "board"), (slope, "slope", "hinge")):
            info = pybullet.getJointInfo(machine, joints_of(machine)[name])
            low, high = machine_spec(kind, NOMINAL).compile().joint(name).range
            assert info[8:10] == pytest.approx((low, high), abs=1e-6)
        assert pybullet.getJointInfo(car, joints_of(car)["board"])[10] == pytest.approx(
            CAR.board_force_n
        )
        pybullet.removeBody(slope)
        board = joints_of(car)["board"]
        pybullet.setJointMotorControl2(
            car,
            board,
            pybullet.VELOCITY_CONTROL,
            targetVelocity=CAR.board_speed_m_s,
            force=CAR.board_force_n,
        )
        run(CAR.board_travel_m / CAR.board_speed_m_s + 0.5)
        assert pybullet.getJointState(car, board)[0] == pytest.approx(CAR.board_travel_m, abs=2e-3)


def test_a_world_is_loaded_by_its_table(tmp_path, capsys):
    assert main(["show", "strip", "--export", str(tmp_path / "strip.urdf")]) == 0
    capsys.readouterr()
    with (tmp_path / "strip.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 6
    with floor():
        for row in rows:
            place = [float(row[name]) for name in ("x_m", "y_m", "z_m")]
            turn = pybullet.getQuaternionFromEuler(
                [float(row[f"{n}_rad"]) for n in ("roll", "pitch", "yaw")]
            )
            thing = pybullet.loadURDF(
                str(tmp_path / row["file"]), flags=pybullet.URDF_USE_INERTIA_FROM_FILE
            )
            local = pybullet.getDynamicsInfo(thing, -1)[3:5]
            pybullet.resetBasePositionAndOrientation(
                thing, *pybullet.multiplyTransforms(place, turn, *local)
            )
            row |= {"thing": thing, "place": place}
        run(0.5)
        for row in rows:
            at, axes = origin(row["thing"])
            assert at == pytest.approx(row["place"], abs=3e-3), row["file"]
            assert axes[2, 2] > math.cos(0.01)
