"""Bags with numbers that were not measured are logs with gaps; those with numbers that cannot be are refused."""

import copy
import math

import numpy as np
import pytest

pytest.importorskip("mcap_ros2")

from robots.bags import write_bag

from craftsim.errors import InputError
from craftsim.robots.log import GROUPS, Log
from craftsim.robots.log_files import read_log

N = 60
NAN, INF = math.nan, math.inf
TURN = ("w", "x", "y", "z")


def smooth_log():
    """Return the log of a car that drives along a circle, turns several times, and lifts its board."""
    time = 0.02 * np.arange(N)
    groups = {name: np.zeros((N, len(columns))) for name, columns in GROUPS.items()}
    groups["pose"] = np.column_stack([np.cos(time), np.sin(time), 8.0 * time])
    groups["board"] = np.column_stack([0.03 + 0.01 * time, 5.0 + time])
    groups["wheel_speeds"] = np.column_stack([time, 2 * time, 3 * time, 4 * time])
    groups["commands"][:, :4] = 1.0 + groups["wheel_speeds"]
    return Log(time, **groups)


def bag_with(tmp_path, change, rows, topic="/localisation"):
    """Return the path of a bag in which some messages of a topic are changed in place."""

    def alter(of, row, message, at):
        if of == topic and row in rows:
            message = copy.deepcopy(message)
            change(message)
        return [(message, at)]

    return write_bag(tmp_path / "run.mcap", smooth_log(), alter=alter)


def turned(*numbers):
    def change(message):
        message["pose"]["orientation"] = dict(zip(TURN, numbers, strict=True))

    return change


def moved(x, y):
    def change(message):
        message["pose"]["position"] |= {"x": x, "y": y}

    return change


def same_angles(one, other):
    return np.abs(np.angle(np.exp(1j * (one - other)))).max() < 1e-6


@pytest.mark.parametrize(
    "change",
    [
        turned(NAN, NAN, NAN, NAN),
        turned(1, 0, 0, NAN),
        turned(0, 0, 0, 0),
        moved(NAN, 0.0),
        moved(0.0, NAN),
    ],
)
def test_a_pose_that_was_not_measured_is_a_gap_of_its_own_and_counted(change, tmp_path):
    log, rows = smooth_log(), [10]
    read = read_log(bag_with(tmp_path, change, rows))
    # A gap of one pose is interpolated, and nothing else is touched.
    assert np.isfinite(read.pose).all()
    assert np.isfinite(read.tilt).all()
    assert np.abs(read.tilt).max() < 1e-9
    assert np.abs(read.pose[:, :2] - log.pose[:, :2]).max() < 1e-3
    assert same_angles(read.pose[:, 2], log.pose[:, 2])
    columns = "x_m, y_m, heading_rad, pitch_rad, roll_rad"
    assert read.notes == (
        f"/localisation: 1 of 60 messages have no {columns} (nan, or a quaternion of zeros); left out",
    )


def test_a_longer_gap_of_poses_stays_open(tmp_path):
    read = read_log(bag_with(tmp_path, turned(0, 0, 0, 0), range(10, 20)))
    open_rows = np.isnan(read.pose).any(axis=1)
    assert np.flatnonzero(open_rows).tolist() == list(range(10, 20))
    assert np.array_equal(open_rows, np.isnan(read.tilt).any(axis=1))
    assert "10 of 60 messages" in read.notes[0]


def test_a_quaternion_is_normalized_within_the_tolerance_and_refused_beyond(tmp_path):
    half = math.sqrt(0.5)
    for length in (0.9955, 0.9999, 1.0, 1.0045):
        change = turned(length * half, 0, 0, length * half)
        read = read_log(bag_with(tmp_path, change, range(N)))
        assert read.pose[:, 2] == pytest.approx(math.pi / 2, abs=1e-9)
        assert read.notes == ()
    for length, text in (
        (0.5, "0.5"),
        (0.99, "0.99"),
        (1.01, "1.01"),
        (1e-160, "1e-160"),
        (1e200, "1e+200"),
    ):
        with pytest.raises(InputError) as error:
            read_log(bag_with(tmp_path, turned(length * half, 0, length * half, 0), [7]))
        assert str(error.value).endswith(
            "run.mcap: /localisation, message 8 at 1700000000.140 s: the quaternion has the length "
            f"{text}; allowed: 1, within 0.5%"
        )


