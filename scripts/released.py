"""Which settings of CraftEnv's released learner decide free building: each changed alone, from the preset fork.

The preset is also held beside an implementation that was written apart, on free building and the strip.

nice python scripts/released.py train      # goes on after any interruption
python scripts/released.py status          # how far each run is
python scripts/released.py collect         # store what is finished; then scripts/results.py writes the page
python scripts/released.py independent --folder FOLDER   # store curves of the other implementation, a JSON file a run

All runs are 200,000 steps long first, seed by seed, then 400,000.
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from measure_results import revision

from craftsim.experiments.anytime import bounds
from craftsim.learning.curve import CURVE_FILE, last_fifth, last_point
from craftsim.storage.writing import write_whole

ROOT: Final = Path(__file__).parents[1]
OUT: Final = ROOT / "out" / "released"
STORED: Final = ROOT / "docs" / "results" / "training" / "released_runs.json"
INDEPENDENT: Final = ROOT / "docs" / "results" / "training" / "released_independent.json"
LENGTHS: Final = (200_000, 400_000)
SEEDS: Final = 3
CHANGES: Final[Mapping[str, str]] = {
    "none": "",
    "no memory": "--no-recurrent",
    "tick and busy helpers, no memory": "--no-recurrent --shows-hidden",
    "returns of lambda 0.6": "--td-lambda 0.6",
    "replay of 5,000 ticks": "--buffer 5000",
    "targets that follow each step": "--target-rate 0.01 --target-ticks 0",
    "time limit valued": "--limit-ends 0",
    "success ends an episode": "--ends-on-success",
    "no last action": "--no-last-action",
    "rate decays to 0": "--decay-ticks 400000",
    "network of cells": "--network map",
    "Adam": "--rmsprop 0",
}
"""Options of what is changed, besides ``--preset fork``."""
ROWS: Final = (*(("free_building", change) for change in CHANGES), ("strip", "none"))
"""Task and change of each row."""
MOST: Final = 10.0
"""Return of a finished platform, by the released reward."""
PARTS: Final = 4
"""Of a curve that is held beside another one."""


def command_of(task: str, change: str, seed: int, steps: int, out: Path) -> list[str]:
    """Return the command that trains, or goes on training."""
    words = f"train {task} --algo qmix --preset fork {CHANGES[change]} --seed {seed} --steps {steps} --episodes 20"
    return [
        sys.executable,
        "-P",
        "-m",
        "craftsim",
        *words.split(),
        "--resume",
        "--out",
        str(out),
    ]


def folder_of(out: Path, task: str, change: str, seed: int) -> Path:
    """Return the folder of a run."""
    return out / f"{task}-{change.replace(' ', '-')}-{seed}"


def read_record(folder: Path) -> dict[str, Any] | None:
    """Return what is stored of a run that has ended at some length; None if it has not."""
    path = folder / "record.json"
    if not path.exists():
        return None
    record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return record


def train(out: Path, seeds: int, longest: int) -> int:
    """Do all runs that have not ended; return the exit status: 1 if one has failed."""
    status = 0
    stored = {run_of(record): record["steps"] for record in read_runs()}
    for steps in LENGTHS:
        if steps > longest:
            continue
        for seed in range(seeds):
            for task, change in ROWS:
                folder = folder_of(out, task, change, seed)
                record = read_record(folder)
                if record is not None and record["steps"] >= steps:
                    continue
                if stored.get((task, change, seed), 0) >= steps:
                    continue
                print(f"{folder.name}: to {steps:,} steps", flush=True)
                if _train(folder, task, change, seed, steps, record):
                    print(f"{folder.name}: failed, see {folder.name}.log", flush=True)
                    status = 1
    return status


def _train(
    folder: Path,
    task: str,
    change: str,
    seed: int,
    steps: int,
    before: dict[str, Any] | None,
) -> int:
    """Train to a length and store the record of it; return the exit status."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with (folder.parent / f"{folder.name}.log").open("a", encoding="utf-8") as log:
        process = subprocess.Popen(
            command_of(task, change, seed, steps, folder),
            cwd=ROOT,
            stdout=log,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
        )
        try:
            status = process.wait()
        except KeyboardInterrupt:
            process.terminate()  # it saves what it has
            process.wait()
            raise
    if status:
        return status
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    figures = report["figures"]
    curve = []
    for point in figures["learning_curve"]:
        success = point["successes"] / point["episodes"]
        curve.append([point["steps"], success, round(point["mean_return"], 3)])
    revisions = [revision()]
    if before is not None and before["revision"] != revisions[0]:
        revisions.insert(0, before["revision"])
    record = {
        "task": task,
        "change": change,
        "seed": seed,
        "steps": steps,
        "revision": ", ".join(revisions),
        "versions": figures["training_versions"],
        "cpu_s": round(report["wall"]["training_cpu_s"]),
        "curve": curve,
    }
    write_whole(folder / "record.json", json.dumps(record))
    return 0


def status(out: Path, seeds: int) -> int:
    """Say of each run how far it is."""
    for seed in range(seeds):
        for task, change in ROWS:
            folder = folder_of(out, task, change, seed)
            words = "not begun"
            if (folder / CURVE_FILE).exists():
                point = last_point(folder / CURVE_FILE)
                if point is not None:
                    words = f"{point.steps:,} steps, return {point.mean_return:.1f}, success {point.success:.2f}"
            print(f"{folder.name:40} {words}")
    return 0


