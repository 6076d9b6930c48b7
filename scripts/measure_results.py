"""Run the commands whose results the documentation shows, and store of each report what a table says.

python scripts/measure_results.py             # what is older than the code: of all an hour
python scripts/measure_results.py demo large_tower_4_mild
"""

from __future__ import annotations

import argparse
import ast
import json
import resource
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).parents[1]
RUNS: Final = ROOT / "docs" / "results" / "runs"
STORED: Final = ":!craftsim/data/engines.json"
"""In the package, but a result itself."""
OUT: Final = ROOT / "out" / "results"

LATE, BIASED, LAGGING = "docs/results/late.yaml", "docs/results/biased.yaml", "docs/results/lagging.yaml"
BUILT: Final = "--plan auto --attempts 8 --drive reduced --trials 5 --seed 1"
PLAYED: Final = "--cars 12 --max-steps 200 --randomize none"
MEASURED: Final = {
    "demo": "demo --randomize none --no-video",
    "heavier_car": "demo --randomize none --machines examples/heavier_car.yaml --no-video",
    "conformance": "conformance tests/data/traces.jsonl.gz",
    "late": f"validate --randomize none --noise {LATE} --trials 2",
    "biased": f"validate --randomize none --noise {BIASED} --trials 2",
    "lagging": f"validate --randomize none --noise {LAGGING} --trials 2",
    "strong": "validate --order concurrent --randomize strong --trials 4",
    "lab_floor": "validate simple_two_story --randomize lab_floor --trials 8",
    "workshop_floor": "validate --randomize workshop_floor --trials 20 --seed 7",
    "random": "validate random --randomize none --trials 20 --seed 3232",
    "play_reduced": f"validate random {PLAYED} --drive reduced --trials 12 --seed 8200 --timeout 3600",
    "large_tower_4_mild": f"validate large_tower_4 --randomize mild {BUILT}",
    "large_tower_8_mild": f"validate large_tower_8 --randomize mild {BUILT}",
    "audit_physical": "audit --quick --rules physical --drive reduced",
    "audit_published": "audit --quick --drive reduced",
    "audit_legal": "audit --rules physical --only legal",
    "audit_legal_reduced": "audit --rules physical --only legal --drive reduced",
    "margins": "audit margins --quick",
    "execution_plans": "scripts/plan_orders.py --designs 100",
    "builders": "scripts/builders.py",
}
"""What is measured, by commands and scripts: each in less than four minutes of CPU time but for execution and, in
half an hour each, the workshop and the audit of all that is legal."""
LISTS: Final = (
    "by_group",
    "by_verb",
    "durations",
    "survival",
    "drift",
    "coverage",
    "rows",
    "suspects",
    "hypotheses",
    "at_once",
)
"""What reports list by row, group or action: no table has it."""


def main() -> None:
    """Measure what is named, or what is older than the code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(MEASURED)}")
    names = parser.parse_args().names
    if unknown := set(names) - MEASURED.keys():
        parser.error(f"no measurement {', '.join(sorted(unknown))}; there are {', '.join(MEASURED)}")
    for name in names or [name for name in MEASURED if is_older(name)]:
        measure(name)


def is_older(name: str) -> bool:
    """Return whether a result is missing, or package or script do something else than at its revision."""
    path, script = RUNS / f"{name}.json", MEASURED[name].split()[0]
    if not path.exists():
        return True
    measured = json.loads(path.read_text(encoding="utf-8")).get("revision", "none")
    return has_changed(measured, *([script] if script.endswith(".py") else []))


@cache
def has_changed(measured: str, *scripts: str) -> bool:
    """Return whether code is another than at a revision; comments, docstrings and stored results aside."""
    diff = [
        "git",
        "diff",
        "--name-only",
        "--no-renames",
        measured,
        "HEAD",
        "--",
        "craftsim",
        *scripts,
        ":!craftsim/data/engines.json",
    ]
    found = subprocess.run(diff, cwd=ROOT, check=False, capture_output=True, text=True)
    return found.returncode != 0 or any(
        not name.endswith(".py") or _code(measured, name) != _code("HEAD", name)
        for name in found.stdout.split()
    )


def _code(commit: str, name: str) -> str:
    """Return what a module does at a revision, as text; without docstrings, which are the same to all that runs."""
    show = ["git", "show", f"{commit}:{name}"]
    found = subprocess.run(show, cwd=ROOT, check=False, capture_output=True, text=True)
    tree = ast.parse(found.stdout)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [  # type: ignore[attr-defined]
                one for one in body if not (isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant))
            ]
    return ast.dump(tree)


def revision() -> str:
    """Return the revision of the checkout."""
    command = ["git", "rev-parse", "--short=8", "HEAD"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def measure(name: str) -> None:
    """Run a command, and store what its report says."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    out = OUT / name
    words = [*MEASURED[name].split(), "--out", str(out)]
    print(*words, flush=True)
    command = [sys.executable, *([] if words[0].endswith(".py") else ["-P", "-m", "craftsim"]), *words]
    subprocess.run(command, cwd=ROOT, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    store(name, out, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)


def store(name: str, out: Path, cpu_s: float | None) -> None:
    """Store of a report what a table says, with command and revision; a resumed run has no CPU time."""
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    kept = {
        "command": MEASURED[name],
        "revision": revision(),
        "cpu_s": None if cpu_s is None else round(cpu_s, 1),
        "versions": report["versions"],
        "figures": {key: _without_lists(value) for key, value in report["figures"].items()},
    }
    if name == "workshop_floor":
        kept["tasks"] = by_task(out / "trials.jsonl")
    RUNS.mkdir(parents=True, exist_ok=True)
    (RUNS / f"{name}.json").write_text(json.dumps(kept, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def by_task(trials: Path) -> dict[str, dict[str, int]]:
    """Return of each task the actions and the runs of a validation, and how many were as predicted."""
    found: dict[str, dict[str, int]] = {}
    for trial in map(json.loads, trials.read_text(encoding="utf-8").splitlines()):
        counts = dict.fromkeys(("good", "actions", "good_runs", "runs"), 0)
        task, attempts = found.setdefault(trial["context"], counts), trial["attempts"] or ()
        task["good"] += sum(attempt["result"] == "as predicted" for attempt in attempts)
        task["actions"] += len(attempts)
        task["good_runs"] += bool(trial["agrees"])
        task["runs"] += 1
    return found


def _without_lists(value: Any) -> Any:
    """Leave out LISTS, and other long lists of records."""
    if isinstance(value, dict):
        return {key: _without_lists(one) for key, one in value.items() if key not in LISTS}
    return [] if isinstance(value, list) and len(value) > 8 and isinstance(value[0], dict) else value


if __name__ == "__main__":
    main()
