"""Write the tables of the documentation that follow from types and limits, between their marks in docs/*.md."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import re
from collections.abc import Callable, Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from craftsim.cli.commands import ALONE, BELOW, COMMANDS, MODULES
from craftsim.options import option_ranges
from craftsim.storage.limits import ALL, ranges_of, size_text
from craftsim.training.settings import KINDS, Settings

DOCS: Final = Path(__file__).parents[1] / "docs"
MARKED: Final = re.compile(r"(<!-- table: (\w+) -->\n)\n.*?\n(<!-- end of table -->)", re.DOTALL)


def main() -> None:
    """Write all tables anew."""
    for page in DOCS.glob("*.md"):
        text = page.read_text(encoding="utf-8")
        if (now := renewed(text)) != text:
            page.write_text(now, encoding="utf-8")


def renewed(text: str) -> str:
    """Return a page with its tables as they should be."""
    return MARKED.sub(lambda found: f"{found[1]}\n{TABLES[found[2]]()}\n{found[3]}", text)


def _table(*rows: Iterable[object]) -> str:
    head, *body = ([str(cell) for cell in row] for row in rows)
    lines = [head, ["---"] * len(head), *body]
    return (
        "\n".join(f"| {' | '.join(line)} |".replace("|  |", "| |").replace("|  |", "| |") for line in lines)
        + "\n"
    )


def _files() -> str:
    rows = []
    for file in ALL:
        unpacked = size_text(file.content_bytes) if file.content_bytes != file.file_bytes else ""
        line = size_text(file.line_bytes) if file.line_bytes else ""
        rows.append((file.what, size_text(file.file_bytes), unpacked, line))
    return _table(("file", "on disk", "unpacked", "a line"), *rows)


def _options() -> str:
    commands: dict[tuple[str, str], list[str]] = {}
    every = [name for name in COMMANDS if name not in ALONE]
    every += [f"{name} {one}" for name, others in BELOW.items() for one in others]
    for name in every:
        words = name.split()
        module = importlib.import_module(f"craftsim.cli.{MODULES.get(words[-1], words[-1])}")
        for option, allowed in option_ranges(getattr(module, words[-1])):
            commands.setdefault((f"`--{option}`", str(allowed)), []).append(f"`{name}`")
    rows = (
        (option, allowed, ", ".join(dict.fromkeys(names)))
        for (option, allowed), names in sorted(commands.items())
    )
    return _table(("option", "allowed", "commands"), *rows)


def _settings() -> str:
    algorithms: dict[type[Settings], list[str]] = {}
    for algorithm, kind in KINDS.items():
        algorithms.setdefault(kind, []).append(f"`{algorithm}`")
    rows = [
        (", ".join(names), f"`{of.name}`", of.default, ranges_of(kind)[of.name], _docstrings(kind)[of.name])
        for kind, names in algorithms.items()
        for of in dataclasses.fields(kind)
    ]
    return _table(("algorithms", "setting", "default", "allowed", "what it is"), *rows)


def _docstrings(kind: type) -> dict[str, str]:
    """Return what stands below each field of a class, as a cell of a table says it."""
    found: dict[str, str] = {}
    for one in reversed(kind.__mro__[:-1]):
        (tree,) = ast.parse(inspect.getsource(one)).body
        lines: Any = tree.body  # type: ignore[attr-defined]
        for field, below in pairwise(lines):
            if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr):
                text = " ".join(str(below.value.value).split()).removesuffix(".")  # type: ignore[attr-defined]
                found[field.target.id] = text[0].lower() + text[1:]  # type: ignore[union-attr]
    return found


TABLES: Final[dict[str, Callable[[], str]]] = {"files": _files, "options": _options, "settings": _settings}

if __name__ == "__main__":
    main()