@pytest.mark.parametrize("angle", [-1.5, -0.4, 0.0, 0.118, 1.55])
def test_pitch_and_roll_are_those_of_the_quaternion(angle, tmp_path):
    c, s = math.cos(angle / 2), math.sin(angle / 2)
    # About the left axis a positive angle lowers the nose; about the forward axis it raises the left side.
    assert read_log(bag_with(tmp_path, turned(c, 0, s, 0), range(N))).tilt[:, 0] == pytest.approx(
        -angle
    )
    assert read_log(bag_with(tmp_path, turned(c, s, 0, 0), range(N))).tilt[:, 1] == pytest.approx(
        angle
    )


def test_a_gap_is_in_terms_of_messages_however_many_have_nothing_measured(tmp_path):
    rows = [row for row in range(N) if row % 12]
    read = read_log(bag_with(tmp_path, turned(0, 0, 0, 0), rows))
    assert np.flatnonzero(np.isfinite(read.pose).all(axis=1)).tolist() == list(range(0, N, 12))
    assert "55 of 60 messages" in read.notes[0]


@pytest.mark.parametrize("change", [moved(INF, 0), moved(INF, -INF), turned(INF, 0, 0, 0)])
def test_an_infinite_pose_is_refused_with_topic_message_and_time(change, tmp_path):
    with pytest.raises(InputError, match=r"/localisation, message 4 at 1700000000\.060 s: .* inf;"):
        read_log(bag_with(tmp_path, change, [3]))


def test_a_pose_beyond_all_that_a_robot_measures_is_refused_with_its_message(tmp_path):
    for x in (1e308, -1e10):
        with pytest.raises(
            InputError, match=r"/localisation, message 4 at .* s: x_m is .*; allowed: numbers up to"
        ):
            read_log(bag_with(tmp_path, moved(x, 0.0), [3]))
    tiny = read_log(bag_with(tmp_path, moved(5e-324, 1e-310), range(N)))
    assert np.abs(tiny.pose[:, :2]).max() < 1e-300


@pytest.mark.parametrize("time_ns", [0, 2**64 - 1])
def test_a_command_of_another_age_is_refused(time_ns, tmp_path):
    def alter(of, row, message, at):
        return [
            (
                message,
                time_ns if of == "/wheel_commands" and row in (0, N - 1)[time_ns > 0 :][:1] else at,
            )
        ]

    with pytest.raises(
        InputError, match=r"time_s rises by .* s to row .*; allowed: 3600 s\. Was the clock set"
    ):
        read_log(write_bag(tmp_path / "run.mcap", smooth_log(), alter=alter))


def joint(field, place, number):
    def change(message):
        message[field] = list(message[field])
        message[field][place] = number

    return change


def test_joints_without_a_sensor_are_not_measured_and_single_values_are_counted(tmp_path):
    log = smooth_log()
    read = read_log(bag_with(tmp_path, joint("effort", 4, NAN), range(N), "/joint_states"))
    assert np.isnan(read.board[:, 1]).all()
    assert read.board[:, 0] == pytest.approx(log.board[:, 0])
    assert "60 of 60 messages have no board_force_n" in read.notes[0]
    read = read_log(bag_with(tmp_path, joint("velocity", 1, NAN), [5], "/joint_states"))
    assert read.wheel_speeds == pytest.approx(log.wheel_speeds)
    assert "1 of 60 messages have no wheel_fr_rad_s" in read.notes[0]
    with pytest.raises(InputError, match=r"/joint_states, message 6 at .* s: board_m is -inf"):
        read_log(bag_with(tmp_path, joint("position", 4, -INF), [5], "/joint_states"))


