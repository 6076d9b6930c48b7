"""Train each algorithm on tasks of CraftEnv's paper under its protocol, mostly shortened, and store the curves.

python scripts/paper.py --seeds 3                  # goes on where it was interrupted: hours of CPU time
python scripts/paper.py block --seeds 5
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

from measure_results import revision

ROOT: Final = Path(__file__).parents[1]
OUT: Final = ROOT / "out" / "paper"
STORED: Final = ROOT / "docs" / "results" / "training" / "paper_runs.json"
TASKS: Final = ("strip", "block", "simple_two_story")
STEPS: Final = {
    **dict.fromkeys(("vdn", "qmix", "iql", "qtran"), 150_000),
    **dict.fromkeys(("pqn", "ippo", "mappo"), 250_000),
    "coma": 600_000,
}
"""Length of a run by algorithm; the paper's are of 1,000,500 and 2,000,000 steps."""
LONG: Final = {("simple_two_story", algo): 2_000_000 for algo in ("pqn", "ippo", "mappo", "coma")}
"""Runs as long as the paper's: those that succeed later than in :data:`STEPS`."""


def main() -> None:
    """Train what is missing, and store what there is."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("tasks", nargs="*", metavar="TASK", help=f"of {', '.join(TASKS)}")
    parser.add_argument("--seeds", type=int, default=3)
    asked = parser.parse_args()
    if unknown := set(asked.tasks) - set(TASKS):
        parser.error(f"no task {', '.join(sorted(unknown))}; there are {', '.join(TASKS)}")
    for seed in range(asked.seeds):
        for task in asked.tasks or TASKS:
            for algo, steps in STEPS.items():
                out = OUT / f"{task}-{algo}-{seed}"
                if not (out / "report.json").exists():
                    length = LONG.get((task, algo), steps)
                    words = f"train {task} --algo {algo} --preset paper --steps {length} --seed {seed} --out {out}"
                    subprocess.run(
                        [sys.executable, "-P", "-m", "craftsim", *words.split()], cwd=ROOT, check=False
                    )
    store(sorted(OUT.glob("*/report.json")))


def store(reports: list[Path]) -> None:
    """Store of each run its curve and what it came to."""
    runs, versions = [], {}
    for path in reports:
        report: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        config, figures = report["config"], report["figures"]
        versions = figures["training_versions"]
        curve = [
            [point["steps"], point["successes"] / point["episodes"]] for point in figures["learning_curve"]
        ]
        of_run = {name: config[name] for name in ("task", "algo", "seed", "steps")}
        runs.append(of_run | {"last_fifth": figures["last_fifth"], "curve": curve})
    stored = {"revision": revision(), "versions": versions, "runs": runs}
    STORED.write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
