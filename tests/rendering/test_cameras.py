"""Cameras show all of the area, fill the picture with it, and move smoothly."""

import itertools
from pathlib import Path

import mujoco
import numpy as np
import pytest
from rendering.recorded import record

from craftsim import Trajectory
from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.errors import InputError
from craftsim.models.cameras import MARGIN, box_corners, overview_aim, top
from craftsim.models.world import PhysicsWorld
from craftsim.rendering.cameras import label_strip_m, make_view, reached_m
from craftsim.rendering.trajectory import SeenWorld

AREAS = [(1, 1), (1, 8), (20, 10), (3, 12), (4, 4)]
ASPECTS = [16 / 9, 4 / 3, 1.0, 9 / 16]


@pytest.fixture(scope="module")
def turning() -> Trajectory:
    return record(Grid.empty((4, 2, 2), n_cars=1), Action.ROTATE_LEFT, Action.MOVE_LEFT)


def _fills(seen: np.ndarray) -> float:
    """Return the share of the picture that points fill in the direction in which they fill more of it."""
    return float((seen.max(axis=0) - seen.min(axis=0)).max() / 2)


def test_an_area_fills_the_picture_with_a_margin_with_and_without_its_coordinates_and_without_sky():
    half = 0.5 * CELL_PITCH_M
    for fit, levels, aspect, area in itertools.product((overview_aim, top), (1, 5), ASPECTS, AREAS):
        height, strip = levels * LEVEL_HEIGHT_M, label_strip_m(*area)
        corners = box_corners(area, height)
        seen = fit(area, height, aspect).project(corners, aspect)
        assert np.abs(seen).max() == pytest.approx(1 - 2 * MARGIN, abs=1e-9)
        assert _fills(seen) > 0.9
        aim = fit(area, height, aspect, strip)
        seen = aim.project(corners, aspect)
        assert np.abs(seen).max() < 1 - 2 * MARGIN + 1e-9
        assert levels > 1 or _fills(seen) > 0.8
        labels = [(half, -strip, 0.0), (area[0] * CELL_PITCH_M + strip, half, 0.0)]
        assert np.abs(aim.project(labels, aspect)).max() < 1 - MARGIN
        assert aim.elevation_deg + aim.fovy_deg / 2 < -10


def test_a_projection_is_that_of_mujocos_camera(turning):
    seen = SeenWorld(PhysicsWorld(Grid.empty((3, 5, 2), n_cars=1)))
    model, shown = seen.model, seen.at(seen.model.qpos0)
    for name, fit in (("overview", overview_aim), ("top", top)):
        aim, number = fit((3, 5), 2 * LEVEL_HEIGHT_M, 4 / 3), model.camera(name).id
        assert shown.cam_xpos[number] == pytest.approx(aim.position)
        axes = shown.cam_xmat[number].reshape(3, 3)
        assert axes == pytest.approx(aim.axes, abs=1e-9)
        assert model.cam_fovy[number] == pytest.approx(aim.fovy_deg)
    view = make_view("overview", turning, 1.5)
    scene = mujoco.MjvScene(turning.model, 1000)
    data = mujoco.MjData(turning.model)
    mujoco.mj_forward(turning.model, data)
    turning.model.vis.global_.fovy = view.fovy_deg
    everything = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(
        turning.model, data, mujoco.MjvOption(), None, view.camera(0.0), everything, scene
    )
    eyes = np.mean([scene.camera[0].pos, scene.camera[1].pos], axis=0)
    assert eyes == pytest.approx(view.aim(0.0).position, abs=1e-5)
    assert scene.camera[0].forward == pytest.approx(-view.aim(0.0).axes[:, 2], abs=1e-5)
    assert scene.camera[0].up == pytest.approx(view.aim(0.0).axes[:, 1], abs=1e-5)


def test_an_orbit_shows_all_corners_from_every_side(turning):
    size, view = turning.story.recipe.grid.size, make_view("orbit", turning, 16 / 9)
    corners = box_corners(size, reached_m(turning))
    fills = []
    for time_s in np.linspace(0.0, 60.0, 60):
        seen = view.aim(time_s).project(corners, 16 / 9)
        assert np.abs(seen).max() <= 1 - 2 * MARGIN + 1e-9
        fills.append(_fills(seen))
    assert max(fills) > 0.8
    turned = view.aim(60.0 + turning.time[0]).azimuth_deg - view.aim(turning.time[0]).azimuth_deg
    assert turned == pytest.approx(360.0)


def test_a_camera_that_follows_stays_behind_its_car_and_turns_slowly(turning):
    view, times = make_view("follow:0", turning, 16 / 9), turning.time
    aims = [view.aim(time_s) for time_s in times]
    places = turning.pose("car 0")[:, :2]
    for aim, (x, y) in zip(aims, places, strict=True):
        assert np.abs(aim.project([(x, y, 0.05)], 16 / 9)).max() < 0.5
    azimuth = np.array([aim.azimuth_deg for aim in aims])
    assert azimuth[-1] - azimuth[0] > 15  # of 90: the trajectory is about as short as the low-pass
    assert (
        np.abs(np.diff(azimuth) / np.diff(times)).max() < 40
    )  # degrees a second; the car itself makes 200
    assert np.abs(np.diff(azimuth, 2)).max() < 0.05


def test_a_car_is_seen_from_where_nothing_hides_it(turning):
    view, car = make_view("closeup:0", turning, 16 / 9), turning.physics.cars[0].base.body
    model, data, hit = turning.model, mujoco.MjData(turning.model), np.zeros(1, np.int32)
    for sample in (0, len(turning) - 1):
        data.qpos[:] = turning.qpos[sample]
        mujoco.mj_kinematics(model, data)
        aim = view.aim(float(turning.time[sample]))
        mujoco.mj_ray(model, data, aim.position, aim.lookat - aim.position, None, 1, -1, hit)
        assert model.body_rootid[model.geom_bodyid[hit[0]]] == car
    assert not view.ghost
    assert make_view("follow:0", turning, 16 / 9).ghost


def test_a_camera_comes_from_a_file(turning, tmp_path: Path):
    file = tmp_path / "mine.yaml"
    file.write_text("{lookat: [0.1, 0.2, 0.3], distance: 2, azimuth: 45, elevation: -30}")
    assert make_view(str(file), turning, 1.0).camera(0.0).lookat == pytest.approx([0.1, 0.2, 0.3])
    whole = "lookat: [0, 0, 0], azimuth: 45, elevation: -30"
    for text, message in (
        (
            f"{{{whole.replace('0, 0, 0', '0, 0')}, distance: 2}}",
            "key 'lookat': must be a list of 3 entries",
        ),
        (f"{{{whole}}}", "key 'distance' is missing; required: lookat, distance"),
        (f"{{{whole}, distance: 0}}", "key 'distance': 0 is out of range, allowed: 0.05 to"),
        ("{look: [0, 0, 0]}", "unknown key 'look'; did you mean 'lookat'"),
    ):
        file.write_text(text)
        with pytest.raises(InputError, match=message):
            make_view(str(file), turning, 1.0)
    for text, message in (
        ("folow:0", r"unknown camera 'folow:0'; did you mean 'follow:0'.*closeup:CAR"),
        ("closeup:3", r"no car '3'; allowed: 0"),
    ):
        with pytest.raises(InputError, match=message):
            make_view(text, turning, 1.0)