@pytest.mark.parametrize("number", [NAN, INF])
def test_a_command_that_is_no_number_is_refused(number, tmp_path):
    with pytest.raises(
        InputError, match=r"/wheel_commands, message 6 at .* s: cmd_wheel_fl_rad_s is (nan|inf)"
    ):
        read_log(bag_with(tmp_path, joint("velocity", 0, number), [5], "/wheel_commands"))


def second_publisher(message_of, each=1, later_ns=0, topic="/joint_states"):
    """Return what adds a message of another node to every so many of a topic."""

    def alter(of, row, message, at):
        if of != topic or row % each:
            return [(message, at)]
        other = copy.deepcopy(message)
        message_of(other)
        return [(message, at), (other, at + later_ns)]

    return alter


def zeros(message):
    message["position"], message["velocity"], message["effort"] = [0.0] * 5, [0.0] * 5, []


@pytest.mark.parametrize("each", [1, 2, 5])
@pytest.mark.parametrize("later_ns", [0, 7_000_000])
def test_two_publishers_of_one_joint_are_refused(each, later_ns, tmp_path):
    alter = second_publisher(zeros, each, later_ns)
    with pytest.raises(
        InputError, match=r"/joint_states: \w+ jumps to and fro .* do several nodes publish"
    ):
        read_log(write_bag(tmp_path / "run.mcap", smooth_log(), alter=alter))


def test_two_publishers_of_wheels_or_poses_are_refused(tmp_path):
    log = smooth_log()

    def other_wheels(message):
        message["name"], message["position"] = message["name"][:4], []
        message["velocity"], message["effort"] = [20.0] * 4, []

    def other_place(message):
        message["pose"]["position"]["x"] += 0.1

    for topic, change, column in (
        ("/joint_states", other_wheels, "wheel_fl_rad_s"),
        ("/localisation", other_place, "x_m"),
    ):
        alter = second_publisher(change, later_ns=9_000_000, topic=topic)
        with pytest.raises(InputError, match=f"{topic}: {column} jumps to and fro"):
            read_log(write_bag(tmp_path / "run.mcap", log, alter=alter))


def test_publishers_of_different_joints_make_one_log(tmp_path):
    def alter(of, row, message, at):
        if of != "/joint_states":
            return [(message, at)]
        wheels, board = copy.deepcopy(message), copy.deepcopy(message)
        for part, kept in ((wheels, slice(0, 4)), (board, slice(4, 5))):
            for field in ("name", "position", "velocity", "effort"):
                part[field] = part[field][kept]
        return [(wheels, at), (board, at)]

    log = smooth_log()
    read = read_log(write_bag(tmp_path / "run.mcap", log, alter=alter))
    assert read.board == pytest.approx(log.board)
    assert read.wheel_speeds == pytest.approx(log.wheel_speeds)


def test_noise_outliers_and_coarse_encoders_are_no_second_publisher(tmp_path):
    rng = np.random.default_rng(3)
    log = smooth_log()
    log.pose[:, :2] += rng.normal(0, 0.03, (N, 2))
    log.pose[::9, :2] += 0.4  # one in nine poses is an outlier
    log.board[:, 0] += rng.normal(0, 0.003, N)
    log.wheel_speeds[:] = np.where(np.arange(N)[:, None] % 3 == 0, 5.0, 0.0)
    read = read_log(write_bag(tmp_path / "run.mcap", log))
    assert read.notes == ()
    assert read.board == pytest.approx(log.board)


def test_poses_of_several_frames_or_cars_on_a_topic_are_refused(tmp_path):
    def change(message):
        message["header"]["frame_id"] = "odom"

    with pytest.raises(
        InputError, match=r"/localisation, message 31 at .* s: poses in the frames 'map', 'odom'"
    ):
        read_log(bag_with(tmp_path, change, range(30, N)))


