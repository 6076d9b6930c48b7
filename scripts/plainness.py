"""Count how plain the package's code is, and fail where a figure is worse than the stored one.

    python scripts/plainness.py [--store]

Figures are of statements that hold several thoughts, of names that say nothing, of public names with several meanings,
and of circles of imports. Rates are per 10,000 tokens; imports, docstrings and comments do not count.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import sys
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

ROOT: Final = Path(__file__).parents[1]
STORED: Final = Path(__file__).with_suffix(".json")
_COMPREHENSIONS: Final = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
_COUNTED_TOKENS: Final = ("NAME", "OP", "NUMBER", "STRING", "FSTRING_START")
_VAGUE: Final = """
    again ahead all_of alone any_one asked begun behind beside besides beyond both came comes did does drawn each
    every far few follows found given goes gone got held here how it its kept known least left less made many
    meant more most much near needed none_of now one ones other others own part put rest right_one said seen shown
    so some such taken that them then there these they thing things this those told wanted way ways what when
    where who whoever whole whose why within
"""
"""Names that do not say what they hold."""
_VAGUE_NAMES: Final = frozenset(_VAGUE.split())


def figures(package: Path) -> dict[str, float]:
    """Return the figures of a package's folder, by name; the smaller, the plainer."""
    trees = {}
    counts: Counter[str] = Counter()
    for path in sorted(package.rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        trees[path] = ast.parse(source)
        for node in ast.walk(trees[path]):
            counts.update(_kinds(node))
        lines = _token_lines(source, trees[path])
        counts["tokens"] += len(lines)
        counts["code lines"] += len(set(lines))
    rates = (
        "star-tuple arguments",
        "a, b = x, y",
        "conditional expressions",
        "walrus",
        "comprehensions",
    )
    result = {"tokens a code line": round(counts["tokens"] / max(1, counts["code lines"]), 2)}
    for kind in (*rates, "nested comprehensions"):
        result[kind] = round(1e4 * counts[kind] / max(1, counts["tokens"]), 1)
    result["vague names, %"] = round(100 * counts["vague names"] / max(1, counts["names"]), 1)
    result["public names defined twice"] = _defined_twice(trees)
    result["circles of imports"] = _circles(package, trees)
    return result


def _kinds(node: ast.AST) -> Iterator[str]:
    """Yield what a node counts as."""
    match node:
        case ast.Call(args=arguments):
            packed = [a for a in arguments if isinstance(a, ast.Starred)]
            if any(isinstance(argument.value, ast.Tuple | ast.List) for argument in packed):
                yield "star-tuple arguments"
        case ast.Assign(targets=[ast.Tuple(), *_], value=ast.Tuple()):
            yield "a, b = x, y"
        case ast.IfExp():
            yield "conditional expressions"
        case ast.NamedExpr():
            yield "walrus"
        case ast.Name(id=name, ctx=ast.Store()) | ast.arg(arg=name):
            yield "names"
            if name.strip("_") in _VAGUE_NAMES:
                yield "vague names"
    if isinstance(node, _COMPREHENSIONS):
        yield "comprehensions"
        if len(node.generators) > 1:
            yield "nested comprehensions"


def _token_lines(source: str, tree: ast.Module) -> list[int]:
    """Return the line of each token that counts."""
    left_out = set[int]()
    for node in ast.walk(tree):
        match node:
            case ast.Import() | ast.ImportFrom() | ast.Expr(value=ast.Constant(value=str())):
                left_out.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    lines = []
    depth = 0
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        name = tokenize.tok_name[token.type]
        # Since Python 3.12 an f-string is several tokens; it counts as one.
        if depth == 0 and name in _COUNTED_TOKENS and token.start[0] not in left_out:
            lines.append(token.start[0])
        depth += name.endswith("STRING_START") - name.endswith("STRING_END")
    return lines


def _defined_twice(trees: dict[Path, ast.Module]) -> int:
    """Return the number of public names that several modules define."""
    places: dict[str, set[Path]] = defaultdict(set)
    for path, tree in trees.items():
        for node in tree.body:
            for name in _defined(node):
                places[name].add(path)
    return sum(len(paths) > 1 and not name.startswith("_") for name, paths in places.items())


def _defined(node: ast.stmt) -> list[str]:
    match node:
        case (
            ast.ClassDef(name=name)
            | ast.FunctionDef(name=name)
            | ast.AnnAssign(target=ast.Name(id=name))
        ):
            return [name]
        case ast.Assign(targets=targets):
            return [target.id for target in targets if isinstance(target, ast.Name)]
    return []


def _circles(package: Path, trees: dict[Path, ast.Module]) -> int:
    """Return the number of circles of modules that import each other, wherever they do; packages do not count."""
    numbers = {}
    for number, path in enumerate(trees):
        numbers[".".join(path.relative_to(package.parent).with_suffix("").parts)] = number
    imports = csr_array((len(trees), len(trees)), dtype=int).tolil()
    for module, number in numbers.items():
        for node in ast.walk(list(trees.values())[number]):
            if isinstance(node, ast.ImportFrom):
                for name in _imported(module, node):
                    imports[number, numbers.get(name, number)] = 1
    _, labels = connected_components(imports.tocsr(), connection="strong")
    return sum(size > 1 for size in Counter(labels.tolist()).values())


def _imported(module: str, node: ast.ImportFrom) -> Iterator[str]:
    """Yield the full names that may be modules."""
    base = node.module or ""
    if node.level:
        base = ".".join([*module.split(".")[: -node.level], *filter(None, [base])])
    yield base
    for alias in node.names:
        yield f"{base}.{alias.name}"


def main(
    arguments: list[str] | None = None, package: Path = ROOT / "craftsim", stored: Path = STORED
) -> int:
    """Print the figures beside the stored ones; return 1 if one is worse, else 0."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--store", action="store_true", help="store better figures; worse ones are refused"
    )
    store = parser.parse_args(arguments).store
    now = figures(package)
    before = json.loads(stored.read_text(encoding="utf-8"))
    worse = [name for name, figure in now.items() if figure > before[name]]
    for name, figure in now.items():
        print(f"{name:27} {figure:6g}  stored: {before[name]:6g}{'  worse' * (name in worse)}")
    if worse:
        print(
            f"Worse than {stored.name} has it: {', '.join(worse)}. Write what was added more plainly; figures may "
            "only get better, and 'python scripts/plainness.py --store' stores better ones."
        )
        return 1
    if store:
        stored.write_text(json.dumps(now, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
