"""Cameras show all of the area, fill the picture with it, and move smoothly."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from recorded import record

from craftsim import Trajectory
from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.errors import InputError
from craftsim.models.framing import MARGIN, box_corners, overview, top
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


def test_all_corners_are_in_the_picture_with_a_margin_and_fill_it():
    for fit in (overview, top):
        for levels in (1, 5):
            for aspect in ASPECTS:
                for area in AREAS:
                    height = levels * LEVEL_HEIGHT_M
                    seen = fit(area, height, aspect).project(box_corners(area, height), aspect)
                    assert np.abs(seen).max() == pytest.approx(1 - 2 * MARGIN, abs=1e-9)
                    assert _fills(seen) > 0.9


def test_with_the_coordinates_beside_it_an_area_still_fills_the_picture():
    for fit in (overview, top):
        for aspect in ASPECTS:
            for area in AREAS:
                strip = label_strip_m(*area)
                aim = fit(area, LEVEL_HEIGHT_M, aspect, strip)
                seen = aim.project(box_corners(area, LEVEL_HEIGHT_M), aspect)
                assert np.abs(seen).max() < 1 - 2 * MARGIN + 1e-9
                assert _fills(seen) > 0.8
                half = 0.5 * CELL_PITCH_M
                labels = [(half, -strip, 0.0), (area[0] * CELL_PITCH_M + strip, half, 0.0)]
                assert np.abs(aim.project(labels, aspect)).max() < 1 - MARGIN


def test_overview_shows_no_sky():
    for aspect in ASPECTS:
        aim = overview((20, 10), LEVEL_HEIGHT_M, aspect)
        assert aim.elevation_deg + aim.fovy_deg / 2 < -10


def test_a_projection_is_that_of_mujocos_camera(turning):
    seen = SeenWorld(PhysicsWorld(Grid.empty((3, 5, 2), n_cars=1)))
    model, shown = seen.model, seen.at(seen.model.qpos0)
    for name, fit in (("overview", overview), ("top", top)):
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
    mujoco.mjv_updateScene(turning.model, data, mujoco.MjvOption(), None, view.camera(0.0), everything, scene)
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
    assert np.abs(np.diff(azimuth) / np.diff(times)).max() < 40  # degrees a second; the car itself makes 200
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


def test_an_unknown_camera_is_refused_with_those_there_are(turning):
    with pytest.raises(InputError, match=r"unknown camera 'folow:0'; did you mean 'follow:0'.*closeup:CAR"):
        make_view("folow:0", turning, 1.0)
    with pytest.raises(InputError, match=r"no car '3'; allowed: 0"):
        make_view("closeup:3", turning, 1.0)


def test_a_camera_comes_from_a_file(turning, tmp_path: Path):
    file = tmp_path / "mine.yaml"
    file.write_text("{lookat: [0.1, 0.2, 0.3], distance: 2, azimuth: 45, elevation: -30}")
    assert make_view(str(file), turning, 1.0).camera(0.0).lookat == pytest.approx([0.1, 0.2, 0.3])
    for text, message in (
        (
            "{lookat: [0, 0], distance: 2, azimuth: 45, elevation: -30}",
            "mine.yaml:1: key 'lookat': must be a list of 3 entries",
        ),
        (
            "{lookat: [0, 0, 0], azimuth: 45, elevation: -30}",
            "key 'distance' is missing; required: lookat, distance",
        ),
        (
            "{lookat: [0, 0, 0], distance: 0, azimuth: 45, elevation: -30}",
            "key 'distance': 0 is out of range, allowed: 0.05 to",
        ),
        (
            "{lookat: [0, 0, x], distance: 1, azimuth: 45, elevation: -30}",
            r"key 'lookat\[2\]': must be a number",
        ),
        ("{look: [0, 0, 0]}", "unknown key 'look'; did you mean 'lookat'"),
    ):
        file.write_text(text)
        with pytest.raises(InputError, match=message):
            make_view(str(file), turning, 1.0)
