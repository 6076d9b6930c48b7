"""Tasks, skills and machines of installed packages: known by name to the command line and to Python, never to files."""

import sys

import pytest

import craftsim
from craftsim.checking.setup import setup_of
from craftsim.cli import main
from craftsim.errors import InputError
from craftsim.skills.library import own_skills
from craftsim.tasks import as_task, known_task
from craftsim.workers.modules import plug_ins

MODULE = '''\
from dataclasses import replace
from pathlib import Path

from craftsim import Action, Command, Skill, make_task

HEAVY = Path(__file__).with_name("fake_heavy.yaml")
NUMBER = 3


class Wait(Skill):
    """Hold still."""

    def step(self, measurement):
        return Command()


WAITING = {Action.LIFT: Wait}


def short_strip():
    return replace(make_task("strip"), name="short_strip", max_steps=4)
'''
ENTRY_POINTS = """\
[craftsim.tasks]
short_strip = fake_cars:short_strip
strip = fake_cars:short_strip
number = fake_cars:NUMBER
gone = fake_cars_gone:short_strip

[craftsim.skills]
waiting = fake_cars:WAITING

[craftsim.machines]
heavy = fake_cars:HEAVY
number = fake_cars:NUMBER
"""
COMMAND = ["--policy", "random", "--trials", "1"]


def _install(folder, name, entry_points):
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(entry_points)


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Return a folder of packages in which one has tasks, skills and machines."""
    folder = tmp_path / "packages"
    folder.mkdir()
    (folder / "fake_cars.py").write_text(MODULE)
    (folder / "fake_heavy.yaml").write_text(
        "smartcar: {chassis_mass_kg: 1.5}\ngains: {drive: {settle_allowance: 2.5}}\n"
    )
    _install(folder, "fake_cars", ENTRY_POINTS)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.chdir(tmp_path)
    yield folder
    sys.modules.pop("fake_cars", None)


def test_a_task_is_known_by_its_name_and_imported_when_it_is_named(installed):
    assert plug_ins("tasks")["short_strip"] == "fake_cars:short_strip"
    assert "fake_cars" not in sys.modules
    assert as_task("short_strip").max_steps == 4
    assert craftsim.parallel_env("short_strip", "grid").possible_agents == ["car_0", "car_1"]
    # A package takes no name of ours.
    assert as_task("strip").max_steps == craftsim.make_task("strip").max_steps


def test_skills_and_machines_are_known_by_their_names(installed):
    assert [entry.skill for entry in own_skills("waiting")] == ["fake_cars:Wait"]
    setup = setup_of(machines="heavy", skills="waiting")
    assert setup.machines.car(0).chassis_mass_kg == 1.5
    assert setup.gains.drive.settle_allowance == 2.5
    assert [entry.action for entry in setup.skills] == ["LIFT"]


def test_commands_take_the_names(installed, tmp_path, capsys):
    assert main(["validate", "short_strip", *COMMAND, "--out", "run"]) in (0, 1)
    assert main(["machine", "check", "heavy", "--out", "machine"]) in (0, 1)
    assert "short_strip" in (tmp_path / "run" / "report.json").read_text()
    assert main(["doctor"]) == 0
    assert "installed tasks short_strip, strip, number, gone" in " ".join(
        capsys.readouterr().out.split()
    )


def test_no_file_imports_what_a_package_offers(installed, capsys):
    with pytest.raises(InputError, match="unknown task 'short_strip'"):
        known_task("short_strip")
    (installed.parent / "config.yaml").write_text(
        "command: validate\noptions: {worlds: [short_strip], machines: heavy}\n"
    )
    assert main(["validate", "--config", "config.yaml", *COMMAND]) == 2
    assert "code is given on the command line alone" in capsys.readouterr().err
    assert "fake_cars" not in sys.modules


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: as_task("number"), "'NUMBER' is neither a Task nor callable, but int"),
        (lambda: as_task("gone"), "module 'fake_cars_gone' cannot be imported"),
        (lambda: as_task("short_strip", n_cars=3), "has its own area and numbers"),
        (lambda: as_task("short_stripp"), "did you mean 'short_strip'"),
        (lambda: own_skills("wait"), "MyLift}, waiting"),
        (lambda: setup_of(machines="number"), "is a int; it must be the path of a YAML file"),
    ],
)
def test_what_cannot_be_used_says_so(installed, call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_two_packages_with_one_name_are_an_error(installed):
    _install(installed, "other_cars", "[craftsim.tasks]\nshort_strip = other_cars:short\n")
    with pytest.raises(InputError, match="two installed packages offer tasks 'short_strip'"):
        as_task("short_strip")
