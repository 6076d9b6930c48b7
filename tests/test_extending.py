"""What docs/extending.md says works: an action is added to a copy of the package, performed and audited."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import craftsim

ROOT = Path(__file__).parents[1]
PACKAGE = Path(craftsim.__file__).parent
TEXT = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
SECTIONS = dict(re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", TEXT, re.MULTILINE | re.DOTALL))
PROGRAM = "push.py"

PARTS = {
    "craftsim/discrete/kinds.py": "PUSH",
    "craftsim/discrete/kernel/codes.py": "PUSH",
    "craftsim/discrete/reasons.py": "of craftsim/discrete/kernel/codes.py has no words in craftsim/discrete/reasons.py",
    "craftsim/discrete/kernel/rules.py": "PUSH is not chosen by why() in craftsim.discrete.kernel.rules",
    "craftsim/discrete/kernel/effects.py": "PUSH is not chosen by apply() in craftsim.discrete.kernel.effects",
    "craftsim/discrete/actions.py": "PUSH has a number in craftsim/discrete/kinds.py, but no row in "
    "craftsim/discrete/actions.py",
    "craftsim/data/durations.yaml": "PUSH: no row 'push' in craftsim/data/durations.yaml",
    "craftsim/skills/pushing.py": "No module named 'craftsim.skills.pushing'",
    "craftsim/skills/library.py": "PUSH has no skill in craftsim/skills/library.py",
}
"""The nine files, and what is said without each."""


def _examples(section):
    """Yield (file, kind, text) of each example of a section that names its file in its first line."""
    for kind, block in re.findall(
        r"^```(python|diff)\n(.*?)^```", SECTIONS[section], re.MULTILINE | re.DOTALL
    ):
        first, _, rest = block.partition("\n")
        if first.startswith(("# ", "--- ")):
            yield first.split(" ", 1)[1], kind, rest


def _edited(text, diff):
    """Return a text with one edit: lines marked + come in, lines marked - go, all others find the place."""
    lines = diff.splitlines()
    old = "".join(f"{line[1:]}\n" for line in lines if line[0] in " -")
    new = "".join(f"{line[1:]}\n" for line in lines if line[0] in " +")
    assert text.count(old) == 1, f"the document's edit does not fit its file:\n{old}"
    return text.replace(old, new)


def _copy_with_push(place, without=None):
    """Copy the package, and follow the document but for one file."""
    ignored = shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc")
    shutil.copytree(PACKAGE, place / "craftsim", ignore=ignored)
    for file, kind, text in _examples("An action"):
        if file == without:
            continue
        path = place / file
        path.write_text(_edited(path.read_text(encoding="utf-8"), text) if kind == "diff" else text, "utf-8")


def _run(place, **environment):
    return subprocess.run(
        [sys.executable, PROGRAM],
        cwd=place,
        env={**os.environ, "PYTHONPATH": str(place), **environment},
        capture_output=True,
        text=True,
        check=False,
    )


def test_push_takes_the_nine_files_that_are_named():
    touched = list(dict.fromkeys(file for file, _, _ in _examples("An action") if file != PROGRAM))
    assert touched == [*PARTS]
    assert len(touched) <= 9


def test_push_is_performed_in_physics_and_audited(tmp_path):
    _copy_with_push(tmp_path)
    # Plain Python is quicker here than compiling the copy's rules.
    done = _run(tmp_path, NUMBA_DISABLE_JIT="1")
    assert done.returncode == 0, done.stderr
    said = done.stdout.splitlines()
    assert said[:2] == ["PUSH is legal", "as predicted 2,1,1 +x"]
    assert re.fullmatch(r"the block is 0\.\d mm off, nothing else moved: True", said[2])
    assert said[3] == "the table's time: True"
    assert re.fullmatch(r"[1-9]\d* legal rows, all as predicted: True", said[4])
    assert said[5].startswith("PUSH is forbidden: there is nothing to push in (1, 0, 1)")


@pytest.mark.parametrize("missing", PARTS)
def test_a_part_that_is_left_out_is_named(tmp_path, missing):
    _copy_with_push(tmp_path, without=missing)
    done = _run(tmp_path, NUMBA_DISABLE_JIT="1")
    assert done.returncode != 0
    assert PARTS[missing] in done.stderr.splitlines()[-1]


@pytest.mark.parametrize("section", [name for name in SECTIONS if name != "An action"])
def test_the_other_examples_run(section, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for file, kind, text in _examples(section):
        assert kind == "python"
        Path(file).write_text(text, encoding="utf-8")
        done = subprocess.run(
            [sys.executable, file],
            env={**os.environ, "PYTHONPATH": str(PACKAGE.parent)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
