"""Recordings are read strictly: whatever is wrong is named, with the file and what is allowed."""

import numpy as np
import pytest
from reality.made import CUBE, ROBOT, drive_arrays, toss_arrays, written

from craftsim.cli import main
from craftsim.errors import InputError
from craftsim.mjcf.machines import NOMINAL
from craftsim.reality.recordings import DriveRecording, Tosses, about, read_recording


@pytest.fixture(scope="module")
def tosses():
    return toss_arrays(0.18, n=4)


@pytest.fixture(scope="module")
def drive():
    return drive_arrays(4.0)


def test_what_a_file_holds_decides_what_it_is(tmp_path, tosses, drive):
    read = read_recording(written(tmp_path / "a.npz", tosses))
    assert isinstance(read, Tosses)
    assert (len(read.states), read.cube) == (4, CUBE)
    assert about(read)["tosses"] == 4
    read = read_recording(written(tmp_path / "b.npz", drive))
    assert isinstance(read, DriveRecording)
    car = read.machines.car(0)
    assert (car.wheel_radius_m, car.turn_radius_m) == (ROBOT.wheel_radius_m, read.lever_m)
    assert about(read)["with_pose"] > 0.95


def test_single_numbers_in_a_file_replace_those_of_the_published_sets(tmp_path, tosses, drive):
    more = {**tosses, "friction": np.array(0.3), "half_width_m": np.array([0.1])}
    read = read_recording(written(tmp_path / "a.npz", more))
    assert (read.cube.friction, read.cube.half_width_m) == (0.3, 0.1)
    assert read.states[0][0, 2] == pytest.approx(0.1 * tosses["states"][0, 2])
    more = {**drive, "wheel_radius_m": np.array(0.05), "ticks_per_turn": np.array(105)}
    other = read_recording(written(tmp_path / "b.npz", more))
    assert other.machines.car(0).wheel_radius_m == 0.05
    read = read_recording(written(tmp_path / "c.npz", drive))
    assert other.angles == pytest.approx(2 * read.angles)


def test_encoders_and_poses_are_read_as_they_were_made(tmp_path, drive):
    read = read_recording(written(tmp_path / "a.npz", drive))
    ticks = drive["wheels"][:, 2:6] - drive["wheels"][0, 2:6]
    turned = ticks * 2 * np.pi / ROBOT.ticks_per_turn
    rows = min(len(turned), len(read.angles)) - 10
    assert read.angles[10:rows] == pytest.approx(turned[10:rows], abs=0.02)
    last = np.flatnonzero(np.isfinite(read.log.pose).all(axis=1))[-1]
    at = np.searchsorted(drive["pose"][:, 1], read.log.time_s[last])
    assert read.log.pose[last, :2] == pytest.approx(drive["pose"][at, 2:4], abs=0.003)


def _changed(arrays, name, change):
    copied = {key: value.copy() for key, value in arrays.items()}
    changed = change(copied[name])
    if changed is not None:
        copied[name] = changed
    return copied


def _put(value, *place):
    def change(array):
        array[place] = value

    return change


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("states", lambda a: a[:, :12], "'states' has shape (280, 12); allowed: (n, 13)"),
        ("states", lambda a: a[:-1], "'length' sums up to 280 rows, and 'states' has 279"),
        ("states", _put(np.nan, 7, 2), "'states' is nan in row 7, column 2"),
        ("states", _put(1e6, 7, 2), "'states' is 1e+06 in row 7; allowed: -1000 to 1000"),
        ("states", _put(0.4, 7, slice(3, 7)), "in row 7 has length 0.8"),
        ("length", lambda a: a.astype(float), "'length' is of float64"),
        ("length", lambda a: a[:2], "2 tosses; allowed: 4 or more"),
        ("length", _put(3, 1), "'length' of toss 1 is 3; allowed: 10 to 10000 rows"),
        ("length", _put(-70, 1), "'length' of toss 1 is -70"),
    ],
)
def test_bad_tosses_are_refused(name, change, words, tmp_path, tosses):
    path = written(tmp_path / "bad.npz", _changed(tosses, name, change))
    with pytest.raises(InputError) as raised:
        read_recording(path)
    assert words in str(raised.value)
    assert str(path) in str(raised.value)


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("wheels", lambda a: a[:, :5], "'wheels' has shape (200, 5); allowed: (n, 6)"),
        ("wheels", lambda a: a[:20], "'wheels' has 20 rows; allowed: 50 or more"),
        ("wheels", _put(np.inf, 3, 4), "'wheels' is inf in row 3, column 4"),
        ("wheels", _put(1e12, 3, 4), "'wheels' is 1e+12 in row 3"),
        ("wheels", _put(0.0, 9, 1), "was measured at 0 s in row 9, before the row above"),
        ("wheels", _put(1e5, -1, 1), "were measured together"),
        ("pose", _put(0.0, 5, slice(5, 9)), "the quaternion of 'pose' in row 5 has length 0"),
        ("pose", _put(2e3, 5, 2), "'pose' is 2000 in row 5; allowed: -1000 to 1000 m"),
    ],
)
def test_bad_drives_are_refused(name, change, words, tmp_path, drive):
    arrays = _changed(drive, name, change)
    if "together" in words:
        arrays["pose"][:, 1] += 1e6
    path = written(tmp_path / "bad.npz", arrays)
    with pytest.raises(InputError) as raised:
        read_recording(path)
    assert words in str(raised.value)
    assert str(path) in str(raised.value)


