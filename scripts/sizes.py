"""Print how large the package is, by subpackage, so that the build log shows what a change adds or removes.

    python scripts/sizes.py

Lines are those of Python files, docstrings and blank ones included; imports are names of modules that a file imports
at its head; parameters are those of the longest signature.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from statistics import median

ROOT = Path(__file__).parents[1]
COLUMNS = ("files", "lines", "classes", "imports a file", "parameters")


def sizes(root: Path = ROOT / "craftsim") -> dict[str, tuple[float, ...]]:
    """Return the row of each subpackage, of the files beside them, and of all together."""
    rows = {}
    folders = sorted(path for path in root.iterdir() if (path / "__init__.py").exists())
    for folder in folders:
        rows[folder.name] = _row(sorted(folder.rglob("*.py")))
    rows["(beside)"] = _row(sorted(root.glob("*.py")))
    rows["together"] = _row(sorted(root.rglob("*.py")))
    return rows


def _row(files: list[Path]) -> tuple[float, ...]:
    trees = [ast.parse(path.read_bytes()) for path in files]
    lines = sum(path.read_bytes().count(b"\n") for path in files)
    classes = sum(isinstance(node, ast.ClassDef) for tree in trees for node in ast.walk(tree))
    longest = max(
        (len(_parameters(node)) for tree in trees for node in ast.walk(tree) if _is_function(node)), default=0
    )
    return len(files), lines, classes, median(len(set(_imported(tree))) for tree in trees), longest


def _is_function(node: ast.AST) -> bool:
    return isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)


def _parameters(node: ast.AST) -> list[ast.arg]:
    assert isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    return [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]


def _imported(tree: ast.Module) -> Iterator[str]:
    for node in tree.body:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""


def words(root: Path = ROOT) -> int:
    """Return the words of README, changelog and documentation."""
    pages = [root / "README.md", root / "CHANGELOG.md", *(root / "docs").rglob("*.md")]
    return sum(len(page.read_text(encoding="utf-8").split()) for page in pages)


def table() -> str:
    """Return the table as text."""
    rows = [("package", *COLUMNS), *((name, *(f"{one:g}" for one in row)) for name, row in sizes().items())]
    widths = [max(len(str(row[k])) for row in rows) for k in range(len(rows[0]))]
    text = [
        "  ".join(f"{one!s:<{widths[0]}}" if k == 0 else f"{one!s:>{widths[k]}}" for k, one in enumerate(row))
        for row in rows
    ]
    return "\n".join([*text, f"documentation: {words():,} words"])


if __name__ == "__main__":
    print(table())
