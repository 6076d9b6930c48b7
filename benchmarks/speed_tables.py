"""Write the tables of docs/speed/benchmarks.md from the report of benchmarks beside it, docs/speed/benchmarks.json."""

import json
from pathlib import Path

SPEED = Path(__file__).parents[1] / "docs/speed"


def tables(report: dict) -> str:
    """Return a table in Markdown for each benchmark function: a row a case, with the median and what else was noted."""
    functions: dict[str, list[dict]] = {}
    for one in report["benchmarks"]:
        functions.setdefault(one["fullname"].split("[")[0], []).append(one)
    parts = []
    for name, cases in functions.items():
        file, function = name.rsplit("/", 1)[-1].split("::")
        head = (*(cases[0]["params"] or {}), "median ms", "rounds", *cases[0]["extra_info"])
        rows = [
            (
                *(str(value) for value in (case["params"] or {}).values()),
                f"{1e3 * case['stats']['median']:.4g}",
                str(case["stats"]["rounds"]),
                *(f"{value:.4g}" for value in case["extra_info"].values()),
            )
            for case in cases
        ]
        lines = [head, ("---",) * len(head), *rows]
        title = f"`{file}`, {function.removeprefix('test_').replace('_', ' ')}:"
        parts.append("\n".join([title, "", *(f"| {' | '.join(line)} |" for line in lines)]))
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    report = json.loads((SPEED / "benchmarks.json").read_text(encoding="utf-8"))
    (SPEED / "benchmarks.md").write_text(tables(report), encoding="utf-8")
