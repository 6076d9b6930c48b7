"""Kinematics have their closed form, and hidden faults of a robot are found in its drives."""

from dataclasses import replace

import numpy as np
import pytest
from reality.made import ROBOT, drive_arrays, written

from craftsim.reality import driving
from craftsim.reality.driving import (
    Kinematics,
    Mounting,
    effective_figures,
    evaluate_drives,
    fit_kinematics,
    halves,
    robot_poses,
    travelled,
    window_starts,
)
from craftsim.reality.recordings import PERIOD_S, joined_log, read_recording

LEVER_M = ROBOT.half_track_m + ROBOT.half_wheelbase_m
NOMINAL = Kinematics(np.full(4, ROBOT.wheel_radius_m), LEVER_M)
TIME_S = 30.0


def _drives(folder, time_s=TIME_S, **options):
    return [
        read_recording(written(folder / f"{seed}.npz", drive_arrays(time_s, seed, **options)))
        for seed in (0, 1)
    ]


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    return _drives(tmp_path_factory.mktemp("drives"))


def test_ideal_kinematics_go_along_a_circle_and_to_the_side():
    angles = np.linspace(0, 1, 501)[:, None] * [3.0, 5.0, 3.0, 5.0]
    x, y, heading = NOMINAL.poses(angles)[-1]
    turn = ROBOT.wheel_radius_m * 1.0 / LEVER_M
    radius_m = ROBOT.wheel_radius_m * 4.0 / turn
    assert heading == pytest.approx(turn)
    assert (x, y) == pytest.approx((radius_m * np.sin(turn), radius_m * (1 - np.cos(turn))))
    sideways = NOMINAL.poses(np.array([[0.0] * 4, [-2.0, 2.0, 2.0, -2.0]]))[-1]
    assert sideways == pytest.approx([0.0, 2 * ROBOT.wheel_radius_m, 0.0])


def test_ways_are_in_the_frame_in_which_a_window_begins():
    poses = np.array([[1.0, 2.0, np.pi / 2], [1.0, 3.0, np.pi / 2], [0.5, 3.0, 2.0]])
    ways = travelled(poses, np.array([0, 1]), 1)
    assert ways == pytest.approx(np.array([[1.0, 0, 0], [0, 0.5, 2.0 - np.pi / 2]]))


def test_windows_begin_and_end_where_poses_are_known():
    poses = np.zeros((12, 3))
    poses[[0, 5]] = np.nan
    assert window_starts(poses, 4).tolist() == [2, 6]


def test_a_good_robot_is_not_doubted_and_its_figures_are_found(drives):
    fit = fit_kinematics(drives, each_wheel=True)
    assert fit.kinematics.radii_m == pytest.approx([ROBOT.wheel_radius_m] * 4, rel=0.006)
    assert fit.kinematics.lever_m == pytest.approx(LEVER_M, rel=0.006)
    figures = effective_figures(drives[0], Mounting(), np.random.default_rng(0))
    assert figures["forward_m"].low - 2e-4 < ROBOT.wheel_radius_m < figures["forward_m"].high + 2e-4
    assert figures["turning"].value == pytest.approx(ROBOT.wheel_radius_m / LEVER_M, rel=0.006)


def test_a_turned_marker_off_the_middle_is_found(drives):
    place = Mounting(-0.04, 0.02, -0.03)
    moved = []
    for recording in drives:
        poses = robot_poses(recording, Mounting())
        cos = np.cos(poses[:, 2])
        sin = np.sin(poses[:, 2])
        poses[:, 0] += cos * place.marker_x_m - sin * place.marker_y_m
        poses[:, 1] += sin * place.marker_x_m + cos * place.marker_y_m
        poses[:, 2] += place.heading_bias_rad
        moved.append(replace(recording, log=replace(recording.log, pose=poses)))
        assert robot_poses(moved[-1], place) == pytest.approx(recording.log.pose, nan_ok=True)
    found = fit_kinematics(moved, each_wheel=False).mounting
    assert found == pytest.approx(place, abs=0.004)


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ({}, []),
        pytest.param(
            {"radius_m": 0.97 * ROBOT.wheel_radius_m},
            ["forward", "sideways", "turn a wheel"],
            marks=pytest.mark.slow,
        ),
        ({"shares": (0.97, 1, 1, 1)}, ["radius of wheel_fl", "turn on a way forward"]),
    ],
)
def test_wheels_that_are_smaller_are_found(options, found, tmp_path, monkeypatch):
    # The search of a friction that makes no difference takes most of the time.
    fast = [key for key in driving.IDENTIFIED if key != "smartcar.roller_friction"]
    monkeypatch.setattr(driving, "IDENTIFIED", fast)
    figures = evaluate_drives(_drives(tmp_path, **options), 0, lambda *_: None)
    differences = figures["differences"]
    assert bool(differences) is bool(found)
    for words in found:
        assert any(words in text for text in differences), (words, differences)
    identified = figures["identified"]["estimates"]["smartcar.wheel_radius_m"]
    if "shares" not in options:
        true_m = options.get("radius_m", ROBOT.wheel_radius_m)
        assert identified["value"] == pytest.approx(true_m, rel=0.004)
    sideways = {
        name: rows[0]["sideways_over_forward"].value for name, rows in figures["effective"].items()
    }
    assert sideways["wheels"] == pytest.approx(1.0, abs=0.01)
    assert sideways["rollers"] < 0.99


def test_the_lean_of_the_floor_in_the_recording_makes_no_difference(tmp_path, drives):
    leaning = _drives(tmp_path, lean=0.1)
    for level, recording in zip(drives, leaning, strict=True):
        ways = []
        for one in (level, recording):
            starts = window_starts(one.log.pose, 50)
            ways.append(travelled(one.log.pose, starts, 50))
        assert ways[0] == pytest.approx(ways[1], abs=0.004)


def test_what_motion_capture_repeats_is_no_measurement(tmp_path):
    arrays = drive_arrays(8.0)
    rows = slice(400, 500)
    arrays["pose"][rows, 2:] = arrays["pose"][400, 2:]
    recording = read_recording(written(tmp_path / "frozen.npz", arrays))
    at = recording.log.time_s
    frozen_s = arrays["pose"][400, 1], arrays["pose"][499, 1]
    inside = (at > frozen_s[0] + 0.02) & (at < frozen_s[1] - 0.02)
    assert np.isnan(recording.log.pose[inside]).all()
    assert np.isfinite(recording.log.pose[~inside]).mean() > 0.95


def test_halves_share_a_drive_and_a_rest_lies_between_joined_drives(drives):
    first, second = halves(drives[0])
    assert len(first.log) + len(second.log) == len(drives[0].log)
    log = joined_log([first.log, second.log], 2.0)
    assert len(log) == len(drives[0].log) + 2 * round(2.0 / PERIOD_S)
    rest = slice(len(first.log), len(first.log) + round(2.0 / PERIOD_S))
    assert not log.commands[rest].any()
    assert np.isnan(log.pose[rest]).all()
