"""Several writers of one file: each has a temporary file of its own, and a reader sees a whole one at any time."""

import fcntl
import os
import subprocess
import sys

import pytest
from owner import kill, writer

from craftsim.errors import InputError
from craftsim.storage.writing import WRITERS, whole, write_whole

NAMES = (".partial-a.txt", ".partial-0-a.txt", ".partial-1-a.txt")
"""That an earlier version and this one give the temporary files of a.txt."""
_LOOP = """
import sys
from craftsim.storage.writing import write_whole
for _ in range(150):
    write_whole(sys.argv[1], sys.argv[2] * 100_000)
"""


def test_two_processes_write_one_file_and_a_reader_sees_it_whole(tmp_path):
    path = tmp_path / "a.txt"
    write_whole(path, "a" * 100_000)
    commands = [[sys.executable, "-c", _LOOP, path, letter] for letter in "ab"]
    writers = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for command in commands]
    seen = set()
    while any(process.poll() is None for process in writers):
        seen.add(path.read_text())
    assert [(process.wait(), process.communicate()[1]) for process in writers] == [(0, ""), (0, "")]
    assert seen <= {"a" * 100_000, "b" * 100_000}
    assert [*tmp_path.iterdir()] == [path]


def test_a_file_that_is_being_written_is_nobody_elses(tmp_path):
    path = tmp_path / "a.txt"
    with whole(path) as first:
        first.write_text("first, ")
        with whole(path) as second:
            assert second != first
            second.write_text("second")
        write_whole(path, "third")
        assert path.read_text() == "third"
        with first.open("a") as file:
            file.write("and on")
    assert path.read_text() == "first, and on"
    assert [*tmp_path.iterdir()] == [path]


def test_what_a_kill_leaves_is_gone_with_the_next_writing_and_what_is_written_now_is_not(tmp_path):
    path = tmp_path / "a.txt"
    with writer(path) as dies, writer(path) as too, writer(path) as lives:
        assert len([*tmp_path.iterdir()]) == 3
        kill(dies)
        kill(too)
        for text in "xyz":
            write_whole(path, text)
            assert path.read_text() == text
            assert len([*tmp_path.iterdir()]) == 2
        lives.communicate()
        assert lives.returncode == 0
    assert path.read_text() == "half"
    assert [*tmp_path.iterdir()] == [path]


@pytest.mark.parametrize("plant", ["link", "hard link", "pipe", "folder"])
def test_what_lies_at_a_temporary_name_is_not_written_to(tmp_path, plant):
    out, victim = tmp_path / "out", tmp_path / "victim"
    out.mkdir()
    victim.write_text("precious")
    ends = []
    for name in NAMES:
        match plant:
            case "link":
                (out / name).symlink_to(victim)
            case "hard link":
                os.link(victim, out / name)
            case "pipe":
                os.mkfifo(out / name)
                # With both ends open nothing that opens it hangs.
                ends.append(os.open(out / name, os.O_RDWR | os.O_NONBLOCK))
            case "folder":
                (out / name).mkdir()
    write_whole(out / "a.txt", "mine")
    assert victim.read_text() == "precious"
    assert (out / "a.txt").read_text() == "mine"
    assert not (out / "a.txt").is_symlink()
    for end in ends:
        os.close(end)


def test_a_link_at_the_name_itself_is_replaced_and_a_folder_behind_a_link_is_written_into(tmp_path):
    victim, folder = tmp_path / "victim", tmp_path / "folder"
    victim.write_text("precious")
    folder.mkdir()
    (tmp_path / "out").symlink_to(folder)
    (folder / "a.txt").symlink_to(victim)
    write_whole(tmp_path / "out/a.txt", "mine")
    assert (victim.read_text(), (folder / "a.txt").read_text()) == ("precious", "mine")
    assert not (folder / "a.txt").is_symlink()


def test_where_all_temporary_names_are_taken_the_user_is_told(tmp_path):
    for number in range(WRITERS):
        (tmp_path / f".partial-{number}-a.txt").mkdir()
    with pytest.raises(
        InputError, match=r"a\.txt: cannot be written: all names .* are taken; remove what is"
    ):
        write_whole(tmp_path / "a.txt", "mine")


def test_a_file_system_without_locks_is_written_to_and_nothing_there_counts_as_abandoned(
    tmp_path, monkeypatch
):
    def refuses(number, operation):
        raise OSError(37, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuses)
    with whole(tmp_path / "a.txt") as first:
        first.write_text("first")
        write_whole(tmp_path / "a.txt", "second")
    assert (tmp_path / "a.txt").read_text() == "first"
    assert [*tmp_path.iterdir()] == [tmp_path / "a.txt"]


def test_files_have_the_rights_that_others_have(tmp_path):
    before = os.umask(0o027)
    try:
        write_whole(tmp_path / "a.txt", "mine")
    finally:
        os.umask(before)
    assert (tmp_path / "a.txt").stat().st_mode & 0o777 == 0o640
