"""Logs: written as they were, read back to nine digits, and refused with a place where they are none."""

from dataclasses import replace

import numpy as np
import pytest
from robots.bags import write_bag

from craftsim import (
    Action,
    Executor,
    Grid,
    Machines,
    PhysicsWorld,
    SensorNoise,
    Sensors,
    Trajectory,
    validate,
)
from craftsim.errors import InputError
from craftsim.models.measuring import Motors
from craftsim.robots.log import GROUPS, Log, LogRecorder
from craftsim.robots.log_files import COLUMNS, COMMAND_COLUMNS, read_log, read_logs, write_table


def make_log(n=60, period_s=0.02, seed=0):
    rng = np.random.default_rng(seed)
    groups = {name: 0.1 * rng.normal(size=(n, len(of))) for name, of in GROUPS.items()}
    log = Log(period_s * np.arange(n), **groups)
    log.pose[:] = 0.1 * np.cumsum(log.pose, axis=0)
    log.docked[: n // 2] = np.nan
    return log


def same(one, other, tolerance=1e-8):
    return all(
        np.allclose(a, b, rtol=tolerance, atol=tolerance, equal_nan=True)
        for a, b in zip(one.columns.values(), other.columns.values(), strict=True)
    )


def test_logs_of_many_cars_are_read_as_they_were_written(tmp_path):
    logs = {0: make_log(), 3: make_log(40, seed=1)}
    read = read_logs(write_table(tmp_path / "run.csv", logs))
    assert list(read) == [0, 3]
    assert all(same(read[car], logs[car]) for car in logs)
    assert list(logs[0].columns) == [name for name in COLUMNS if name != "car"]
    commands = read_log(write_table(tmp_path / "commands.csv", logs, COMMAND_COLUMNS), car=3)
    assert np.allclose(commands.commands, logs[3].commands)
    assert all(np.isnan(getattr(commands, name)).all() for name in GROUPS if name != "commands")
    with pytest.raises(InputError, match="no car 2; there are 0, 3"):
        read_log(tmp_path / "run.csv", car=2)


ROWS = ["0,1,1,1,1,0", "0.02,1,1,1,1,0.01", "0.04,1,1,1,1,0.02"]
HEADER = "time_s,cmd_wheel_fl_rad_s,cmd_wheel_fr_rad_s,cmd_wheel_rl_rad_s,cmd_wheel_rr_rad_s,x_m"


def test_a_table_that_is_no_log_is_refused_with_its_place(tmp_path):
    for header, rows, said in (
        ("", [], "no column time_s"),
        (HEADER, [], "no rows"),
        (HEADER, ROWS[:1], "car 0: a log of 1 rows"),
        (HEADER.replace("time_s", "time_ms"), ROWS, "'time_ms' looks like it in another unit"),
        (HEADER.replace("fl_rad_s", "fl_rpm"), ROWS, "no column cmd_wheel_fl_rad_s"),
        (HEADER.replace("x_m", "x_mm"), ROWS, "unknown column 'x_mm'; did you mean 'x_m'"),
        (HEADER.replace("x_m", "time_s"), ROWS, "two columns 'time_s'"),
        (HEADER, [*ROWS, "0.06,1,1,1,1"], "run.csv:5: 5 values; the header has 6 columns"),
        (
            HEADER,
            [*ROWS, "0.06,1,x,1,1,0"],
            "run.csv:5: cmd_wheel_fr_rad_s is 'x', which is no number",
        ),
        (HEADER, [*ROWS, "0.06,1,inf,1,1,0"], "run.csv:5: cmd_wheel_fr_rad_s is infinite"),
        (HEADER, [*ROWS, "0.06,1,,1,1,0"], "cmd_wheel_fr_rad_s has no value in row 4"),
        (HEADER, [*ROWS, "0.04,1,1,1,1,0"], "run.csv:5: time_s is 0.04; it must be a number above"),
        (HEADER, [*ROWS, ",1,1,1,1,0"], "run.csv:5: time_s is nan"),
        (HEADER, [f"{1000 * k},1,1,1,1,0" for k in range(3)], "Is it in seconds"),
        (HEADER, ["0,9e9,1,1,1,0", *ROWS[1:]], "cmd_wheel_fl_rad_s is 9e\\+09 in row 1"),
        (
            HEADER + ",car",
            [f"{row},0.5" for row in ROWS],
            "run.csv:2: car is 0.5; allowed: an integer",
        ),
        (HEADER, [*ROWS, '0.06,1,"1,1,1,0'], "run.csv:5: not a line of a CSV table"),
    ):
        (tmp_path / "run.csv").write_text("\n".join([header, *rows]) + "\n")
        with pytest.raises(InputError, match=said):
            read_log(tmp_path / "run.csv")


def test_a_pose_in_millimetres_or_degrees_is_told_by_how_it_moves():
    log = make_log(200)
    time, still = log.time_s, 0 * log.time_s
    with pytest.raises(InputError, match=r"900 m/s .*are x and y in metres"):
        replace(log, pose=np.column_stack([900 * time, still, still]))
    with pytest.raises(InputError, match="the heading in radians"):
        replace(log, pose=np.column_stack([still, still, 57.3 * np.sin(20 * time)]))


def test_what_is_no_file_of_a_log_is_refused(tmp_path):
    (tmp_path / "run.csv").write_bytes(b"\xff\xfe\n")
    for name, said in (
        ("run.csv", "not UTF-8"),
        *((name, name) for name in ("log.txt", "no.csv", "no.mcap")),
    ):
        with pytest.raises(InputError, match=said):
            read_log(tmp_path / name)


def test_a_part_of_a_log_begins_and_ends_with_the_rows_of_its_times_whatever_their_last_digits():
    log = make_log(101)
    log = replace(log, time_s=np.cumsum(np.full(101, log.period_s)))
    for first, last in ((3, 7), (14, 59), (33, 100)):
        part = log.between(round(float(log.time_s[first]), 6), round(float(log.time_s[last]), 6))
        assert np.array_equal(part.time_s, log.time_s[first:last])


def test_resampling_holds_commands_interpolates_and_leaves_gaps_open():
    log = make_log(101)
    log.pose[40:60] = np.nan
    log.pose[:40, 0] = 2 * log.time_s[:40]
    fine = log.resampled(0.005)
    assert fine.period_s == 0.005
    assert np.array_equal(fine.commands[::4], log.commands)
    assert np.array_equal(fine.commands[3::4], log.commands[:-1])
    assert np.allclose(fine.pose[:150, 0], 2 * fine.time_s[:150])
    assert np.isnan(fine.pose[165:230]).all()
    assert same(log.resampled(log.period_s), log)


def test_a_bag_is_read_as_the_log_that_was_put_into_it(tmp_path):
    pytest.importorskip("mcap_ros2")
    log = make_log()
    read = read_log(write_bag(tmp_path / "run.mcap", log))
    assert np.allclose(read.time_s, log.time_s, atol=1e-6)
    assert np.allclose(read.commands[:, :5], log.commands[:, :5])
    assert np.allclose(np.cos(read.pose[:, 2]), np.cos(log.pose[:, 2]), atol=1e-6)
    assert np.allclose(read.pose[:, :2], log.pose[:, :2], atol=1e-6)
    assert np.allclose(read.wheel_speeds, log.wheel_speeds, atol=1e-5)
    assert np.allclose(read.board, log.board, atol=1e-5)


def test_topics_are_found_or_named(tmp_path):
    pytest.importorskip("mcap_ros2")
    bag = write_bag(tmp_path / "run.mcap", make_log(), "/base/command", ("/a", "/b"))
    with pytest.raises(InputError, match="several topics hold poses: /a, /b"):
        read_log(bag)
    topics = tmp_path / "topics.yaml"
    for text, said in (
        ("pose: /b", "no commands on the topic /wheel_commands"),
        ("{pose: [1]}", r"topics.yaml:1: key 'pose': must be a text, not a list"),
        ("{poses: /b}", "unknown key 'poses'"),
    ):
        topics.write_text(text)
        with pytest.raises(InputError, match=said):
            read_log(bag, topics=topics)
    topics.write_text("{pose: /b, commands: /base/command}")
    assert len(read_log(bag, topics=topics)) == 60


def test_replaying_recorded_commands_repeats_the_run():
    """So commands stand in the row of what was measured when they were given."""
    noise = SensorNoise(position_m=0.001, motor_lag_s=0.02)
    machines = Machines(drive="wheels")
    grid = Grid.empty((3, 2, 1), n_cars=1)

    def parts():
        physics = PhysicsWorld(grid, machines=machines)
        return (
            physics,
            Sensors(physics, noise, np.random.default_rng(1)),
            Motors(physics, noise.motor_lag_s),
        )

    physics, sensors, motors = parts()
    executor = Executor(physics, sensors=sensors, motors=motors)
    recorder = LogRecorder(executor)
    executor.run({0: Action.MOVE_RIGHT})
    log = recorder.logs()[0]
    physics, sensors, motors = parts()
    for row in range(len(log)):
        assert physics.time_s == log.time_s[row]
        assert np.array_equal(sensors.read()[0]["wheel_speeds"], log.wheel_speeds[row])
        assert sensors.read()[0]["x"] == log.pose[row, 0]
        motors.drive(0, log.commands[row, :4])
        physics.advance()
        sensors.observe()


def test_a_recorded_run_writes_its_log_beside_its_trajectory(tmp_path):
    validate(
        "strip",
        policy="random",
        drive="wheels",
        randomize="mild",
        out=tmp_path,
        record=True,
        trials=1,
    )
    (log,), (trajectory,) = (
        list((tmp_path / "trajectories").glob(end)) for end in ("*.log.csv", "*.npz")
    )
    assert log.name == f"{trajectory.stem}.log.csv"
    moved = Trajectory.read(trajectory)
    cars = read_logs(log)
    assert len(cars) == moved.measured.shape[1]
    for car, one in cars.items():
        assert np.allclose(one.time_s, moved.time[:-1])
        assert np.abs(one.pose[:, 0] - moved.pose(f"car {car}")[:-1, 0]).max() < 0.05
    assert np.abs(cars[0].commands[:, :4]).max() > 1
