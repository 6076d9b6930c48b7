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
    files = {path: _of_file(path) for path in sorted(root.rglob("*.py"))}
    rows = {
        folder.name: _row([one for path, one in files.items() if folder in path.parents])
        for folder in sorted(path for path in root.iterdir() if (path / "__init__.py").exists())
    }
    rows["(beside)"] = _row([one for path, one in files.items() if path.parent == root])
    rows["together"] = _row(list(files.values()))
    return rows


def _of_file(path: Path) -> tuple[int, int, int, int]:
    """Return lines, classes, imports and the parameters of the longest signature."""
    data = path.read_bytes()
    tree = ast.parse(data)
    classes, longest = 0, 0
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            classes += 1
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            longest = max(
                longest,
                sum(map(len, (node.args.posonlyargs, node.args.args, node.args.kwonlyargs))),
            )
    return data.count(b"\n"), classes, len(set(_imported(tree))), longest


def _row(files: list[tuple[int, int, int, int]]) -> tuple[float, ...]:
    lines, classes, imports, longest = zip(*files, strict=True)
    return len(files), sum(lines), sum(classes), median(imports), max(longest)


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
    rows = [
        ("package", *COLUMNS),
        *((name, *(f"{one:g}" for one in row)) for name, row in sizes().items()),
    ]
    widths = [max(len(str(row[k])) for row in rows) for k in range(len(rows[0]))]
    text = [
        "  ".join(
            f"{one!s:<{widths[0]}}" if k == 0 else f"{one!s:>{widths[k]}}"
            for k, one in enumerate(row)
        )
        for row in rows
    ]
    return "\n".join([*text, f"documentation: {words():,} words"])


if __name__ == "__main__":
    print(table())
