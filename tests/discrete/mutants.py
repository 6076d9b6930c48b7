"""Change one rule at a time, and see which tests notice. Run by ``make mutants``; takes a few seconds a mutant.

One mutant for each reason: the rules never give it, and so allow what it forbids. Others change details of rules and
effects. The package is copied, changed and tested uncompiled, which is slower to run but needs no compiling.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from craftsim.discrete.reasons import REASONS

ROOT: Final = Path(__file__).parents[2]
TESTS: Final = ("test_reasons.py", "test_moves.py", "test_marks.py", "test_helper.py", "test_corrections.py")


@dataclass(frozen=True)
class Mutant:
    """A rule, and what of the source, a regular expression, is changed to break it."""

    rule: str
    old: str
    new: str
    file: str = "kernel/rules.py"

    def change(self, source: str) -> str:
        """Return a file's text with the change."""
        return re.sub(self.old, self.new, source)


def never(code: str) -> str:
    """Return the regular expression of where a reason is given."""
    return rf"code\.{code} \| \w+ << code\.DETAIL_BITS|code\.{code}\b"


def _text(rule: str, old: str, new: str, file: str = "kernel/rules.py") -> Mutant:
    return Mutant(rule, re.escape(old), new, file)


_SOURCE: Final = (ROOT / "craftsim" / "discrete" / "kernel" / "codes.py").read_text()
_NAMES: Final = re.findall(r"^    ([A-Z_]+),$", _SOURCE.partition("\n(\n")[2].partition(")")[0], re.MULTILINE)
MUTANTS: Final = (
    *(Mutant(f"never {_NAMES[code]}", never(_NAMES[code]), "code.LEGAL") for code in REASONS),
    _text(
        "a block turns past what stands at the corners",
        "if car.load == FSLOPE and kind_at(w, corner_x",
        "if kind_at(w, corner_x",
    ),
    _text(
        "a carried gear needs room beside it",
        "if car_in(w, me, gx, gy, car.z, True) >= 0 or carried_gear_in(w, me, gx, gy, car.z, facing):",
        "if carried_gear_in(w, me, gx, gy, car.z, facing):",
    ),
    _text(
        "no loaded climb under a block",
        "(over in (BLOCK, FLAG) and car.load == AIR)",
        "over in (BLOCK, FLAG)",
    ),
    _text("a climb goes up one level", "z, slope = car.z + 1, 2", "z, slope = car.z, 2", "kernel/effects.py"),
    _text(
        "a gear left behind is marked as an object",
        "left_air = kind_at(w, car.x, car.y, car.z) == AIR",
        "left_air = kind_at(w, car.x, car.y, car.z) in (AIR, GEAR)",
        "kernel/effects.py",
    ),
    _text("a flap needs the cell beyond the foot", "if beyond not in ROOMY and not", "if False and not"),
    _text(
        "a flap meets a gear above the foot",
        "for z in range(car.z, car.z + 2):",
        "for z in range(car.z, car.z + 1):",
    ),
    _text("a load turns beside no car", " or car_in(w, me, x, y, car.z, False) >= 0", ""),
    _text(
        "a load leans on no other load",
        "if car_in(w, me, x, y, new.z, True) >= 0 or gear_across(w, me, x, y, new.z, downhill):",
        "if gear_across(w, me, x, y, new.z, downhill):",
    ),
    _text(
        "a gear keeps away from where a load leans",
        "if new.load == FSLOPE and leans_into",
        "if False and leans_into",
    ),
    _text(
        "a load turns above none that reaches up",
        "reaching = reaches_up(w, me, x, y, car.z, legs_mm) or leans_into",
        "reaching = leans_into",
    ),
    _text(
        "no load passes below one that leans over",
        "if below_leaning(w, me, old) or below_leaning(w, me, new):",
        "if False:",
    ),
    _text(
        "a load on a foot leans below no wall",
        "return kind_at(w, new.x + dir_x(downhill), new.y + dir_y(downhill), new.z + 1) != WALL",
        "return True",
    ),
    _text(
        "a flap passes above no load that reaches up",
        "if reaches_up(w, me, bx, by, car.z, LIP_MM):",
        "if False:",
    ),
    _text(
        "a gear comes down on no side of a foot",
        "crosses = kind_at(w, x, y, car.z) == FOOT",
        "crosses = False",
    ),
    _text(
        "a car goes on to its own ramp's body only",
        "if up and not (yaw_at(w, x, y, car.z) == (m + 2) & 3 and car_in(w, me, x, y, car.z + 1, False) < 0):",
        "if up and not car_in(w, me, x, y, car.z + 1, False) < 0:",
    ),
    _text(
        "a gear lasts as long as its slope", "kind, yaw = GEAR, d", "kind, yaw = AIR, 0", "kernel/effects.py"
    ),
    _text(
        "the helper tries to turn right before it tries to turn left",
        "    int(Action.ROTATE_RIGHT),\n    int(Action.ROTATE_LEFT),\n",
        "    int(Action.ROTATE_LEFT),\n    int(Action.ROTATE_RIGHT),\n",
        "kernel/search.py",
    ),
)


def tests_that_fail(mutant: Mutant | None) -> list[str]:
    """Return the names of the tests that fail with a mutant's change, or without any."""
    with tempfile.TemporaryDirectory() as place:
        copy = Path(place)
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / "craftsim", copy / "craftsim", ignore=ignored)
        shutil.copytree(ROOT / "tests" / "discrete", copy / "tests" / "discrete", ignore=ignored)
        (copy / "tests" / "data").mkdir()
        for name in ("reasons.jsonl", "corrections.jsonl"):
            shutil.copy(ROOT / "tests" / "data" / name, copy / "tests" / "data")
        (copy / "docs").mkdir()
        shutil.copy(ROOT / "docs" / "rules.md", copy / "docs")
        if mutant is not None:
            source = copy / "craftsim" / "discrete" / mutant.file
            source.write_text(mutant.change(source.read_text()))
        environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(copy)}
        command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "--tb=no", "-rf"]
        command += ["--import-mode=importlib", "--rootdir", place]
        command += [f"tests/discrete/{name}" for name in TESTS]
        run = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=False)
    if run.returncode not in (0, 1):
        raise RuntimeError(run.stdout + run.stderr)
    lines = [line.split(" - ")[0] for line in run.stdout.splitlines() if line.startswith("FAILED ")]
    return [line.removeprefix("FAILED tests/discrete/") for line in lines]


def main() -> int:
    """Print for each mutant a test that notices it; return 1 if one goes unnoticed, or if the rules alone fail."""
    if failures := tests_that_fail(None):
        print(f"the rules fail without any change: {failures}")
        return 1
    survivors = 0
    for mutant in MUTANTS:
        failures = tests_that_fail(mutant)
        survivors += not failures
        print(f"{mutant.rule} ({mutant.file}): {failures[0] if failures else 'UNNOTICED'}", flush=True)
    print(f"{len(MUTANTS)} mutants, {survivors} unnoticed")
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