def test_messages_at_the_same_time_count_once_the_last(tmp_path):
    def alter(of, row, message, at):
        return [(message, at), (message, at)]

    log = smooth_log()
    read = read_log(write_bag(tmp_path / "run.mcap", log, alter=alter))
    assert len(read) == N
    assert (
        "/localisation: 60 of 120 values of x_m, y_m, heading_rad, pitch_rad, roll_rad came at the time"
        in ("".join(read.notes))
    )
    assert read.pose[:, :2] == pytest.approx(log.pose[:, :2])
    assert read.commands[:, :5] == pytest.approx(log.commands[:, :5])

    def corrected(of, row, message, at):
        if of != "/wheel_commands":
            return [(message, at)]
        first = copy.deepcopy(message)
        first["velocity"] = [0.5] * 5
        return [(first, at), (message, at)]

    read = read_log(write_bag(tmp_path / "run.mcap", log, alter=corrected))
    assert read.commands[:, :5] == pytest.approx(log.commands[:, :5])


def test_times_that_go_backwards_are_put_in_order(tmp_path):
    log = smooth_log()
    start = 1_700_000_000_000_000_000

    def alter(of, row, message, at):
        return [(message, start + round(0.02e9) * (N - 1) - (at - start))]

    read = read_log(write_bag(tmp_path / "run.mcap", log, alter=alter))
    assert read.pose[::-1, :2] == pytest.approx(log.pose[:, :2])
    assert read.commands[::-1, :5] == pytest.approx(log.commands[:, :5])


def test_a_command_that_names_some_joints_leaves_the_others_as_they_were(tmp_path):
    """So a node that commands the board alone does not stop the wheels."""

    def alter(of, row, message, at):
        if of != "/wheel_commands":
            return [(message, at)]
        wheels, board = copy.deepcopy(message), copy.deepcopy(message)
        wheels["name"], wheels["velocity"] = message["name"][:4], message["velocity"][:4]
        board["name"], board["velocity"] = ["board"], [0.01]
        return [(wheels, at), (board, at + 5_000_000)]

    log = smooth_log()
    read = read_log(write_bag(tmp_path / "run.mcap", log, alter=alter))
    assert len(read) == 2 * N
    assert read.commands[::2, :4] == pytest.approx(log.commands[:, :4])
    assert read.commands[1::2, :4] == pytest.approx(log.commands[:, :4])
    assert read.commands[:, 4].tolist() == [0.0] + [0.01] * (2 * N - 1)


def test_wheels_that_are_never_commanded_are_named(tmp_path):
    def change(message):
        message["name"] = ["left_front", *message["name"][1:]]

    with pytest.raises(
        InputError, match="never commands the joint 'wheel_fl'; name the wheels with --topics"
    ):
        read_log(bag_with(tmp_path, change, range(N), "/wheel_commands"))


def test_a_joint_that_comes_twice_in_a_message_is_refused(tmp_path):
    def change(message):
        message["name"] = ["wheel_fl", "wheel_fl", *message["name"][2:]]

    for topic in ("/joint_states", "/wheel_commands"):
        with pytest.raises(InputError, match=rf"{topic}, message 1 at .* s: two joints 'wheel_fl'"):
            read_log(bag_with(tmp_path, change, [0], topic))


def test_a_bag_whose_every_pose_and_speed_is_missing_says_so(tmp_path):
    def alter(of, row, message, at):
        message = copy.deepcopy(message)
        if of == "/localisation":
            turned(0, 0, 0, 0)(message)
        if of == "/joint_states":
            message["position"] = message["velocity"] = message["effort"] = [NAN] * 5
        return [(message, at)]

    with pytest.raises(InputError, match=r"nothing was measured.*60 of 60 messages have no x_m"):
        read_log(write_bag(tmp_path / "run.mcap", smooth_log(), alter=alter))
