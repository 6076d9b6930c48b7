"""One process at a time writes into a folder for results: a second one is told, and the first loses nothing."""

import fcntl
import inspect
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from owner import kill, owner

from craftsim.cli import main
from craftsim.cli.app import bind
from craftsim.cli.commands import ALONE, BELOW, COMMANDS
from craftsim.errors import InputError
from craftsim.reports.json_file import write_report
from craftsim.storage import folders
from craftsim.storage.folders import LOCK, directory_within, output_directory, owned
from craftsim.validation.validation import validate

IN_USE = "is in use: another craftsim writes into it"
WORDS = {
    "demo": [],
    "validate": ["strip"],
    "plan": ["strip"],
    "audit": ["--quick"],
    "tune": ["drive"],
    "audit margins": ["--quick"],
    "compare": ["a", "b"],
    "audit clearance": [],
    "replay": ["a"],
    "robot excite": [],
    "robot identify": ["a.csv"],
    "robot serve": [],
    "train": [],
    "train study": ["quick"],
    "conformance": ["a.gz"],
    "reality": ["a.npz"],
    "bench": ["rules"],
    "machine check": ["a.yaml"],
    "design": ["tower"],
    "doctor": [],
}
"""Commands that own the folder that they write into, with what they cannot do without."""
WITHOUT = ("machine new", "render", "show", "view")
"""Commands that own no folder: they write a file, a film, pictures, or nothing."""

_TAKES_TURNS = """
import os, sys, time
from pathlib import Path
from craftsim.errors import InputError
from craftsim.storage.folders import owned
folder, turns = Path(sys.argv[1]), 0
while turns < 300:
    try:
        with owned(folder):
            os.close(os.open(folder / "inside", os.O_CREAT | os.O_EXCL))
            os.unlink(folder / "inside")
            turns += 1
    except InputError as error:
        assert "is in use" in str(error), error
        time.sleep(0)  # who is in it may be waiting for a processor
print(turns)
"""


@pytest.fixture(scope="module")
def taken(tmp_path_factory):
    """Return a folder that another process owns."""
    folder = tmp_path_factory.mktemp("taken")
    (folder / "report.json").write_text("the first's")
    with owner(folder):
        yield folder


def test_every_command_with_a_folder_is_here():
    below = {f"{name} {one}" for name, others in BELOW.items() for one in others}
    assert {*WORDS, *WITHOUT} == {*COMMANDS, *below} - {*ALONE}
    for name, words in WORDS.items():
        function, _ = bind([*name.split(), *words])
        assert "out" in inspect.signature(function).parameters


def test_a_second_process_is_told_and_the_first_loses_nothing(taken, capsys):
    before = sorted(taken.iterdir())
    for command, words in WORDS.items():
        assert main([*command.split(), *words, "--out", str(taken)]) == 2
        assert (
            f"{taken} {IN_USE}; wait until it has ended, or choose another --out"
            in capsys.readouterr().err
        )
    for write in (
        lambda: write_report(taken, {}, command="mine"),
        lambda: validate("strip", out=taken),
    ):
        with pytest.raises(InputError, match=IN_USE):
            write()
    assert sorted(taken.iterdir()) == before
    assert (taken / "report.json").read_text() == "the first's"


def test_a_link_to_a_folder_is_the_folder_and_a_name_that_none_can_have_is_refused(taken, tmp_path):
    (tmp_path / "link").symlink_to(taken)
    for name, message in {"link": IN_USE, "a\0b": "cannot make the output directory"}.items():
        with pytest.raises(InputError, match=message), owned(tmp_path / name):
            pass


def test_an_owner_that_is_killed_keeps_nobody_out(tmp_path):
    with owner(tmp_path) as first:
        kill(first)
    assert (tmp_path / LOCK).exists()
    with owned(tmp_path):
        pass
    assert not [*tmp_path.iterdir()]


def test_a_process_that_an_owner_started_owns_nothing_when_the_owner_has_ended(tmp_path):
    with owned(tmp_path):
        child = subprocess.Popen(
            [sys.executable, "-c", "input()"], stdin=subprocess.PIPE, close_fds=False
        )
    with child, owned(tmp_path):
        assert child.poll() is None
        child.communicate(b"\n")


def test_an_owner_may_own_again_and_another_thread_may_not(tmp_path):
    refused = []

    def other():
        try:
            with owned(tmp_path):
                pass
        except InputError as error:
            refused.append(error)

    with owned(tmp_path), owned(tmp_path):
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
    assert len(refused) == 1
    other()
    assert len(refused) == 1


def test_processes_that_take_turns_are_never_in_a_folder_at_the_same_time(tmp_path):
    command = [sys.executable, "-c", _TAKES_TURNS, tmp_path / "new"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    processes = [subprocess.Popen(command, **pipes) for _ in range(3)]
    for process in processes:
        turns, errors = process.communicate()
        assert (process.returncode, errors) == (0, "")
        assert int(turns) == 300
    assert {*tmp_path.rglob("*")} <= {tmp_path / "new"}


def test_a_folder_that_is_removed_and_made_again_meanwhile_is_locked(tmp_path, monkeypatch):
    tried = []

    def flickers(out):
        tried.append(out)
        if len(tried) == 1:
            raise InputError(f"cannot make the output directory {out}")
        return output_directory(out)

    monkeypatch.setattr(folders, "output_directory", flickers)
    with owned(tmp_path):
        assert (tmp_path / LOCK).exists()
    assert len(tried) == 2


def test_wrong_input_leaves_no_folder_and_removes_none(tmp_path, capsys):
    (tmp_path / "mine").mkdir()
    for folder in ("new/inner", "mine"):
        assert main(["demo", "--task", "nonsense", "--out", str(tmp_path / folder)]) == 2
    assert "nonsense" in capsys.readouterr().err
    assert [*tmp_path.iterdir()] == [tmp_path / "mine"]
    assert not [*(tmp_path / "mine").iterdir()]


def test_what_lies_at_the_name_of_the_lock_is_refused(tmp_path):
    (tmp_path / "victim").write_text("precious")
    links = (lambda path, to=to: path.symlink_to(f"../{to}") for to in ("../victim", "../nowhere"))
    for number, plant in enumerate((*links, os.mkfifo, Path.mkdir)):
        out = tmp_path / str(number) / "out"
        out.mkdir(parents=True)
        plant(out / LOCK)
        remedy = pytest.raises(
            InputError, match=r"craftsim-lock: .*; remove it, or choose another --out"
        )
        with remedy, owned(out):
            pass
    assert (tmp_path / "victim").read_text() == "precious"
    assert not (tmp_path / "nowhere").exists()


def test_a_file_system_without_locks_is_refused(tmp_path, monkeypatch):
    def refuses(number, operation):
        raise OSError(37, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuses)
    with pytest.raises(InputError, match="its file system has no locks"), owned(tmp_path / "new"):
        pass


def test_a_folder_within_is_not_made_behind_a_link_or_elsewhere(tmp_path):
    victim, out = tmp_path / "victim", tmp_path / "out"
    victim.mkdir()
    assert directory_within(out, "a", "b/c") == out / "a/b/c"
    (out / "a/link").symlink_to(victim)
    for names in (("a", "link"), ("a/link/inner",)):
        with pytest.raises(
            InputError, match="a/link is a link, and none is followed within a folder of results"
        ):
            directory_within(out, *names)
    for name in ("../victim", "a/../../victim", str(victim)):
        with pytest.raises(InputError, match="leads out of"):
            directory_within(out, name)
    assert not [*victim.iterdir()]
    assert directory_within(Path(out)) == out
