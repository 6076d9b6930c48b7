"""A disk that takes no more: one message and exit status 2, and what was there before stays as it was."""

import contextlib
import csv
import re
import resource
from pathlib import Path

import numpy as np
import pytest

import craftsim
from craftsim.checking.contacts import ContactLog
from craftsim.cli import main
from craftsim.discrete.grid import Grid
from craftsim.errors import InputError
from craftsim.experiments.statistics import write_durations
from craftsim.models.composition import world_spec
from craftsim.models.config import SimulationConfig
from craftsim.models.exporting import write_mjcf
from craftsim.models.world import PhysicsWorld
from craftsim.rendering.encode import VideoWriter

PACKAGE = Path(craftsim.__file__).parent
FULL = "cannot be written: File too large; make room"


@contextlib.contextmanager
def disk_with_room_for(n_bytes: int):
    """Let no file of this process become larger, which fails as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_show_does_not_name_a_picture_that_is_not_there(tmp_path, capsys):
    assert main(["show", "strip", "--out", str(tmp_path)]) == 0
    before = (tmp_path / "strip.png").read_bytes()
    capsys.readouterr()
    with disk_with_room_for(100):
        assert main(["show", "strip", "--out", str(tmp_path)]) == 2
    printed = capsys.readouterr()
    assert "picture:" not in printed.out
    assert f"strip.png: {FULL}" in printed.err
    assert list(tmp_path.iterdir()) == [tmp_path / "strip.png"]
    assert (tmp_path / "strip.png").read_bytes() == before


@pytest.mark.parametrize("n_bytes", [0, 100, 20_000])
def test_a_film_is_whole_or_as_it_was(tmp_path, n_bytes):
    frames = np.random.default_rng(0).integers(0, 255, (60, 96, 128, 3), np.uint8)
    (tmp_path / "film.mp4").write_bytes(b"before")

    def film():
        with VideoWriter(tmp_path / "film.mp4", 25) as writer:
            for frame in frames:
                writer.write(frame)

    with (
        disk_with_room_for(n_bytes),
        pytest.raises(InputError, match=r"film\.mp4: cannot be written"),
    ):
        film()
    assert (tmp_path / "film.mp4").read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [tmp_path / "film.mp4"]
    film()
    assert (tmp_path / "film.mp4").stat().st_size > 20_000


def test_contacts_scenes_and_durations_are_whole_or_as_they_were(tmp_path):
    physics = PhysicsWorld(Grid.empty((2, 2, 1), n_cars=1))
    log, row = (
        ContactLog(physics),
        {"verb": "LIFT", "load": "none", "level": 1, "n": 2, "mean_s": 1.0},
    )
    folder = tmp_path / "scene"
    scene = world_spec(Grid.empty((2, 2, 1), n_cars=1), SimulationConfig())
    writers = {
        tmp_path / "contacts.csv": lambda: log.write(tmp_path / "contacts.csv"),
        tmp_path / "durations.csv": lambda: write_durations(tmp_path, [row] * 20),
        folder / "site.xml": lambda: write_mjcf(folder / "site.xml", scene),
    }
    for path, write in writers.items():
        write()
        before = {file: file.read_bytes() for file in path.parent.rglob("*") if file.is_file()}
        with disk_with_room_for(20), pytest.raises(InputError, match=FULL):
            write()
        assert {
            file: file.read_bytes() for file in path.parent.rglob("*") if file.is_file()
        } == before
    with (tmp_path / "contacts.csv").open(newline="") as file:
        assert [line["first"] for line in csv.DictReader(file)] == ["ground"]


WRITES = re.compile(
    r"\.write_(text|bytes)\(|open\([^)]*[\"'][wax]b?\+?[\"']|imwrite|savefig|np\.save|torch\.save"
)
ELSEWHERE = {
    # A file to lock stays empty.
    "compiled/code_cache.py",
    # Lines are added to what is there; arrays and plots are written into memory.
    "reports/html.py",
    "experiments/bundle.py",
    "rendering/trajectory.py",
    # Examples in docstrings.
    "models/randomization.py",
    "mjcf/machines.py",
    "skills/gains.py",
}


def test_files_are_written_through_one_door():
    for path in PACKAGE.rglob("*.py"):
        name, text = path.relative_to(PACKAGE).as_posix(), path.read_text(encoding="utf-8")
        if WRITES.search(text) and name not in ELSEWHERE and not name.startswith("storage/"):
            assert re.search(r"from craftsim\.storage\.writing import .*\bwhole\b", text), name
