"""Change one rule at a time, and see which tests notice. Run by ``mutants.py``; takes a few seconds a mutant.

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
from pathlib import Path
from typing import Final, NamedTuple

from craftsim.discrete.kernel import codes
from craftsim.discrete.rules import REASONS

ROOT: Final = Path(__file__).parents[2]
TESTS: Final = ("test_reasons.py", "test_rules.py", "test_helper.py")


class Mutant(NamedTuple):
    """What of the source, a regular expression, is changed to break a rule."""

    rule: str
    old: str
    new: str
    file: str

    def change(self, source: str) -> str:
        """Return a file's text with the change."""
        return re.sub(self.old, self.new, source)


def _pattern(text: str) -> str:
    """Return the regular expression of a piece of code, however its lines are broken."""
    pattern = re.escape(text).replace(r"\ ", r"\s+")
    return pattern.replace(r"\(", r"\(\s*").replace(r"\)", r"\s*\)")


def never(code: str) -> Mutant:
    """Return the mutant that never gives a reason."""
    old = rf"code\.{code} \| \w+ << code\.DETAIL_BITS|code\.{code}\b"
    return Mutant(f"never {code}", old, "code.LEGAL", "kernel/rules.py")


_NAMES: Final = [*vars(codes)][[*vars(codes)].index("LEGAL") :]
_DETAILS: Final = {
    "kernel/rules.py": (
        ("if car.load == FSLOPE and kind_at(w, corner_x", "if kind_at(w, corner_x"),
        ("if car_in(w, me, gx, gy, car.z, True) >= 0 or carried_gear_in", "if carried_gear_in"),
        ("(over in (BLOCK, FLAG) and car.load == AIR)", "over in (BLOCK, FLAG)"),
        ("if kind_beyond not in ROOMY and not", "if False and not"),
        ("for z in range(car.z, car.z + 2):", "for z in range(car.z, car.z + 1):"),
        (" or car_in(w, me, x, y, car.z, False) >= 0", ""),
        ("if car_in(w, me, x, y, new.z, True) >= 0 or gear_across", "if gear_across"),
        ("if new.load == FSLOPE and leans_into", "if False and leans_into"),
        ("if over or reaches_up(w, me, x, y, car.z, legs_mm):", "if over:"),
        ("if below_leaning(w, me, old) or below_leaning(w, me, new):", "if False:"),
        (
            "return kind_at(w, new.x + dir_x(downhill), new.y + dir_y(downhill), new.z + 1) != WALL",
            "return True",
        ),
        ("if reaches_up(w, me, bx, by, car.z, LIP_MM):", "if False:"),
        ("crosses = kind_at(w, x, y, car.z) == FOOT", "crosses = False"),
        ("if up and not (yaw_at(w, x, y, car.z) == (m + 2) & 3 and ", "if up and not ("),
    ),
    "kernel/state.py": (
        ("z = car.z + 1", "z = car.z"),
        (
            "left_air = kind_at(w, car.x, car.y, car.z) == AIR",
            "left_air = kind_at(w, car.x, car.y, car.z) in ROOMY",
        ),
        ("kind = GEAR", "kind = AIR"),
    ),
    "kernel/search.py": (("ROTATE_RIGHT, ROTATE_LEFT)", "ROTATE_LEFT, ROTATE_RIGHT)"),),
}
"""Of each file what is changed into what."""
MUTANTS: Final = (
    *(never(_NAMES[code]) for code in REASONS),
    *(
        Mutant(old, _pattern(old), new, file)
        for file, changes in _DETAILS.items()
        for old, new in changes
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
        places = os.pathsep.join((str(copy), str(ROOT / "docs" / "_extensions")))
        environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": places}
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-x",
            "-p",
            "no:cacheprovider",
            "--tb=no",
            "-rf",
        ]
        command += ["--import-mode=importlib", "--rootdir", place]
        command += [f"tests/discrete/{name}" for name in TESTS]
        run = subprocess.run(
            command, cwd=copy, env=environment, capture_output=True, text=True, check=False
        )
    lines = [line.split(" - ")[0] for line in run.stdout.splitlines() if line.startswith("FAILED ")]
    if run.returncode != bool(lines):
        raise RuntimeError(run.stdout + run.stderr)
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
        print(
            f"{mutant.rule} ({mutant.file}): {failures[0] if failures else 'UNNOTICED'}", flush=True
        )
    print(f"{len(MUTANTS)} mutants, {survivors} unnoticed")
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