def collect(out: Path) -> int:
    """Store what has ended, of any seed, in place of what is stored of shorter runs."""
    longest = {run_of(record): record for record in read_runs()}
    for path in sorted(out.glob("*/record.json")):
        record = json.loads(path.read_text(encoding="utf-8"))
        before = longest.get(run_of(record))
        if before is None or record["steps"] >= before["steps"]:
            longest[run_of(record)] = record
    records = []
    for task, change in ROWS:
        of_row = [record for run, record in longest.items() if run[:2] == (task, change)]
        records += sorted(of_row, key=run_of)
    lines = ",\n".join(json.dumps(record) for record in records)
    write_whole(STORED, f'{{"runs": [\n{lines}\n]}}\n')
    print(f"{len(records)} runs")
    return 0


def collect_independent(folder: Path) -> int:
    """Store the curves of the other implementation.

    A file has ``args`` with ``task`` and ``seed``, and ``curve`` with the steps ``t``, the share of episodes ``won``
    and the mean return ``test_return`` of each evaluation.
    """
    runs = []
    for path in sorted(folder.glob("*.json")):
        run = json.loads(path.read_text(encoding="utf-8"))
        curve = []
        for point in run["curve"]:
            curve.append([point["t"], point["won"], round(point["test_return"], 3)])
        runs.append({"task": run["args"]["task"], "seed": run["args"]["seed"], "curve": curve})
    lines = ",\n".join(json.dumps(run) for run in runs)
    write_whole(INDEPENDENT, f'{{"runs": [\n{lines}\n]}}\n')
    print(f"{len(runs)} runs")
    return 0


def run_of(record: Mapping[str, Any]) -> tuple[str, str, int]:
    """Return task, change and seed of a record."""
    return record["task"], record["change"], record["seed"]


def read_runs() -> list[dict[str, Any]]:
    """Return the runs that are stored."""
    runs: list[dict[str, Any]] = json.loads(STORED.read_text(encoding="utf-8"))["runs"]
    return runs


def read_independent() -> list[dict[str, Any]]:
    """Return the stored runs of the implementation that was written apart."""
    runs: list[dict[str, Any]] = json.loads(INDEPENDENT.read_text(encoding="utf-8"))["runs"]
    return runs


def table_rows(records: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return the rows of the table of changes, from what is stored."""
    rows: list[tuple[str, ...]] = [
        (
            "changed",
            "steps, k",
            "return of 10 (95 %)",
            "of each seed",
            "success",
            "first success at, k",
        )
    ]
    for change, options in CHANGES.items():
        name = change
        if options:
            name = f"`{options}`"
        for steps in LENGTHS:
            runs = []
            for run in records:
                row = run["task"], run["change"]
                if row == ("free_building", change) and run["steps"] >= steps:
                    runs.append(run)
            if runs:
                rows.append((name, *_cells(runs, steps)))
    return rows


def beside_rows(
    records: Sequence[Mapping[str, Any]], independent: Sequence[Mapping[str, Any]]
) -> list[tuple[str, ...]]:
    """Return the rows of a table of both implementations: returns in each part of the shorter runs."""
    width = LENGTHS[0] // PARTS
    heads = [f"to {(part + 1) * width / 1000:.0f}k" for part in range(PARTS)]
    rows: list[tuple[str, ...]] = [("task", "learner", *heads)]
    for task in ("free_building", "strip"):
        ours = [run for run in records if (run["task"], run["change"]) == (task, "none")]
        theirs = [run for run in independent if run["task"] == task]
        for learner, runs in (("preset fork", ours), ("written apart", theirs)):
            cells = []
            for part in range(PARTS):
                cells.append(_means(runs, part * width, (part + 1) * width))
            if runs:
                rows.append((f"`{task}`", learner, *cells))
    return rows


def _means(runs: Sequence[Mapping[str, Any]], begin: int, end: int) -> str:
    """Return the mean return of each run between two steps."""
    means = []
    for run in runs:
        returns = [point[2] for point in run["curve"] if begin < point[0] <= end]
        if returns:
            means.append(f"{sum(returns) / len(returns):.1f}")
    return ", ".join(means)


def _cells(runs: Sequence[Mapping[str, Any]], steps: int) -> tuple[str, ...]:
    """Return the cells of a row: of some runs, as they were after so many steps."""
    returns = []
    successes = []
    firsts = []
    for run in runs:
        curve = [point for point in run["curve"] if point[0] <= steps]
        returns.append(last_fifth([point[2] for point in curve]))
        successes.append(last_fifth([point[1] for point in curve]))
        reached = [point[0] for point in curve if point[1] > 0]
        firsts.append(f"{reached[0] / 1000:.0f}" if reached else "-")
    mean = sum(returns) / len(returns)
    total: Any = sum(returns) / MOST  # a mean of shares is bounded as a rate is
    low, high = bounds(total, len(returns))
    return (
        f"{steps / 1000:.0f}",
        f"{mean:.1f} ({MOST * low:.1f}-{MOST * high:.1f})",
        ", ".join(f"{value:.1f}" for value in returns),
        f"{sum(successes) / len(successes):.2f}",
        ", ".join(firsts),
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Do what is asked; return the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("command", choices=("train", "status", "collect", "independent"))
    parser.add_argument("--folder", type=Path, default=OUT, help="of the runs")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="of train and status")
    parser.add_argument("--longest", type=int, default=LENGTHS[-1], help="steps to train to")
    arguments = parser.parse_args(argv)
    folder = arguments.folder.resolve()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        if arguments.command == "train":
            return train(folder, arguments.seeds, arguments.longest)
        if arguments.command == "status":
            return status(folder, arguments.seeds)
        if arguments.command == "independent":
            return collect_independent(folder)
        return collect(folder)
    except KeyboardInterrupt:
        print("Interrupted; the same command goes on.")
        return 130


if __name__ == "__main__":
    sys.exit(main())
