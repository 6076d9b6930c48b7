"""Plant an unsound rule, and see whether a quick audit finds it. Run by ``plants.py``; some minutes a plant.

The package is copied, one place of its rules is changed such that they allow what physics refuses, and
``craftsim audit --rules physical --quick --workers 2`` is run on the copy. ``ARGS`` are parts of names of plants.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from craftsim.discrete.kinds import Correction
from craftsim.discrete.rules import REASONS

sys.path.append(str(Path(__file__).parents[1]))
from discrete.mutants import never

ROOT: Final = Path(__file__).parents[2]
COMMAND: Final = "-m craftsim audit --rules physical --quick --workers 2 --out out"
SITUATIONS: Final = """
import json
from craftsim.audit.plan import audit_plan
plan = audit_plan("physical")
print(json.dumps({member.id: row.name for row in plan if row.legal for member in row.members}))
"""
"""Prints the situations that the rules allow, with their rows."""


@dataclass(frozen=True)
class Plant:
    """What a rule set allows by mistake, and what is changed in the source to that end: a regular expression."""

    rule: str
    file: str
    old: str
    new: str
    places: int = 1
    """How many places match."""


def _without(correction: Correction) -> Plant:
    name = correction.name
    return Plant(
        f"{name} off",
        "rules.py",
        re.escape('"physical": ~Correction(0)'),
        f'"physical": ~Correction.{name}',
    )


def _never(what: str, code: str, places: int = 1) -> Plant:
    """Return a plant in which the rules never give a reason."""
    return Plant(what, "kernel/rules.py", never(code).old, "code.LEGAL", places)


PLANTS: Final = (
    # Coming down a ramp under a block goes wrong in few of many trials: no quick look need find it. Gears that cross do
    # harm in starts in which a load has no room, and these an audit leaves out.
    *(
        _without(reason.correction)
        for reason in REASONS.values()
        if reason.correction not in (None, Correction.run_out, Correction.crossing_gear)
    ),
    _never("lifting or folding with something on top", "THING_ON_TOP", 2),
    _never("driving loaded under a block", "LOAD_NOT_UNDER"),
    _never("driving loaded through a gear", "LOAD_NOT_THROUGH_GEAR"),
    _never("turning under a slope", "TURN_UNDER_SLOPE"),
    _never("leaving a slope sideways", "FORWARD_ONLY"),
    Plant(
        "unfolding onto a car",
        "kernel/rules.py",
        re.escape("if car_in(w, me, fx, fy, car.z, False) >= 0 or "),
        "if ",
    ),
    _never("folding with a car on the foot", "CAR_ON_OWN_FOOT"),
    _never("driving into a car's cell", "CAR_THERE"),
    # Standing on what has no top, and driving sideways under a block, are none: forbidden, and in physics they work.
)


def copy_of(package: Path, place: Path, plant: Plant) -> Path:
    """Copy the package with a plant in its rules into a folder, and return the file that was changed."""
    shutil.copytree(package, place / "craftsim", ignore=shutil.ignore_patterns("__pycache__"))
    source = place / "craftsim" / "discrete" / plant.file
    source.write_text(re.sub(plant.old, plant.new, source.read_text()))
    return source


def look(plant: Plant, allowed: dict[str, str]) -> tuple[set[str], set[str], list[str]]:
    """Audit a plant quickly; ``allowed`` has the situations that the rules allow without it.

    Returns the rows of a full audit that hold a situation that only the planted rules allow, those of them that the
    quick one tried, and those that it found unsound.
    """
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        copy_of(ROOT / "craftsim", place, plant)
        run = _python(place, *shlex.split(COMMAND))
        if run.returncode not in (0, 1) or not (place / "out" / "report.json").exists():
            raise RuntimeError(run.stdout + run.stderr)
        figures = json.loads((place / "out" / "report.json").read_text())["figures"]
        planted = situations(place)
    rows = figures["audit"]["rows"]
    legal = {f"{row['action']}/{row['context']}": row["verdict"] for row in rows if row["legal"]}
    new = {row for situation, row in planted.items() if situation not in allowed}
    # Others fail now and then by these rules, too.
    return (
        new,
        new & set(legal),
        [name for name in legal if name in new and legal[name] == "unsound"],
    )


def situations(place: Path) -> dict[str, str]:
    """Return the situations that the rules of a copy allow, with the names of their rows."""
    return dict(json.loads(_python(place, "-c", SITUATIONS).stdout))


def _python(place: Path, *words: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(place)}
    return subprocess.run(
        [sys.executable, *words],
        cwd=place,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def main(parts: list[str]) -> int:
    """Print for each plant what a quick audit finds; return 1 if one that changes a row goes unnoticed."""
    allowed = situations(ROOT)
    chosen = [plant for plant in PLANTS if not parts or any(part in plant.rule for part in parts)]
    missed = 0
    for plant in chosen:
        changed, tried, unsound = look(plant, allowed)
        missed += bool(changed and not unsound)
        word = (
            f"found: {len(unsound)} unsound rows, such as {unsound[0]}" if unsound else "NOT FOUND"
        )
        word += "" if changed else " (no row of a full audit changes)"
        print(
            f"{plant.rule}: {word}; {len(tried)} of {len(changed)} changed rows tried", flush=True
        )
    print(f"{len(chosen)} plants, {missed} that change a row not found")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
