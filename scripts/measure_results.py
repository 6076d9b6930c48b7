"""Run the commands whose results the documentation shows, and store of each report what a table says.

python scripts/measure_results.py             # what is older than the code: of all two hours
python scripts/measure_results.py demo large_tower_4_mild
python scripts/measure_results.py --data FOLDER reality    # recordings that are not part of the project
"""

from __future__ import annotations

import argparse
import ast
import json
import re
import resource
import shlex
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final

from network_causes import TASKS, TRAINED

ROOT: Final = Path(__file__).parents[1]
RUNS: Final = ROOT / "docs" / "results" / "runs"
STORED: Final = ":!craftsim/data/engines.json"
"""In the package, but a result itself."""
OUT: Final = ROOT / "out" / "results"

LATE, BIASED, LAGGING = (
    "docs/results/late.yaml",
    "docs/results/biased.yaml",
    "docs/results/lagging.yaml",
)
BUILT: Final = "--plan auto --attempts 8 --trials 5 --seed 1"
STRONG: Final = "--order concurrent --randomize strong --trials 4"
LAB: Final = "--randomize lab_floor --trials 4"
ANY: Final = "--randomize mild --trials 70 --seed 3232"
LEGAL: Final = "--rules physical --only legal --no-stop"
ROLLERS: Final = "--drive rollers --baseline out/results"
"""The same again on rollers, paired with what ran on tyres."""
PLAYED: Final = "--cars 12 --max-steps 200 --randomize none"
FIRST: Final = {
    "demo": "demo --randomize none --no-video",
    "heavier_car": "demo --randomize none --machines examples/heavier_car.yaml --no-video",
    "conformance": "conformance tests/data/traces.jsonl.gz",
    "late": f"validate --randomize none --noise {LATE} --trials 1",
    "biased": f"validate --randomize none --noise {BIASED} --trials 2",
    "lagging": f"validate --randomize none --noise {LAGGING} --trials 1",
    "strong": f"validate {STRONG}",
    "strong_rollers": f"validate {STRONG} {ROLLERS}/strong",
    "lab_floor": f"validate {LAB}",
    "lab_floor_rollers": f"validate {LAB} {ROLLERS}/lab_floor",
    "workshop_floor": "validate --randomize workshop_floor --trials 20 --seed 7",
    "random": f"validate random {ANY}",
    "random_rollers": f"validate random {ANY} {ROLLERS}/random",
    "play": f"validate random {PLAYED} --trials 12 --seed 8200 --timeout 3600",
    "large_tower_4_mild": f"validate large_tower_4 --randomize mild {BUILT}",
    "large_tower_8_mild": f"validate large_tower_8 --randomize mild {BUILT}",
    "audit_physical": "audit --quick --rules physical",
    "audit_published": "audit --quick",
    "audit_legal": f"audit {LEGAL}",
    "audit_legal_rollers": f"audit {LEGAL} {ROLLERS}/audit_legal",
    "margins": "audit margins --quick",
    "execution_plans": "scripts/plan_orders.py --designs 100",
    "builders": "scripts/builders.py",
}
"""The rows of the first table: each in less than four minutes of CPU time but for plans, rollers and the
audit of all that is legal."""
RANDOM: Final = (
    *(
        "random_block",
        "random_breaking_barrier",
        "random_complex_two_story",
        "random_free_building",
    ),
    *("random_simple_two_story", "random_strip"),
)
SHIPPED: Final = (*RANDOM, "designs")
"""Policies that come with craftsim, each by the name of its task, whose starts are random."""
LONG: Final = ("random_complex_two_story", "random_free_building", "designs")
"""Policies whose episodes take so long in physics that there are fewer."""
IN_PHYSICS: Final = {
    **{
        f"physics_{name}": f"validate {world} --policy {name} --randomize mild "
        f"--trials {50 if name in LONG else 200} --seed 5000 --video none"
        for name, world in (
            ("complex_two_story",) * 2,
            *((name, f"{name}@test") for name in SHIPPED),
        )
    },
    "floor_random_strip": "validate random_strip@test --policy random_strip --randomize workshop_floor "
    "--trials 50 --seed 5000 --video none",
}
ON_GRID: Final = {
    f"shipped_{name}": f"validate {name}@test --policy {name} --backend grid --trials {n}"
    for name, n in (*((name, 1000) for name in RANDOM), ("designs", 800))
}
ELSEWHERE: Final = {
    "designs_greedy": "validate designs@test --policy designs --backend grid --trials 800 --acting greedy",
    "designs_cars3": "validate designs@test --policy designs --backend grid --trials 1000 --cars 3",
    "designs_cars4": "validate designs@test --policy designs --backend grid --trials 1000 --cars 4",
    **{
        f"designs_{task}": f"validate {task}@test --policy designs --backend grid --trials 1000 --area 6 6 2"
        for task in (
            "random_strip",
            "random_block",
            "random_simple_two_story",
            "random_complex_two_story",
        )
    },
}
CERTIFIED: Final = {"certificates": "validate --certify 0.99 --randomize mild --video none"}
OF_DATA: Final = {
    "reality": "reality cube_tosses.npz mecanum1.npz mecanum2.npz mecanum3.npz",
}
"""What needs recordings, which docs/how-to/reality.md says how to get."""
NETWORK: Final = {
    "network_grid": "scripts/network_causes.py --episodes 25 --conditions grid",
    "network_causes": "scripts/network_causes.py --episodes 3 --conditions neither delay jitter loss network floor "
    "'floor and network'",
    "network_recovers": "scripts/network_causes.py --episodes 3 --conditions 'floor and network, waits' "
    "'floor and network, recovers'",
    "network_recovers_more": "scripts/network_causes.py --seed 3 --episodes 22 --conditions "
    "'floor and network, recovers'",
    "network_lab": "scripts/network_causes.py --episodes 7 --conditions 'lab floor and network, recovers'",
    "network_recovers_fresh": "scripts/network_causes.py random_breaking_barrier --seed 100 --episodes 22 "
    "--conditions 'floor and network, recovers'",
}
TRAINED_FURTHER: Final = [TRAINED.format(task) for task in TASKS]
"""Folders of policies that ``scripts/execution.py --seeds 1 --train asynchronous`` makes."""
OF_POLICIES: Final = {
    "network_trained": f"scripts/network_causes.py {' '.join(TRAINED_FURTHER)} --episodes 25 --conditions "
    "'floor and network, recovers'",
}
PLANS: Final = {"network_plans": "scripts/network_plans.py --episodes 12"}
SPEED: Final = {
    f"speed_{what}": f"benchmarks/reference.py {what}" for what in ("rules", "env", "physics")
}
"""To be measured on a machine that does nothing else."""
ANOTHER_SEED: Final = {
    "strong_again": f"validate {STRONG} --seed 6011",
    "workshop_floor_again": "validate --randomize workshop_floor --trials 20 --seed 6012",
    "physics_random_strip_again": "validate random_strip@test --policy random_strip --randomize mild --trials 200 "
    "--seed 6013 --video none",
    "network_recovers_again": "scripts/network_causes.py --seed 6014 --episodes 25 --conditions "
    "'floor and network, recovers'",
    "network_waits_again": "scripts/network_causes.py --seed 6014 --episodes 3 --conditions 'floor and network, waits'",
    "audit_published_again": "audit --quick --seed 6015",
    "audit_physical_again": "audit --quick --rules physical --seed 6015",
    "certificates_again": "validate --certify 0.99 --randomize mild --seed 6016 --video none",
}
"""The rows of README's table that are drawn, with seeds that no development has used."""
MEASURED: Final = {
    **FIRST,
    **CERTIFIED,
    **IN_PHYSICS,
    "training_in_physics": "scripts/training_in_physics.py",
    **NETWORK,
    **OF_POLICIES,
    **PLANS,
    **ON_GRID,
    **ELSEWHERE,
    **OF_DATA,
    **SPEED,
    **ANOTHER_SEED,
}
"""What is measured, by commands and scripts."""
KEPT: Final = {
    "docs/results/structures.json": "scripts/structures.py",
    "docs/results/campaign.json": "scripts/campaign.py",
    "docs/results/cheaper.json": "scripts/cheaper.py",
    "docs/results/joint_steps.json": "benchmarks/joint_steps.py",
    "docs/results/large.json": "benchmarks/bench_large.py",
    "docs/results/learned.json": "scripts/learned.py",
    "craftsim/data/engines.json": "scripts/engines.py",
    "docs/gallery/gallery.json": "scripts/gallery.py",
}
"""Other stored results, and what measures them."""
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
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(MEASURED)}")
    parser.add_argument("--data", type=Path, help=f"folder with the files of {', '.join(OF_DATA)}")
    arguments = parser.parse_args()
    names = arguments.names
    if unknown := set(names) - MEASURED.keys():
        parser.error(
            f"no measurement {', '.join(sorted(unknown))}; there are {', '.join(MEASURED)}"
        )
    for name in names or [name for name in MEASURED if is_older(name)]:
        if name in OF_DATA and arguments.data is None:
            print(f"{name} needs --data")
            continue
        if name in OF_POLICIES and not all((ROOT / one).is_dir() for one in TRAINED_FURTHER):
            print(
                f"{name} needs the policies of 'scripts/execution.py --seeds 1 --train asynchronous'"
            )
            continue
        measure(name, arguments.data)


