"""Golden records of the command line: reports of fixed runs, help, messages about bad files, bundles and a film."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from discrete.test_hostile import HOSTILE

from craftsim import cli
from craftsim.cli.commands import COMMANDS
from craftsim.discrete.files.shipped import shipped_plan

from .golden import digest, record

TESTS = Path(__file__).parents[1]
ROLLERS = ("--drive", "rollers")


@contextlib.contextmanager
def _work() -> Iterator[Path]:
    """Work in an empty folder, on a terminal of 100 columns."""
    before, columns = Path.cwd(), os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = "100"
    try:
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            yield Path(folder)
    finally:
        os.chdir(before)
        os.environ.pop("COLUMNS")
        if columns is not None:
            os.environ["COLUMNS"] = columns


def run(*words: str) -> tuple[int, str]:
    """Run a command in the present folder; return its exit status and what it printed."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            status = cli.main(list(words))
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else 2
    return status, said.getvalue()


def _report(*words: str) -> dict[str, Any]:
    """Return the exit status and the report of a command, without clock and versions."""
    status, said = run(*words, "--out", "out")
    if not Path("out/report.json").exists():
        raise RuntimeError(f"{' '.join(words)} wrote no report: {said[-2000:]}")
    report = json.loads(Path("out/report.json").read_text(encoding="utf-8"))
    return {"status": status} | {
        key: value for key, value in report.items() if key not in ("wall", "versions")
    }


def _reporting(name: str, *words: str) -> Callable[[], Any]:
    def make() -> Any:
        with _work():
            return _report(*words)

    make.__name__ = name
    return record()(make)


_PHYSICS = ("--randomize", "mild", "--order", "ticks", "--trials", "3", "--video", "none")
_FLOOR = ("--randomize", "workshop_floor", "--order", "ticks", "--trials", "2", "--video", "none")

_reporting("demo", "demo", "--no-video", "--randomize", "none")
_reporting("demo_rollers", "demo", "--no-video", "--randomize", "none", *ROLLERS)
_reporting(
    "validate_plans",
    "validate",
    "--randomize",
    "none",
    "--order",
    "ticks",
    "--trials",
    "1",
    "--video",
    "none",
)
_reporting(
    "validate_policy", "validate", "random_strip@test", "--policy", "random_strip", *_PHYSICS
)
_reporting("validate_floor", "validate", "strip", "simple_two_story", *_FLOOR)
_reporting("validate_random", "validate", "random", "--seed", "5", *_PHYSICS)
_reporting("audit_physical", "audit", "--quick", "--rules", "physical")
_reporting("margins", "audit", "margins", "--quick", "--situations", "lift*", "--trials", "20")
_reporting("tune", "tune", "drive", "--evaluations", "12", "--trials", "1")
_reporting("train", "train", "--task", "strip", "--steps", "20000", "--episodes", "50")


@record()
def audit_published() -> Any:
    """The quick audit of CraftEnv's rules, and twenty of its replay bundles, which replay bit for bit."""
    with _work() as folder:
        report = _report("audit", "--quick", "--rules", "published")
        bundles = sorted(path for path in (folder / "out" / "bundles").iterdir() if path.is_dir())
        some = bundles[:: max(1, len(bundles) // 20)][:20]
        report["bundles"] = {path.name: _bundle(path) for path in some}
        return report


def _bundle(path: Path) -> Any:
    said = json.loads((path / "bundle.json").read_text(encoding="utf-8"))
    said.pop("versions")
    found = {
        "text": digest(json.dumps(said, sort_keys=True)),
        "contacts": digest((path / "contacts.csv").read_bytes()),
    }
    for name in ("physics", "before", "after"):
        with np.load(path / f"{name}.npz") as arrays:
            found[name] = digest(
                b"".join(key.encode() + arrays[key].tobytes() for key in sorted(arrays))
            )
    return found | {"replayed": run("replay", str(path), "--out", "replayed")[0]}


@record()
def study_and_compare() -> Any:
    """A small study; and two runs of one plan on both drives, compared."""
    with _work() as folder:
        own = "title: small\ntasks: [strip, block]\nalgos: [ippo, vdn]\nseeds: 2\nsteps: 4000\n"
        (folder / "small.yaml").write_text(own, encoding="utf-8")
        study = _report("train", "study", "small.yaml")
        for drive in ("rollers", "wheels"):
            run(
                "validate",
                "strip",
                "--order",
                "ticks",
                "--trials",
                "3",
                "--video",
                "none",
                "--drive",
                drive,
                "--out",
                drive,
            )
        (folder / "out" / "report.json").unlink()
        return {"study": study, "compare": _report("compare", "rollers", "wheels")}


@record("everywhere")
def conformance() -> Any:
    """How many records and checks of CraftEnv's recordings the published rules pass."""
    with _work():
        files = [str(TESTS / "data" / f"{name}.jsonl.gz") for name in ("traces", "plans")]
        return _report("conformance", *files)["figures"]


@record()
def film() -> Any:
    """Frames of a draft film of a recorded plan, and that it shows what it should."""
    import av

    with _work():
        run("demo", "--no-video", "--randomize", "none", "--task", "strip", "--out", "strip")
        run(
            "render",
            "strip",
            "--randomize",
            "none",
            "--quality",
            "draft",
            "--size",
            "320x240",
            "--fps",
            "4",
            "--out",
            "film.mp4",
        )
        with av.open("film.mp4") as container:
            frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
        return {
            "frames": len(frames),
            "digests": [digest(frame.tobytes()) for frame in frames[::5]],
        }


@record("python", fast=True)
def help_texts() -> Any:
    """What every command says of its options."""
    with _work():
        return {command: run(command, "--help")[1].splitlines() for command in COMMANDS}


@record("python", fast=True)
def messages() -> Any:
    """What commands say of bad files and words."""
    with _work() as folder:
        (folder / "strip.plan").write_bytes(shipped_plan("strip").read_bytes())
        for name, content in HOSTILE.items():
            (folder / f"{name}.yaml").write_text(content, encoding="utf-8")
        (folder / "bad.plan").write_text("0 0 MOVE_SIDEWAYS\n", encoding="utf-8")
        (folder / "noise.yaml").write_bytes(bytes(range(256)))
        asked = {
            **{f"show {name}": ("show", f"{name}.yaml") for name in HOSTILE},
            **{f"gains {name}": ("demo", "--gains", f"{name}.yaml") for name in HOSTILE},
            "no command": ("frobnicate",),
            "no task": ("validate", "stripe"),
            "no file": ("validate", "nothing.yaml"),
            "a bad action": ("validate", "strip", "--plan", "bad.plan"),
            "a plan as a world": ("show", "strip.plan"),
            "bytes": ("show", "noise.yaml"),
            "a bad number": ("validate", "strip", "--trials", "0"),
            "a bad preset": ("validate", "strip", "--randomize", "mildly"),
            "no folder": ("replay", "nowhere"),
            "no policy": (
                "validate",
                "strip",
                "--policy",
                "nothing.safetensors",
                "--backend",
                "grid",
            ),
        }
        found = {}
        for name, words in asked.items():
            status, said = run(*words)
            found[name] = [status, re.sub(r"\s+", " ", said).strip()[:600]]
        return found
