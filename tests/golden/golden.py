"""Golden records: what craftsim does now, so that a later change shows what else it changes.

``make golden`` computes every record again and compares; ``ARGS=--write`` stores them; ``ARGS='--base REVISION'``
computes both sides here, one of them in a checkout of that revision. Names of records after these options choose some.

A difference is shown line by line where a record holds the lines of a text, and with ``--base`` also where it holds the
digest of one.

Records of rules and plans are the same everywhere, texts with one version of Python, and results of floating-point
physics and networks on one machine with one set of versions. A record that was stored under others is not compared;
``--base`` compares it.
"""

from __future__ import annotations

import argparse
import difflib
import hashlib
import importlib.metadata
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal

RECORDS = Path(__file__).parent / "records"
FULL = 1_500
"""Values of at most so many characters are stored whole, larger ones part by part, what has no parts as a digest."""
MANY = 60
"""Of a mapping with more keys than this, values of more characters than this are stored as digests."""
LINES = 400
"""Texts of at most so many lines are stored whole."""
SHOWN = 40
"""How many lines of the differences of a record are listed."""
TEXTS = "texts"
"""Folder of the texts of which a record has digests, by these, within that of whole values."""
_digested: dict[str, str] = {}

Same = Literal["everywhere", "python", "machine"]


@dataclass(frozen=True)
class Kind:
    """What computes a record, and what may be asked of it."""

    make: Callable[[], Any]
    same: Same
    """Where it is the same."""
    fast: bool
    """Whether ``make test`` compares it, too."""


KINDS: dict[str, Kind] = {}


def record(
    same: Same = "machine", fast: bool = False
) -> Callable[[Callable[[], Any]], Callable[[], Any]]:
    """Register a function that returns a record made of what JSON knows, under its name."""

    def register(make: Callable[[], Any]) -> Callable[[], Any]:
        KINDS[make.__name__] = Kind(make, same, fast)
        return make

    return register