def test_other_arrays_and_numbers_out_of_range_are_refused(tmp_path, tosses, drive):
    for arrays, words in [
        ({"steps": np.zeros(3)}, "no recording: it holds steps; allowed: 'states' and 'length'"),
        (
            {**tosses, "frictoin": np.array(0.2)},
            "unknown array 'frictoin'; did you mean 'friction'?; allowed: rate_hz",
        ),
        ({**tosses, "friction": np.array([0.2, 0.3])}, "'friction' has shape (2,)"),
        ({**tosses, "mass_kg": np.array(-1.0)}, "mass_kg"),
        ({**drive, "wheel_radius_m": np.array(np.nan)}, "wheel_radius_m"),
    ]:
        with pytest.raises(InputError) as raised:
            read_recording(written(tmp_path / "bad.npz", arrays))
        assert words in str(raised.value)


def test_a_log_without_poses_or_of_a_moment_is_no_drive(tmp_path):
    head = "time_s,cmd_wheel_fl_rad_s,cmd_wheel_fr_rad_s,cmd_wheel_rl_rad_s,cmd_wheel_rr_rad_s"
    rows = [f"{0.02 * row:.2f},1,1,1,1" for row in range(100)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([head, *rows]))
    with pytest.raises(InputError, match="no poses"):
        read_recording(path)
    path.write_text("\n".join([head, *rows[:20]]))
    with pytest.raises(InputError, match="at least 1 s"):
        read_recording(path)


def test_speeds_of_a_log_are_those_that_were_measured_and_else_the_commands(tmp_path):
    wheels = ("wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr")
    names = ["time_s", *(f"cmd_{wheel}_rad_s" for wheel in wheels), "x_m", "y_m", "heading_rad"]
    rows = [[0.02 * row, 2, 2, 2, 2, 0.001 * row, 0, 0] for row in range(100)]
    path = tmp_path / "log.csv"
    for more, speed in (([], 2.0), ([f"{wheel}_rad_s" for wheel in wheels], 1.5)):
        lines = [",".join([*names, *more])]
        lines += [",".join(map(str, [*row, *[1.5] * len(more)])) for row in rows]
        path.write_text("\n".join(lines))
        read = read_recording(path, NOMINAL)
        assert read.log.commands[:-1, :4] == pytest.approx(speed)
        assert read.machines.car(0).wheel_radius_m == NOMINAL.car(0).wheel_radius_m


def test_bad_input_ends_with_status_2(tmp_path, drive, capsys):
    path = written(tmp_path / "short.npz", drive)
    out = str(tmp_path / "out")
    assert main(["reality", "--out", out]) == 2
    assert "no recordings given" in capsys.readouterr().err
    assert main(["reality", str(path), "--out", out]) == 2
    assert "at least 20 s" in capsys.readouterr().err
    assert main(["reality", str(tmp_path / "gone.npz"), "--out", out]) == 2
    assert "no such file" in capsys.readouterr().err
    other = written(tmp_path / "other.npz", {**drive, "wheel_radius_m": np.array(0.05)})
    assert main(["reality", str(path), str(other), "--out", out]) == 2
    assert "of another robot" in capsys.readouterr().err
