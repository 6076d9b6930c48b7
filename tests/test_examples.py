"""Every example runs from any folder, as its reader would run it, and says what its text promises."""

import re
import shutil
from importlib.util import find_spec
from pathlib import Path

import forked
import pytest

from craftsim.cli.commands import COMMANDS

EXAMPLES = Path(__file__).parents[1] / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))

SAYS = {
    "film_an_episode": r"pictures in out/strip\.mp4; built: True",
    "heavier_car": r"shipped: (\d+) of \1 actions[^\n]*\nheavier: (\d+) of \2 actions",
    "look_ahead": r"foreseen (-\d\.\d+), came \1\n(?s:.)*\nin other processes the same: True",
    "my_gains": r"shipped gains: a move takes .*agrees: True\nmy gains: a move takes .*agrees: True",
    "own_action": r"TURN_ABOUT is legal\nin physics: as predicted, 1\.1\d s\n(?s:.)*physics: Discrete\(16\)",
    "own_reward": r"grid: -?\d\.\d\d in 8 ticks\nphysics: -?\d\.\d\d in 8 ticks",
    "own_skill": r"built in: 1\.02 s.*True\nown: 2\.14 s.*True\nown for car 0 alone: 2\.14 s.*, 1\.02 s.*True",
    "speak_a_plan": r"car_0: lift; car_1: lift\n(?s:.)*built: True",
    "starts_from_physics": r"\d+ worlds in out/reached\.npz",
    "train_my_task": r"\n2 \[",
    "two_machines": r"car 0 with 2\.5 Nm a wheel: .*\n.*car 1 with 1\.2 Nm a wheel: ",
    "validate_my_plan": r"MOVE_RIGHT",
}
"""What the output of each must match."""
SMALLER = {
    "(320, 240)": "(64, 48)",
    'randomize="none", trials=1': 'randomize="none", drive="wheels", trials=1',
    "    trials=5,\n": '    trials=1,\n    drive="wheels",\n',
}
"""What is run smaller than it is written: pictures, wheels without rollers, and fewer trials."""


def test_every_example_is_tested():
    assert set(SAYS) == {path.stem for path in SCRIPTS}


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_an_example_runs_and_says_what_it_promises(path, tmp_path, request):
    if path.stem.startswith(("starts", "train")) and not find_spec("torch"):
        pytest.skip("needs the extra 'train'")
    if path.stem.startswith("film"):
        request.getfixturevalue("rendering")
    for file in (file for file in EXAMPLES.iterdir() if file.suffix in (".yaml", ".plan")):
        shutil.copy(file, tmp_path)
    text = path.read_text(encoding="utf-8")
    for large, small in SMALLER.items():
        text = text.replace(large, small)
    (tmp_path / path.name).write_text(text, encoding="utf-8")
    done = forked.run(tmp_path / path.name, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert re.search(SAYS[path.stem], done.stdout), done.stdout


def test_an_example_is_short_and_begins_with_what_it_shows():
    for path in SCRIPTS:
        text = path.read_text(encoding="utf-8")
        assert len(text.splitlines()) < 60
        assert text.startswith('"""')
        assert set(re.findall(r"craftsim ([a-z]+)\b", text.split('"""')[1])) <= set(COMMANDS)


def test_the_list_of_examples_names_them_all():
    listed = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    for path in EXAMPLES.iterdir():
        assert f"({path.name})" in listed or path.name in ("README.md", "__pycache__")