def machine() -> str:
    """Return what decides the last bits of a float: processor and versions."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        named = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        model = named[0].partition(":")[2].strip() if named else model
    names = ("mujoco", "numpy", "numba", "scipy", "torch")
    found = [f"{name} {importlib.metadata.version(name)}" for name in names if _installed(name)]
    kernels = os.environ.get("OPENBLAS_CORETYPE", "")
    return ", ".join(
        [model, platform.machine(), f"python {platform.python_version()}", *found, kernels]
    )


def _installed(name: str) -> bool:
    try:
        return bool(importlib.metadata.version(name))
    except importlib.metadata.PackageNotFoundError:
        return False


def text(value: Any) -> str:
    """Return a value as JSON, always the same for equal values."""
    return json.dumps(value, sort_keys=True, ensure_ascii=False, allow_nan=True)


def digest(data: bytes | str) -> str:
    """Return the SHA-256 of bytes or a text, shortened; a text is written beside the whole values."""
    sha = hashlib.sha256(data.encode() if isinstance(data, str) else data).hexdigest()[:16]
    if isinstance(data, str):
        _digested[sha] = data
    return sha


def compact(value: Any) -> Any:
    """Return a value with its large parts as digests, so that records stay small and still say where they differ."""
    if len(text(value)) <= FULL:
        return value
    if isinstance(value, dict) and len(value) > MANY:
        return {
            key: part if len(text(part)) <= MANY else digest(text(part))
            for key, part in value.items()
        }
    if isinstance(value, dict):
        return {key: compact(part) for key, part in value.items()}
    if _are_lines(value) and len(value) <= LINES:
        return value
    if isinstance(value, list) and len(value) <= 40:
        return [compact(part) for part in value]
    return f"sha256 {digest(text(value))} of {len(value)}"


def differences(
    old: Any, new: Any, path: str = "", texts: tuple[Path, Path] | None = None
) -> Iterator[str]:
    """Yield a line for each place at which two records differ, and those lines of texts that differ.

    ``texts`` are the folders with the texts of which the records have digests.
    """
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted(old.keys() | new.keys()):
            if key not in new or key not in old:
                yield f"{path}/{key}: {'gone' if key in old else 'new'}"
            else:
                yield from differences(old[key], new[key], f"{path}/{key}", texts)
    elif _are_lines(old) and _are_lines(new):
        yield from _line_differences(old, new, path)
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for i, (old_part, new_part) in enumerate(zip(old, new, strict=True)):
            yield from differences(old_part, new_part, f"{path}[{i}]", texts)
    elif text(old) != text(new):
        if texts is not None:
            old_lines = _lines(texts[0], str(old))
            new_lines = _lines(texts[1], str(new))
            if old_lines and new_lines:
                yield from _line_differences(old_lines, new_lines, path)
                return
        yield f"{path}: {text(old)[:160]} -> {text(new)[:160]}"


def _are_lines(value: Any) -> bool:
    """Return whether a value is a text by lines, and no list of digests."""
    return isinstance(value, list) and all(
        isinstance(part, str) and not re.fullmatch("[0-9a-f]{16}", part) for part in value
    )


def _lines(folder: Path, sha: str) -> list[str]:
    """Return the lines of a text that was digested, of digests in it the lines of theirs; none if it was none."""
    path = folder / f"{sha}.txt"
    if not path.exists():
        return []
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if re.fullmatch("([0-9a-f]{16})+", line):
            for start in range(0, len(line), 16):
                lines += _lines(folder, line[start : start + 16])
        else:
            lines.append(line)
    return lines


def _line_differences(old: list[str], new: list[str], path: str) -> Iterator[str]:
    """Yield the lines that only one of two texts has, each with its number there."""
    blocks = difflib.SequenceMatcher(None, old, new, autojunk=False).get_opcodes()
    for change, old_start, old_end, new_start, new_end in blocks:
        if change == "equal":
            continue
        for number in range(old_start, old_end):
            yield f"{path}:{number + 1} - {old[number]}"
        for number in range(new_start, new_end):
            yield f"{path}:{number + 1} + {new[number]}"


def compute(name: str, out: Path | None = None) -> tuple[Any, float]:
    """Return a record, compact, and the seconds that it took; all of it is written to a folder if one is given."""
    from . import commands, worlds  # noqa: F401  (they register the records)

    begun = time.perf_counter()
    value = json.loads(text(KINDS[name].make()))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / f"{name}.json").write_text(
            json.dumps(value, indent=1, sort_keys=True, ensure_ascii=False)
        )
        (out / TEXTS).mkdir(exist_ok=True)
        for sha, content in _digested.items():
            (out / TEXTS / f"{sha}.txt").write_text(content, encoding="utf-8")
    return compact(value), time.perf_counter() - begun


def stored(name: str, folder: Path = RECORDS) -> dict[str, Any]:
    """Return what is stored of a record: ``machine`` and ``value``."""
    found: dict[str, Any] = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    return found


def where(name: str) -> str:
    """Return what a record can be compared on."""
    python = ".".join(platform.python_version_tuple()[:2])
    return {"everywhere": "any", "python": f"python {python}", "machine": machine()}[
        KINDS[name].same
    ]


def store(name: str, value: Any, folder: Path) -> None:
    """Write a record."""
    folder.mkdir(parents=True, exist_ok=True)
    content = json.dumps(
        {"machine": where(name), "value": value}, indent=1, sort_keys=True, ensure_ascii=False
    )
    (folder / f"{name}.json").write_text(content + "\n", encoding="utf-8")


def names() -> list[str]:
    """Return the names of all records."""
    from . import commands, worlds  # noqa: F401  (they register the records)

    return list(KINDS)


def _at(revision: str, chosen: list[str], folder: Path) -> None:
    """Store the records of another revision in a folder, computed in a checkout of it."""
    root = Path(__file__).parents[2]
    tree = folder / "tree"
    subprocess.run(["git", "-C", root, "worktree", "add", "--detach", tree, revision], check=True)
    try:
        path = os.pathsep.join([str(tree), str(tree / "tests")])
        words = [
            sys.executable,
            "-m",
            "golden",
            "--write",
            "--records",
            str(folder / "records"),
            "--full",
            str(folder / "old"),
            *chosen,
        ]
        subprocess.run(words, cwd=tree, env=os.environ | {"PYTHONPATH": path}, check=True)
    finally:
        subprocess.run(["git", "-C", root, "worktree", "remove", "--force", tree], check=True)


def main() -> int:
    """Compare or store records; return 1 where one differs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument(
        "records_named", nargs="*", metavar="RECORD", help="those to compute; all unless given"
    )
    parser.add_argument(
        "--write", action="store_true", help="store the records instead of comparing"
    )
    parser.add_argument(
        "--base", metavar="REVISION", help="compare with what this revision computes here"
    )
    parser.add_argument(
        "--records", type=Path, default=RECORDS, help="folder of the stored records"
    )
    parser.add_argument(
        "--full", type=Path, help="folder for the whole values, to look into a difference"
    )
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    unknown = set(given.records_named) - set(names())
    if unknown:
        parser.error(f"no record {', '.join(sorted(unknown))}; there are {', '.join(names())}")
    chosen = given.records_named or names()
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.records
        full = given.full
        texts = None
        if given.base:
            _at(given.base, chosen, Path(temporary))
            folder = Path(temporary) / "records"
            full = full or Path(temporary) / "new"
            texts = (Path(temporary) / "old" / TEXTS, full / TEXTS)
        with ProcessPoolExecutor(
            given.workers, get_context("spawn"), max_tasks_per_child=1
        ) as pool:
            results = dict(
                zip(chosen, pool.map(compute, chosen, [full] * len(chosen)), strict=True)
            )
        return _conclude(results, folder, given.write, texts)


def _conclude(
    results: dict[str, tuple[Any, float]],
    folder: Path,
    write: bool,
    texts: tuple[Path, Path] | None,
) -> int:
    differing = 0
    for name, (value, seconds) in results.items():
        if write:
            store(name, value, folder)
            print(f"{name}: stored ({seconds:.0f} s)")
            continue
        if not (folder / f"{name}.json").exists():
            print(f"{name}: NOT STORED; make golden ARGS='--write {name}'")
            differing += 1
            continue
        old = stored(name, folder)
        if old["machine"] != where(name):
            print(
                f"{name}: not compared: stored on {old['machine']}; ARGS='--base REVISION' compares here"
            )
            continue
        found = list(differences(old["value"], value, texts=texts))
        differing += bool(found)
        print(f"{name}: {f'{len(found)} DIFFERENCES' if found else 'equal'} ({seconds:.0f} s)")
        for line in found[:SHOWN]:
            print(f"  {line}")
        if len(found) > SHOWN:
            print(f"  and {len(found) - SHOWN} more")
        if found and texts is None:
            print(f"  ARGS='--base REVISION {name}' shows the lines of what is stored as a digest")
    print(
        f"{len(results) - differing} of {len(results)} records {'stored' if write else 'without a difference'}"
    )
    return 1 if differing else 0
