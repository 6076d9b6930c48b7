"""Line ends and folders: what other systems and ROS 2 write is read, and what is not read says what helps."""

import numpy as np
import pytest
from robots.bags import write_bag

from craftsim.cli import main
from craftsim.errors import InputError
from craftsim.robots.log import GROUPS, Log
from craftsim.robots.log_files import read_log, write_table


@pytest.fixture
def log():
    rng = np.random.default_rng(0)
    groups = {name: 0.01 * rng.normal(size=(20, len(columns))) for name, columns in GROUPS.items()}
    return Log(0.02 * np.arange(20), **groups)


@pytest.mark.parametrize("end", [b"\r", b"\r\n"])
def test_tables_with_other_line_ends_are_the_same_log_and_have_the_same_lines(end, log, tmp_path):
    path = write_table(tmp_path / "run.csv", {0: log})
    text = path.read_bytes()
    path.write_bytes(text.replace(b"\n", end))
    read = read_log(path)
    for name, values in read_log(write_table(tmp_path / "plain.csv", {0: log})).columns.items():
        assert np.array_equal(values, read.columns[name], equal_nan=True), name
    path.write_bytes((text + b"x\n").replace(b"\n", end))
    with pytest.raises(InputError, match=r"run\.csv:22: 1 values"):
        read_log(path)
    path.write_bytes((text + b"1" * 5000).replace(b"\n", end))
    with pytest.raises(InputError, match=r"run\.csv:22: the line is longer than"):
        read_log(path)
    path.write_bytes(text.replace(b"\n", end).replace(b"-", b"\xff"))
    with pytest.raises(InputError, match=r"run\.csv:\d+: not UTF-8"):
        read_log(path)


def folder_of(tmp_path, log, *names):
    folder = tmp_path / "rosbag2"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    for name in names:
        write_bag(folder / name, log)
    return folder


def test_a_folder_with_one_recording_and_capitals_are_read(log, tmp_path):
    pytest.importorskip("mcap_ros2")
    folder = folder_of(tmp_path, log, "rosbag2_0.MCAP")
    for path in (folder, folder / "rosbag2_0.MCAP"):
        read = read_log(path)
        assert np.allclose(read.pose[:, :2], log.pose[:, :2])
    path = write_table(tmp_path / "RUN.CSV", {0: log})
    assert len(read_log(path)) == 20


def test_what_is_not_read_says_what_helps(log, tmp_path, capsys):
    pytest.importorskip("mcap_ros2")
    folder = folder_of(tmp_path, log)
    with pytest.raises(InputError, match="a folder without a recording"):
        read_log(folder)
    (folder / "run_0.db3").write_bytes(b"SQLite format 3\0")
    for path in (folder, folder / "run_0.db3"):
        with pytest.raises(
            InputError, match=r"run_0\.db3: .*'mcap convert run_0\.db3 run_0\.mcap' converts it"
        ):
            read_log(path)
    for name in ("run.mcap.zstd", "run.bag"):
        with pytest.raises(InputError, match="which is not read; "):
            read_log(folder / name)
    for part in ("run_0.mcap", "run_1.mcap"):
        write_bag(folder / part, log)
    assert main(["robot", "identify", str(folder), "--out", str(tmp_path / "out")]) == 2
    message = " ".join(capsys.readouterr().err.split())
    assert "a bag of 2 files; 'mcap merge run_0.mcap run_1.mcap ... -o joined.mcap'" in message


@pytest.mark.parametrize("end", ["\r", "\r\n"])
def test_plans_and_worlds_with_other_line_ends_are_the_same(end, tmp_path):
    from craftsim.discrete.files.blueprint import read_blueprint
    from craftsim.discrete.files.shipped import shipped_blueprint, shipped_plan
    from craftsim.planning.plan_file import read_plan

    paths = {}
    for shipped in (shipped_blueprint("strip"), shipped_plan("strip")):
        text = "# a comment\n" + shipped.read_text(encoding="utf-8")
        plain, other = tmp_path / shipped.name, tmp_path / f"other_{shipped.name}"
        plain.write_bytes(text.encode())
        other.write_bytes(text.replace("\n", end).encode())
        paths[shipped.suffix] = plain, other
    grids = [read_blueprint(path).grid(np.random.default_rng(0)) for path in paths[".yaml"]]
    assert np.array_equal(grids[0].cells, grids[1].cells)
    assert np.array_equal(grids[0].cars, grids[1].cars)
    plans = [read_plan(path, grids[0].n_cars) for path in paths[".plan"]]
    assert plans[0].ticks == plans[1].ticks
    assert len(plans[0].ticks) > 1
