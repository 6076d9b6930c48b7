"""Train policies in ticks, asynchronously, and in ticks from worlds that asynchronous physics reached; compare them.

python scripts/execution.py --seeds 5                     # goes on where it was interrupted: hours
python scripts/execution.py random_block --seeds 1
python scripts/execution.py --seeds 1 --train asynchronous    # the policies that network_causes.py plays

Each policy then plays the same starts in all modes of policy_modes.py. What that comes to is stored in
docs/results/runs, and the learning curves in docs/results/training.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

from measure_results import revision
from policy_modes import REACHED, episode, save_reached

ROOT: Final = Path(__file__).parents[1]
MODES: Final = ROOT / "scripts" / "policy_modes.py"
OUT: Final = ROOT / "out" / "execution"
RUNS: Final = ROOT / "docs" / "results" / "runs"
CURVES: Final = ROOT / "docs" / "results" / "training" / "execution_curves.json"
TASKS: Final = (
    "random_strip",
    "random_block",
    "random_simple_two_story",
    "random_breaking_barrier",
)
SETTINGS: Final = {"random_breaking_barrier": ("--critic", "0.005", "--acting", "sampled")}
"""Further settings of a task."""
WAYS: Final = ("synchronous", "asynchronous", "starts")
"""Of training: in ticks, asynchronously, in ticks with every second episode from a world of asynchronous physics."""
STEPS: Final = 1_000_000
EPISODES: Final = 40
"""Starts of the comparison: those of the seeds from 0."""
REACHED_FROM: Final = range(100_000, 100_100)
"""Seeds of the episodes of which each reaches a world to start from."""


def main() -> None:
    """Train and compare what is missing, and store what there is."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("tasks", nargs="*", metavar="TASK", help=f"of {', '.join(TASKS)}")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument(
        "--train", choices=WAYS, help="train in this way alone, and compare nothing"
    )
    asked = parser.parse_args()
    if unknown := set(asked.tasks) - set(TASKS):
        parser.error(f"no task {', '.join(sorted(unknown))}; there are {', '.join(TASKS)}")
    for seed in range(asked.seeds):
        for task in asked.tasks or TASKS:
            if asked.train is not None:
                train(task, asked.train, seed)
                continue
            policies = [train(task, way, seed) for way in WAYS]
            out = OUT / f"{task}-{seed}"
            if not (out / "report.json").exists():
                run(MODES, *policies, "--episodes", EPISODES, "--out", out)
    if asked.train is None:
        store(sorted(OUT.glob("*/report.json")))


def train(task: str, way: str, seed: int) -> Path:
    """Return the folder of a policy, trained unless it is there."""
    out = OUT / f"{task}-{way}-{seed}"
    if not (out / "report.json").exists():
        execution = "asynchronous" if way == "asynchronous" else "synchronous"
        options = ["--network", "relative", "--pretrained", task, "--execution", execution]
        options += SETTINGS.get(task, ())
        if way == "starts":
            options += ["--starts", str(reached(OUT / f"{task}-synchronous-{seed}"))]
        if out.exists():
            options.append("--resume")
        run(
            *(
                "-P",
                "-m",
                "craftsim",
                "train",
                task,
                "--seed",
                seed,
                "--steps",
                STEPS,
                "--until",
                1,
                "--episodes",
                200,
            ),
            *(*options, "--evaluation-episodes", 200, "--out", out),
        )
    return out


def reached(policy: Path) -> Path:
    """Return a file of worlds that a policy reaches in asynchronous physics, each at a time that is drawn."""
    path = policy / "reached.npz"
    if not path.exists():
        played = (episode((str(policy), REACHED, seed)) for seed in REACHED_FROM)
        save_reached(path, (one.extra["reached"] for one in played))
    return path


def run(*words: object) -> None:
    """Run a program in Python."""
    subprocess.run([sys.executable, *map(str, words)], cwd=ROOT, check=True)


def store(reports: list[Path]) -> None:
    """Store learning curves, and of each seed what comparisons came to."""
    curves, by_seed = [], dict[str, dict[str, Any]]()
    for path in reports:
        report: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        figures, (task, *way, seed) = report["figures"], path.parent.name.split("-")
        if way:
            curve = [
                [point["steps"], point["successes"] / point["episodes"]]
                for point in figures["learning_curve"]
            ]
            curves.append({"task": task, "trained": way[0], "seed": int(seed), "curve": curve})
            continue
        modes = by_seed.setdefault(seed, report | {"revision": revision()})["figures"]["modes"]
        for policy in figures["modes"].copy():
            modes[Path(policy).name] = figures["modes"].pop(policy)
        by_seed[seed]["config"]["policies"] = sorted(modes)
    CURVES.write_text(json.dumps(curves) + "\n", encoding="utf-8")
    for seed, found in by_seed.items():
        path = RUNS / f"execution_trained_{seed}.json"
        path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
