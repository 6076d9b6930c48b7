"""Each part opens alone, has the shape that its comments promise, and survives random control."""

from importlib.resources import as_file, files

import mujoco
import numpy as np
import pytest

from craftsim.discrete.files.blueprint import read_blueprint
from craftsim.mjcf.parameters import NOMINAL
from craftsim.models.world import PhysicsWorld

SMARTCAR = NOMINAL.cars[0]

PARTS = ("ground", "block", "flag", "wall", "slope", "smartcar")


def control_randomly(model: mujoco.MjModel, data: mujoco.MjData, seed: int, warned) -> None:
    """Run 1 s; every 20 ms each motor gets a new command from its whole range."""
    rng = np.random.default_rng(seed)
    low, high = model.actuator_ctrlrange.T
    for _ in range(50):
        data.ctrl[:] = rng.uniform(low, high)
        mujoco.mj_step(model, data, round(0.02 / model.opt.timestep))
    assert {name: n for name, n in warned(data).items() if n} == {}
    for array in (data.qpos, data.qvel, data.qacc):
        assert np.isfinite(array).all()
    assert np.abs(data.qvel).max(initial=0) < 1e3


def test_each_part_opens_alone_rests_where_it_is_drawn_and_survives_random_control(open_part, warned):
    """No part starts in the air or in the floor: within 1 s of rest nothing moves by more than 0.1 mm."""
    for seed, name in enumerate(PARTS):
        model = open_part(name)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        start = data.xpos.copy()
        mujoco.mj_step(model, data, 250)
        assert np.abs(data.xpos - start).max() < 1e-4
        control_randomly(model, data, seed, warned)


def test_the_demo_scene_survives_random_control(warned):
    with as_file(files("craftsim.data")) as data:
        drawing = read_blueprint(data / "blueprints" / "simple_two_story.yaml")
    physics = PhysicsWorld(drawing.grid(np.random.default_rng(0)), goals=[(2, 3, 1)])
    control_randomly(physics.model, physics.data, 0, warned)


def test_ten_rollers_a_wheel_in_x_arrangement_turn_freely_and_alone_carry_the_car(open_part):
    """Seen from above the upper rollers point at the car's centre; those on the ground lie across that line.

    On the floor a resting car touches the ground with one roller of each wheel or two, and with nothing else.
    """
    model = open_part("smartcar")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for wheel in ("fl", "fr", "rl", "rr"):
        names = [f"roller_{wheel}{i:02}" for i in range(10)]
        angles = np.sort([np.arctan2(p[0], p[2]) % (2 * np.pi) for p in (model.body(n).pos for n in names)])
        assert np.diff(angles) == pytest.approx(2 * np.pi / 10, abs=1e-6)
        rollers = [data.joint(name) for name in names]
        corner = np.sign(model.body(f"wheel_{wheel}").pos[:2]) / np.sqrt(2)
        bottom, *_, top = sorted(rollers, key=lambda roller: roller.xanchor[2])
        assert abs(top.xaxis[:2] @ corner) == pytest.approx(1, abs=1e-6)
        assert bottom.xaxis[:2] @ corner == pytest.approx(0, abs=1e-6)
        assert bottom.xanchor[2] == pytest.approx(SMARTCAR.roller_radius_m, abs=1e-9)
        for joint in map(model.joint, names):
            assert not joint.limited[0]
            assert model.dof_frictionloss[joint.dofadr[0]] == SMARTCAR.roller_bearing_friction_nm
            assert joint.id not in model.actuator_trnid[:, 0]
    mujoco.mj_step(model, data, 100)
    touching = {model.geom(g).name for g in data.contact.geom.flat} - {"ground"}
    assert {name[:9] for name in touching} == {f"roller_{w}" for w in ("fl", "fr", "rl", "rr")}