def is_older(name: str) -> bool:
    """Return whether a result is missing, or package or script do something else than at its revision."""
    if name in KEPT:
        stored, script = (ROOT / name).read_text(encoding="utf-8"), KEPT[name]
        # pytest-benchmark has the whole commit.
        revisions = set(re.findall(r'"(?:revision|id)": "([0-9a-f]{8,40})"', stored)) or {"none"}
        return any(has_changed(one, script) for one in revisions)
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
        STORED,
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
                one
                for one in body
                if not (isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant))
            ]
    return ast.dump(tree)


def revision() -> str:
    """Return the revision of the checkout."""
    command = ["git", "rev-parse", "--short=8", "HEAD"]
    return subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()


def measure(name: str, data: Path | None = None) -> None:
    """Run a command, with recordings in a folder where it needs some, and store what its report says."""
    out = OUT / name
    words = [*shlex.split(MEASURED[name]), "--out", str(out)]
    if name in OF_DATA and data is not None:
        words = [str(data / word) if word.endswith(".npz") else word for word in words]
    print(*words, flush=True)
    python = [sys.executable]
    if not words[0].endswith(".py"):
        python += ["-P", "-m", "craftsim"]
    store(name, out, cpu_seconds_of([*python, *words], out))


def cpu_seconds_of(command: Sequence[str], out: Path) -> float:
    """Run a command that writes a report into a folder, and return its CPU time in seconds.

    Raises SystemExit where it writes none: the report of an earlier run says nothing of this revision.
    """
    report = out / "report.json"
    report.unlink(missing_ok=True)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    status = subprocess.run(command, cwd=ROOT, check=False).returncode
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    # Status 1 is a finding.
    if status not in (0, 1) or not report.is_file():
        raise SystemExit(f"no report of this run, nothing is stored: exit status {status}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


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
    if name in SPEED:
        kept["rates"] = report["wall"]["rates"]
    if found := report["figures"].get("validation", {}).get("policies"):
        by_policy = report["figures"]["validation"]["by_group"]
        kept["policies"] = [
            policy | {"actions": by_policy[policy["policy"]]["actions"]} for policy in found
        ]
    if name == "workshop_floor":
        kept["tasks"] = by_task(out / "trials.jsonl")
    RUNS.mkdir(parents=True, exist_ok=True)
    text = json.dumps(kept, indent=1, sort_keys=True).replace(f"{ROOT}/", "")
    (RUNS / f"{name}.json").write_text(f"{text}\n", encoding="utf-8")


def by_task(trials: Path) -> dict[str, dict[str, int]]:
    """Return of each task the actions and the runs of a validation, and how many were as predicted."""
    found: dict[str, dict[str, int]] = {}
    for trial in map(json.loads, trials.read_text(encoding="utf-8").splitlines()):
        counts = dict.fromkeys(("good", "actions", "good_runs", "runs"), 0)
        task, attempts = found.setdefault(trial["context"], counts), trial["attempts"] or ()
        task["good"] += sum(attempt["result"].startswith("as predicted") for attempt in attempts)
        task["actions"] += len(attempts)
        task["good_runs"] += bool(trial["agrees"])
        task["runs"] += 1
    return found


def _without_lists(value: Any) -> Any:
    """Leave out LISTS, and other long lists of records."""
    if isinstance(value, dict):
        return {key: _without_lists(one) for key, one in value.items() if key not in LISTS}
    return (
        [] if isinstance(value, list) and len(value) > 8 and isinstance(value[0], dict) else value
    )


if __name__ == "__main__":
    main()
