"""Change one rule at a time, and see which tests notice. Run by ``make mutants``; takes a few seconds a mutant.

The rules are copied, changed in one place and tested uncompiled, which is slower to run but needs no compiling.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]
TESTS: Final = (
    "test_actions_in_place.py",
    "test_moves.py",
    "test_marks.py",
    "test_helper.py",
    "test_corrections.py",
)


@dataclass(frozen=True)
class Mutant:
    """A rule, and the text of the source that is changed to break it."""

    rule: str
    file: str
    old: str
    new: str


MUTANTS: Final = (
    Mutant(
        "LIFT needs nothing on top",
        "rules/legality.py",
        "    if own not in (BLOCK, FLAG, FSLOPE):\n        return False\n",
        "    if own not in (BLOCK, FLAG, FSLOPE):\n        return False\n    return True\n",
    ),
    Mutant(
        "a loaded car lifts nothing",
        "rules/legality.py",
        "    if car.load != AIR:\n        return False\n    own = ",
        "    own = ",
    ),
    Mutant(
        "UNFOLD needs a folded slope",
        "rules/legality.py",
        "if car.load != AIR or kind_at(w, car.x, car.y, car.z) != FSLOPE:",
        "if car.load != AIR:",
    ),
    Mutant(
        "a block turns past what stands at the corners",
        "rules/legality.py",
        "if carries_slope and not is_air_or_gear(",
        "if not is_air_or_gear(",
    ),
    Mutant(
        "a carried gear stops a turn beside it only",
        "rules/legality.py",
        "if beside and not points_at_me:",
        "if not points_at_me:",
    ),
    Mutant(
        "FOLD needs no car on the foot",
        "rules/legality.py",
        "if top_at(w, car.x + dir_x(slope_yaw), car.y + dir_y(slope_yaw), car.z - 1, me) >= 0:",
        "if False:",
    ),
    Mutant(
        "UNFOLD needs support below the foot",
        "rules/legality.py",
        " or not standable(kind_at(w, nx, ny, car.z - 1)):",
        ":",
    ),
    Mutant(
        "UNFOLD builds on no landing",
        "rules/legality.py",
        "if back_at(w, nx, ny, car.z - 1) or back_at(w, car.x, car.y, car.z - 1):",
        "if back_at(w, nx, ny, car.z - 1):",
    ),
    Mutant(
        "a gear beside a turning load must point at it",
        "rules/legality.py",
        "if yaw_at(w, nx, ny, car.z) != (d + 2) & 3:",
        "if yaw_at(w, nx, ny, car.z) == d:",
    ),
    Mutant(
        "a turning slope sweeps the corner on its own side",
        "rules/legality.py",
        "corner_x = car.x + dir_x(car.load_yaw) + dir_x(car.load_yaw + turn)",
        "corner_x = car.x + dir_x(car.load_yaw) + dir_x(car.load_yaw - turn)",
    ),
    Mutant(
        "a car leaves a block along its yaw",
        "rules/moves.py",
        "if own in (BLOCK, FLAG) and not (forward or backward):",
        "if own in (BLOCK, FLAG) and False:",
    ),
    Mutant(
        "a carried gear needs room beside it",
        "rules/moves.py",
        "return not car_in(w, me, sx, sy, car.z, True) and",
        "return",
    ),
    Mutant(
        "a descent needs its exit free",
        "rules/moves.py",
        "return standable(kind_at(w, x3, y3, car.z - 2)) and top_at(w, x3, y3, car.z - 2, me) == NOTHING",
        "return standable(kind_at(w, x3, y3, car.z - 2))",
    ),
    Mutant(
        "no loaded climb under a block",
        "rules/moves.py",
        "(over in (BLOCK, FLAG) and car.load == AIR)",
        "over in (BLOCK, FLAG)",
    ),
    Mutant("a climb goes up one level", "rules/moves.py", "z, slope = car.z + 1, 2", "z, slope = car.z, 2"),
    Mutant(
        "a gear left behind is marked as an object",
        "rules/effects.py",
        "left_air = kind_at(w, car.x, car.y, car.z) == AIR",
        "left_air = kind_at(w, car.x, car.y, car.z) in (AIR, GEAR)",
    ),
    Mutant(
        "a flap needs the cell beyond the foot",
        "rules/reach.py",
        "if beyond not in (AIR, GEAR) and not",
        "if False and not",
    ),
    Mutant(
        "a flap meets a gear above the foot",
        "rules/reach.py",
        "for z in (car.z, car.z + 1):\n        if gear_across(w, me, fx, fy, z, yaw):",
        "for z in (car.z,):\n        if gear_across(w, me, fx, fy, z, yaw):",
    ),
    Mutant(
        "a load turns beside no car",
        "rules/legality.py",
        "if next_to_me and (not bare or w.corrections & TURNING_LOAD):",
        "if next_to_me and not bare:",
    ),
    Mutant(
        "a load that leans straight towards a turning one has room",
        "rules/legality.py",
        "leans_into(w, me, nx, ny, car.z, (d + 2) & 3)",
        "leans_into(w, me, nx, ny, car.z, -1)",
    ),
    Mutant(
        "a load leans onto no load",
        "rules/reach.py",
        "car_in(w, me, x, y, new.z, True)\n        or",
        "False\n        or",
    ),
    Mutant(
        "a gear keeps away from where a load leans",
        "rules/reach.py",
        "if new.load == FSLOPE and leans_into",
        "if False and leans_into",
    ),
    Mutant(
        "a load turns above none that reaches up",
        "rules/levels.py",
        "if reaches_up(w, me, x, y, car.z, legs_mm) or",
        "if",
    ),
    Mutant(
        "no load passes below one that leans over",
        "rules/levels.py",
        "if below_leaning(w, me, old) or below_leaning(w, me, new):",
        "if False:",
    ),
    Mutant(
        "a load on a foot leans below no wall",
        "rules/levels.py",
        "return not wall_over(w, new.x + dir_x(downhill), new.y + dir_y(downhill), new.z)",
        "return True",
    ),
    Mutant(
        "a flap passes above no load that reaches up",
        "rules/levels.py",
        "return not reaches_up(w, me, fx + dir_x(yaw), fy + dir_y(yaw), car.z, LIP_MM)",
        "return True",
    ),
    Mutant(
        "a gear comes down on no side of a foot",
        "rules/reach.py",
        "return kind_at(w, x, y, car.z) != FOOT or (yaw_at(w, x, y, car.z) - yaw) & 1 == 0",
        "return True",
    ),
    Mutant(
        "a car goes on to its own ramp's body only",
        "rules/moves.py",
        "return yaw_at(w, nx, ny, car.z) == (m + 2) & 3 and not",
        "return not",
    ),
    Mutant(
        "a gear lasts as long as its slope",
        "rules/effects.py",
        "put(w, x, y, z, GEAR if gear >= 0 else AIR, max(gear, 0))",
        "put(w, x, y, z, AIR, 0)",
    ),
    Mutant(
        "the helper tries to turn right before it tries to turn left",
        "planning/search.py",
        "MOVE_LEFT, ROTATE_RIGHT, ROTATE_LEFT)",
        "MOVE_LEFT, ROTATE_LEFT, ROTATE_RIGHT)",
    ),
)


def tests_that_fail(mutant: Mutant) -> list[str]:
    """Return the names of the tests that fail with a mutant's change."""
    with tempfile.TemporaryDirectory() as place:
        copy = Path(place)
        shutil.copytree(ROOT / "craftsim" / "discrete", copy / "craftsim" / "discrete")
        for name in ("__init__.py", "__init__.pyi", "version.py"):
            shutil.copy(ROOT / "craftsim" / name, copy / "craftsim")
        (copy / "tests").mkdir()
        shutil.copytree(ROOT / "tests" / "discrete", copy / "tests" / "discrete")
        source = copy / "craftsim" / "discrete" / mutant.file
        source.write_text(source.read_text().replace(mutant.old, mutant.new, 1))
        environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(copy)}
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--tb=no", "-rf"]
        command += ["--import-mode=importlib", "--rootdir", place]
        command += [f"tests/discrete/{name}" for name in TESTS]
        run = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=False)
    if run.returncode not in (0, 1):
        raise RuntimeError(run.stdout + run.stderr)
    lines = [line.split(" - ")[0] for line in run.stdout.splitlines() if line.startswith("FAILED ")]
    return [line.removeprefix("FAILED tests/discrete/") for line in lines]


def main() -> int:
    """Print for each mutant which tests notice it; return 1 if one goes unnoticed, or if the rules alone fail."""
    if failures := tests_that_fail(Mutant("none", "rules/moves.py", "", "")):
        print(f"the rules fail without any change: {failures}")
        return 1
    survivors = 0
    for mutant in MUTANTS:
        failures = tests_that_fail(mutant)
        survivors += not failures
        first = f"{failures[0]} and {len(failures) - 1} more" if failures else "UNNOTICED"
        print(f"{mutant.rule} ({mutant.file}): {first}", flush=True)
    print(f"{len(MUTANTS)} mutants, {survivors} unnoticed")
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
