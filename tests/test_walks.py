"""A reader who follows a page from its top finds every file that a command reads; tutorials are walked literally."""

import os
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest
from pages import ROOT, Step, steps_of, words_of

from craftsim.cli.app import bind
from craftsim.cli.validate import default_folder

PAGES = [
    "README.md",
    *sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md")),
]
WITH_COMMANDS = [page for page in PAGES if any(step.kind == "shell" for step in steps_of(page))]
TUTORIALS = [page for page in WITH_COMMANDS if page.startswith("docs/tutorials/")]
WRITES = ("--out", "--export", "--learn")
INSTALLS = re.compile(r"source |git |\S*pip install ")
"""How commands begin that prepare a machine, which the tests do not do again."""
IS_PATH = re.compile(r"[\w./@-]+")
ENDINGS = (
    ".yaml",
    ".plan",
    ".actions",
    ".npz",
    ".csv",
    ".mp4",
    ".png",
    ".obj",
    ".stl",
    ".mcap",
    ".py",
)


def _is_path(word: str) -> bool:
    return IS_PATH.fullmatch(word) is not None and ("/" in word or word.endswith(ENDINGS))


def _written_by(words: list[str]) -> set[str]:
    """Return the files and folders that a command writes, as far as its words and defaults say."""
    written = {word for option, word in pairwise(words) if option in WRITES}
    if words[0] == "make" and words[1] == "demo":
        return {"out/demo"}
    if words[0] != "craftsim" or "--plugins" in words:
        return written
    _, bound = bind(words[1:])
    bound.apply_defaults()
    folder = bound.arguments.get("out")
    if folder is None and words[1] == "validate":
        folder = default_folder(bound.arguments["backend"])
    return written if folder is None else written | {str(folder), f"{folder}/"}


def _read_by(words: list[str]) -> list[str]:
    """Return the words of a command that are paths it reads."""
    pairs = zip(["", *words], words, strict=False)
    paths = [word for option, word in pairs if option not in WRITES and _is_path(word)]
    return [path for path in paths if path not in _written_by(words)]


def _is_there(path: str, written: set[str]) -> bool:
    """Return whether a path is, holds, or is within something that was written."""
    return any(
        f"{path}/".startswith(f"{one.rstrip('/')}/") or f"{one}/".startswith(f"{path.rstrip('/')}/")
        for one in written
    )


@pytest.mark.parametrize("page", WITH_COMMANDS)
def test_what_a_command_reads_was_saved_or_written_before_or_is_shipped(page):
    """In a tutorial. In other pages the text may name the file instead: the reader is to have it."""
    written: set[str] = set()
    prose = re.sub(
        r"^```sh\n.*?^```", "", (ROOT / page).read_text(encoding="utf-8"), flags=re.DOTALL | re.M
    )
    for step in steps_of(page):
        if step.kind == "save":
            written.add(step.name)
        elif step.kind == "shell" and not INSTALLS.match(step.text):
            words = words_of(step)
            for path in _read_by(words):
                shipped = (ROOT / path.removeprefix("CHECKOUT/")).exists()
                named = page not in TUTORIALS and Path(path).name in prose
                assert shipped or named or _is_there(path, written), f"{step.text}: {path}"
            written |= _written_by(words)


@pytest.mark.parametrize("page", TUTORIALS)
def test_no_two_kinds_of_run_of_a_tutorial_share_a_folder(page):
    """A run replaces an earlier one of its own kind alone."""
    kinds: dict[str, set[str]] = {}
    for step in steps_of(page):
        if step.kind == "shell" and step.text.startswith("craftsim "):
            words = words_of(step)
            kind = (
                f"{words[1]} on the grid"
                if "grid" in words and words[1] == "validate"
                else words[1]
            )
            for folder in _written_by(words):
                kinds.setdefault(folder.rstrip("/"), set()).add(kind)
    assert {folder: found for folder, found in kinds.items() if len(found) > 1} == {}


STATUS_1 = {
    "craftsim machine check unladen_car.yaml",
    "craftsim validate yard.yaml --plan wrong.plan --trials 1",
    "craftsim validate corner.yaml --plan corner.plan --rules published --randomize none --trials 1 --out out/corner",
    "craftsim validate out/replay/smallest.yaml --actions out/replay/smallest.actions --rules published "
    "--randomize none --trials 1",
    "craftsim validate corner.yaml --plan corner.plan --trials 1 --out out/physical",
}
"""Commands of which the page says that they find a failure."""
MAY_FAIL = ("craftsim validate random_strip@test --policy",)
"""How commands begin that compare policies in random physics, in which an action may fail."""


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS)
def test_a_tutorial_is_walked_word_for_word(page, tmp_path):
    """In one fresh folder, every file saved, every command and every program run as it is printed."""
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    for step in steps_of(page):
        if step.kind == "save":
            (tmp_path / step.name).write_text(step.text, encoding="utf-8")
            continue
        command = _command_of(step)
        if command is None:
            continue
        done = subprocess.run(
            command,
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=3600,
        )
        allowed = (1,) if step.text.strip() in STATUS_1 else (0,)
        allowed = (0, 1) if step.text.startswith(MAY_FAIL) else allowed
        assert done.returncode in allowed, (
            f"{step.text}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        )


def _command_of(step: Step) -> list[str] | None:
    """Return the command of a step; None for one that prepares a machine."""
    if step.kind == "python":
        return [sys.executable, "-c", step.text]
    if INSTALLS.match(step.text):
        return None
    # The checkout is installed already: of "make demo" its command is left.
    text = step.text.replace("CHECKOUT", str(ROOT)).replace(
        "make demo", "craftsim demo --out out/demo"
    )
    return ["bash", "-c", text]
