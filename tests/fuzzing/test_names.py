"""Nothing that a data file names is imported: in every format each word in turn is replaced by the name of code.

``module:factory`` and ``module:function`` are for the command line and for Python alone. A case is a file that is as it
should be but for one word, which names a module of the working folder. That module leaves a mark when it is imported,
in whatever process.
"""

import contextlib
import io
import json
import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from craftsim.cli import main
from craftsim.errors import InputError
from craftsim.learning.checkpoint import POLICY_FILE, RUN_FILE
from craftsim.tasks import as_task
from fuzzing.damage import CODECS, places
from fuzzing.formats import FORMATS, trained

NAME = "planted_module:make"
MODULE = """\
from pathlib import Path

Path(__file__).with_name("imported").touch()


def make(*given):
    from craftsim.tasks import make_task

    return make_task("strip")
"""
NAMING = ("names", "task names")
"""Words of the command line, which may name code."""
PACKED = ("picture", "mesh", "message")
"""What holds no words."""
SMALL = ["--worlds", "2", "--width", "4", "--steps", "1", "--episodes", "1"]
GRID = ["--backend", "grid", "--trials", "1"]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Return a working folder with a module in it, which this process and those that it starts could import."""
    (tmp_path / "planted_module.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    yield tmp_path
    sys.modules.pop("planted_module", None)


def _run(*words: str) -> int:
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        return main(words)


def _imported(place: Path) -> bool:
    return (place / "imported").exists()


def _renamed(name: str, data: bytes) -> Iterator[bytes]:
    """Yield a file, each time with another of its words replaced; one with a codec, of its document."""
    if not (codecs := CODECS.get(Path(name).suffix, ())):
        for one in re.finditer(rb"[A-Za-z_][\w@.]*(?!\w*:)", data):
            quote = b'"' * name.endswith(".yaml")
            yield data[: one.start()] + quote + NAME.encode() + quote + data[one.end() :]
        return
    unpack, pack = codecs[0]
    document = unpack(data)
    for holder, key in places(document):
        before = holder[key]
        if isinstance(before, str) or (isinstance(before, list) and not before):
            holder[key] = NAME if isinstance(before, str) else [NAME]
            yield pack(document)
        elif (
            isinstance(before, np.ndarray)
            and before.dtype == np.uint8
            and bytes(before[:1]) == b"{"
        ):
            for text in _renamed("a.json", before.tobytes()):
                holder[key] = np.frombuffer(text, np.uint8)
                yield pack(document)
        holder[key] = before


def test_the_command_line_and_python_import_what_they_name(place):
    """What the tests below look for can be seen."""
    assert _run("validate", NAME, *GRID, "--policy", "random_strip") in (0, 2)
    assert _imported(place)
    (place / "imported").unlink()
    del sys.modules["planted_module"]
    assert as_task(NAME).name == "strip"
    assert _imported(place)


@pytest.mark.parametrize("name", [name for name in FORMATS if name not in (*NAMING, *PACKED)])
def test_no_word_of_a_file_is_imported_when_it_is_read(name, place):
    for files in FORMATS[name].examples()[:2]:
        first, *_ = files
        for number, changed in enumerate(_renamed(first, files[first])):
            folder = place / str(number)
            folder.mkdir()
            for file, data in files.items():
                (folder / file).write_bytes(changed if file == first else data)
            with contextlib.suppress(InputError):
                FORMATS[name].read(folder)
            assert not _imported(place), changed
            shutil.rmtree(folder)


def _trained(place: Path, name: str, **changes: object) -> None:
    """Write a file of training whose configuration says otherwise."""
    unpack, pack = CODECS[Path(name).suffix][0]
    document = unpack(trained(name)[name])
    document["head"]["config"] |= changes
    (place / name).write_bytes(pack(document))


@pytest.mark.parametrize(
    "changes", [{"task": NAME}, {"stages": [NAME], "stage_steps": 5}, {"pretrained": NAME}]
)
def test_no_command_imports_what_a_policy_or_run_names(changes, place):
    _trained(place, POLICY_FILE, **changes)
    _trained(place, RUN_FILE, **changes)
    for words in (
        ["validate", *GRID, "--policy", POLICY_FILE],
        ["train", "--pretrained", POLICY_FILE, *SMALL, "--out", "t"],
        ["train", *SMALL, "--resume", "--out", "."],
        ["validate", "strip", "--policy", POLICY_FILE, "--trials", "1", "--timeout", "0.01"],
    ):
        _run(*words)
        assert not _imported(place), words


@pytest.mark.parametrize(
    ("words", "options"),
    [
        ("validate", {"worlds": [NAME]}),
        ("validate", {"policy": [NAME]}),
        ("validate", {"skills": NAME}),
        ("validate --plan auto", {"worlds": [NAME]}),
        ("demo --no-video", {"task": NAME, "plan": "a.plan"}),
        ("demo --no-video", {"skills": NAME}),
        ("train", {"task": NAME}),
        ("train", {"stages": [NAME], "stage-steps": 5}),
        ("tune drive", {"skills": NAME}),
        ("plan", {"start": NAME}),
        ("render", {"source": NAME}),
        ("render strip --out film.png", {"policy": NAME}),
        ("audit --quick", {"skills": NAME}),
        ("audit margins --quick", {"skills": NAME}),
        ("replay gone", {"skills": NAME}),
        ("robot serve --once", {"task": NAME}),
        ("robot excite", {"skills": NAME}),
    ],
)
def test_no_command_imports_what_a_configuration_names(words, options, place):
    (place / "config.yaml").write_text(json.dumps({"options": options}))
    assert _run(*words.split(), "--config", "config.yaml") == 2
    assert not _imported(place)
    assert not (place / "out").exists()


def test_no_configuration_says_where_results_are_written(place):
    (place / "config.yaml").write_text(
        json.dumps({"options": {"building": ["wall"], "out": str(place / "elsewhere")}})
    )
    assert _run("design", "--config", "config.yaml") == 2
    assert not (place / "elsewhere").exists()
    assert not (place / "out").exists()
