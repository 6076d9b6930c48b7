"""Change one place of the judge, the statistics or the reports at a time, and see which tests notice.

    python tests/checking/mutants.py [--sample 10] [--seed 0] [FILE ...]

First come those of ``PLANTED``, then a sample of all places of each file: comparisons, connectives, signs, numbers and
texts. The package and its tests are copied, changed and run; seconds to a minute a mutant.
"""

from __future__ import annotations

import argparse
import ast
import copy
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]
TESTS: Final = {
    "checking/attempt.py": ("checking/test_attempt.py", "checking/test_measurements.py"),
    "checking/judge.py": ("checking/test_judge.py", "checking/test_plans.py"),
    "checking/measurements.py": ("checking/test_measurements.py",),
    "experiments/statistics.py": ("validation/test_statistics.py",),
    "reports/report.py": ("test_report.py", "validation/test_report_pages.py"),
    "tuning/goal.py": ("tuning/test_objectives.py",),
    "validation/report.py": ("validation/test_report_pages.py",),
}
"""Of each file the tests that ought to notice."""


@dataclass(frozen=True)
class Mutant:
    """A change of a file of the package: its name, and what it makes of the source."""

    name: str
    file: str
    change: Callable[[str], str]


def _planted(file: str, old: str, new: str) -> Mutant:
    return Mutant(f"{old} -> {new}", file, lambda source: re.sub(re.escape(old), new, source))


PLANTED: Final = (
    _planted("checking/judge.py", "watched.differences or (str(watched.outcome),)", "()"),
    _planted("reports/report.py", '"> 99.9"', '"100"'),
    _planted("reports/report.py", '"< 0.1"', '"0"'),
    _planted("tuning/goal.py", "LEAST_SHARE: Final = 0.05", "LEAST_SHARE: Final = 0.5"),
)
_OPPOSITES: Final[dict[type[ast.AST], type[ast.AST]]] = {
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.And: ast.Or,
    ast.Or: ast.And,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
}


def _mutate(node: ast.AST) -> bool:
    """Change a node in place; return whether it is of a kind that can be changed."""
    if isinstance(node, ast.Compare):
        node.ops[0] = _OPPOSITES[type(node.ops[0])]()
        return True
    if isinstance(node, ast.BoolOp) or (
        isinstance(node, ast.BinOp) and type(node.op) in _OPPOSITES
    ):
        node.op = _OPPOSITES[type(node.op)]()
        return True
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        node.op = ast.Not()
        node.operand = ast.UnaryOp(ast.Not(), node.operand)
        return True
    if isinstance(node, ast.Constant) and type(node.value) in (bool, int, float):
        node.value = not node.value if isinstance(node.value, bool) else 2 * node.value + 1
        return True
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        node.value = f"{node.value}X"
        return True
    return False


def _places(tree: ast.Module) -> list[int]:
    """Return the numbers, in the order of a walk, of the nodes that can be changed; docstrings are none."""
    docstrings = {
        node.value for node in ast.walk(tree) if isinstance(node, ast.Expr) and node.value
    }
    annotations: set[ast.AST] = set()
    for node in ast.walk(tree):
        for field in ("annotation", "returns"):
            if annotation := getattr(node, field, None):
                annotations.update(ast.walk(annotation))
    return [
        number
        for number, node in enumerate(ast.walk(tree))
        if node not in docstrings and node not in annotations and _mutate(copy.copy(node))
    ]


def sample(file: str, n: int, seed: int) -> list[Mutant]:
    """Return mutants at ``n`` places of a file, drawn with a seed."""
    source = (ROOT / "craftsim" / file).read_text(encoding="utf-8")
    places = _places(ast.parse(source))
    chosen = random.Random(seed).sample(places, min(n, len(places)))
    return [_at(file, place) for place in sorted(chosen)]


def _at(file: str, place: int) -> Mutant:
    def change(source: str) -> str:
        tree = ast.parse(source)
        _mutate(list(ast.walk(tree))[place])
        return ast.unparse(tree)

    source = (ROOT / "craftsim" / file).read_text(encoding="utf-8")
    node = list(ast.walk(ast.parse(source)))[place]
    before = ast.unparse(node)
    _mutate(node)
    return Mutant(f"line {node.lineno}: {before} -> {ast.unparse(node)}", file, change)


def test_that_fails(mutant: Mutant | None, file: str) -> str:
    """Return the name of a test that fails with a mutant's change, or without any; "" where none does."""
    with tempfile.TemporaryDirectory() as place:
        root = Path(place)
        ignored = shutil.ignore_patterns("__pycache__")
        for name in ("craftsim", "tests", "scripts", "docs"):
            shutil.copytree(ROOT / name, root / name, ignore=ignored)
        shutil.copy(ROOT / "pyproject.toml", root)
        if mutant is not None:
            source = root / "craftsim" / mutant.file
            source.write_text(mutant.change(source.read_text(encoding="utf-8")), encoding="utf-8")
        words = [sys.executable, "-m", "pytest", "-x", "--tb=no", "-rfE", "-p", "no:cacheprovider"]
        words += [f"tests/{name}" for name in TESTS[file]]
        run = subprocess.run(
            words,
            cwd=root,
            env=os.environ | {"PYTHONPATH": place},
            capture_output=True,
            text=True,
            check=False,
        )
    failed = re.findall(r"^(?:FAILED|ERROR) (\S+)", run.stdout, re.MULTILINE)
    if run.returncode not in (0, 1, 2) or (run.returncode and not failed):
        raise RuntimeError(run.stdout + run.stderr)
    return failed[0] if failed else ""


def main() -> int:
    """Print for each mutant a test that notices it; return 1 if a planted one goes unnoticed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="*", metavar="FILE", help=f"of {', '.join(TESTS)}")
    parser.add_argument("--sample", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    files = options.files or list(TESTS)
    planted = [mutant for mutant in PLANTED if mutant.file in files]
    drawn = [mutant for file in files for mutant in sample(file, options.sample, options.seed)]
    for file in files:
        if failed := test_that_fails(None, file):
            print(f"{failed} fails without any change")
            return 1
    unnoticed = []
    for mutant in (*planted, *drawn):
        failed = test_that_fails(mutant, mutant.file)
        print(f"{mutant.file}, {mutant.name}: {failed or 'UNNOTICED'}", flush=True)
        if not failed:
            unnoticed.append(mutant)
    print(f"{len(planted) + len(drawn)} mutants, {len(unnoticed)} unnoticed")
    return int(any(mutant in planted for mutant in unnoticed))


if __name__ == "__main__":
    sys.exit(main())
