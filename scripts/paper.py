"""Train algorithms on tasks of CraftEnv's paper under its protocol, mostly shortened, and store the curves.

python scripts/paper.py --seeds 3                  # leaves out what is stored, goes on where it was interrupted
python scripts/paper.py block --algo vdn iql --seeds 5
python scripts/paper.py complex_two_story --algo ippo --max-steps 28    # episodes of 30 ticks, not 20
python scripts/paper.py strip --algo coma --first 11 --seeds 1    # seed 11 alone
python scripts/paper.py strip --seeds 1 --again    # has today's code the same curves? if not, its own are stored
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from measure_results import revision

from craftsim.learning.config import PAPER_LONG_STEPS, PAPER_STEPS
from craftsim.tasks.task import DEFAULT_MAX_STEPS

ROOT: Final = Path(__file__).parents[1]
OUT: Final = ROOT / "out" / "paper"
STORED: Final = ROOT / "docs" / "results" / "training" / "paper_runs.json"
TASKS: Final = ("strip", "block", "simple_two_story")
CODED: Final = "docs/results/coded_barrier.yaml"
HARDER: Final = ("complex_two_story", "breaking_barrier", "free_building", CODED)
"""Tasks that are trained on only where they are named, for as long as in the paper."""
STEPS: Final = {
    **dict.fromkeys(("vdn", "qmix", "iql", "qtran"), 150_000),
    **dict.fromkeys(("pqn", "ippo", "mappo"), 250_000),
    "coma": 600_000,
}
"""Length of a run by algorithm; the paper's are of 1,000,500 and 2,000,000 steps."""
LONG: Final = {
    **{("simple_two_story", algo): PAPER_LONG_STEPS for algo in ("pqn", "ippo", "mappo", "coma")},
    ("simple_two_story", "qtran"): 500_000,
    ("strip", "coma"): PAPER_STEPS,
}
"""Longer runs: those that succeed later than in :data:`STEPS`."""
KEY: Final = ("task", "algo", "seed", "steps", "max_steps")
"""What tells a run from the others."""


def main(argv: Sequence[str] | None = None) -> None:
    """Train what is missing, and store each run when it has ended."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument(
        "tasks", nargs="*", metavar="TASK", help=f"of {', '.join((*TASKS, *HARDER))}"
    )
    parser.add_argument("--algo", nargs="+", choices=STEPS, default=[*STEPS])
    parser.add_argument("--seeds", type=int, default=3, help="how many")
    parser.add_argument("--first", type=int, default=0, help="the first of them")
    parser.add_argument(
        "--max-steps", type=int, default=DEFAULT_MAX_STEPS, help="step limit of episodes"
    )
    parser.add_argument(
        "--again",
        action="store_true",
        help="train stored runs again; what has another curve is replaced",
    )
    asked = parser.parse_args(argv)
    if unknown := set(asked.tasks) - {*TASKS, *HARDER}:
        parser.error(
            f"no task {', '.join(sorted(unknown))}; there are {', '.join((*TASKS, *HARDER))}"
        )
    for seed in range(asked.first, asked.first + asked.seeds):
        for task in asked.tasks or TASKS:
            for algo in asked.algo:
                steps = PAPER_LONG_STEPS if task in HARDER else LONG.get((task, algo), STEPS[algo])
                key = task, algo, seed, steps, asked.max_steps
                known = {tuple(run[name] for name in KEY): run for run in stored()}
                if key not in known:
                    store(train(OUT, *key))
                elif asked.again:
                    run, new = known[key], train(OUT / "again", *key)
                    same = new["curve"] == run["curve"]
                    print(*key, "has the same curve" if same else "has another curve", flush=True)
                    store(run | {"same_at": new["revision"]} if same else new)


def stored() -> list[dict[str, Any]]:
    """Return the runs that are stored."""
    runs: list[dict[str, Any]] = json.loads(STORED.read_text(encoding="utf-8"))["runs"]
    return runs


def train(
    folder: Path, task: str, algo: str, seed: int, steps: int, max_steps: int
) -> dict[str, Any]:
    """Train, or go on with what was interrupted; a resumed run has no CPU time.

    Returns the curve and what it came to, with revision, versions and CPU time.
    """
    out, at = folder / f"{Path(task).stem}-{algo}-{seed}-{steps}-{max_steps}", revision()
    resumed, before = out.exists(), _cpu_s()
    words = f"train {task} --algo {algo} --preset paper --steps {steps} --seed {seed} --out {out}"
    words += f" --max-steps {max_steps}"
    subprocess.run([sys.executable, "-P", "-m", "craftsim", *words.split()], cwd=ROOT, check=True)
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    config, figures = report["config"], report["figures"]
    curve = [
        [point["steps"], point["successes"] / point["episodes"]]
        for point in figures["learning_curve"]
    ]
    return {name: config[name] for name in KEY} | {
        "revision": at,
        "versions": figures["training_versions"],
        "cpu_s": None if resumed else round(_cpu_s() - before),
        "last_fifth": figures["last_fifth"],
        "mean_return": figures["mean_return"],
        "curve": curve,
    }


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def store(run: dict[str, Any]) -> None:
    """Store a run beside the others."""
    others = [other for other in stored() if any(other[name] != run[name] for name in KEY)]
    runs = sorted([*others, run], key=lambda one: [one[name] for name in KEY])
    lines = ",\n".join(json.dumps(one) for one in runs)  # a line a run
    STORED.write_text(f'{{"runs": [\n{lines}\n]}}\n', encoding="utf-8")


if __name__ == "__main__":
    main()
