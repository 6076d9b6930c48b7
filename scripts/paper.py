"""Fill the table of CraftEnv's paper: its six algorithms on its six tasks, three seeds each.

nice python scripts/paper.py train            # goes on after any interruption; run it twice, and both share the work
python scripts/paper.py train free_building/qmix strip/coma --seeds 5
python scripts/paper.py status                # what is finished, under way and not run
python scripts/paper.py collect               # store what is finished; then scripts/results.py writes the page
python scripts/paper.py held-out              # four cells with other seeds: do they differ from what the page says?

Cells that decide come first, each with its first seed, then with the next one: QMIX, VDN and IQL on free building, the
barrier and complex two-story; then these with longer episodes, where no seed had any success; then all others.
"""

from __future__ import annotations

import argparse
import fcntl
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

from measure_results import revision
from paper_table import (
    PROTOCOLS,
    RELEASED,
    SIX,
    Cell,
    cells_of,
    difference,
    mean_success,
    read_runs,
    write_runs,
)

from craftsim.errors import InputError
from craftsim.learning.algorithms import ALGORITHMS
from craftsim.learning.checkpoint import RUN_FILE
from craftsim.learning.config import RELEASED_STEPS
from craftsim.learning.curve import CURVE_FILE, last_point
from craftsim.storage.writing import write_whole
from craftsim.tasks.task import DEFAULT_MAX_STEPS

ROOT: Final = Path(__file__).parents[1]
OUT: Final = ROOT / "out" / "paper"
STORED: Final = ROOT / "docs" / "results" / "training" / "paper_runs.json"
HELD_OUT: Final = ROOT / "docs" / "results" / "training" / "paper_held_out.json"
DECISIVE_TASKS: Final = ("free_building", "breaking_barrier", "complex_two_story")
DECISIVE_ALGORITHMS: Final = ("qmix", "vdn", "iql")
OTHER_TASKS: Final = ("strip", "block", "simple_two_story")
LONGER: Final = (28, 48)
"""``max_steps`` in comments of CraftEnv's configuration beside the released one."""
SEEDS: Final = 3
FIRST_HELD_OUT: Final = 100
HELD_OUT_CELLS: Final = (
    "strip/coma",
    "block/ippo",
    "simple_two_story/mappo",
    "free_building/ippo/28",
)
"""Cells that cost a few minutes."""
INTERRUPTED: Final = 130


@dataclass(frozen=True, order=True)
class Run:
    """A training run of the table."""

    task: str
    algo: str
    max_steps: int
    protocol: str
    steps: int
    seed: int

    @property
    def name(self) -> str:
        """What its folder is called."""
        episodes = f"{self.max_steps}-{self.protocol}"
        return f"{self.task}-{self.algo}-{episodes}-{self.steps}-{self.seed}"

    @property
    def cell(self) -> Cell:
        """The cell of the table that it belongs to."""
        return Cell(self.task, self.algo, self.max_steps, self.protocol, self.steps)


@dataclass(frozen=True)
class Plan:
    """Which runs there are to be, in their order."""

    seeds: range
    cells: tuple[str, ...] = ()
    """Such as ``strip/coma`` or ``strip/coma/28``; all unless given."""
    protocol: str | None = None
    """Of all runs, other than :data:`paper_table.RELEASED` says."""
    steps: int | None = None
    """Of each run, other than the paper's."""

    def runs(self, finished: Iterable[dict[str, Any]]) -> list[Run]:
        """Return all runs, those of longer episodes where the finished ones call for them."""
        if self.cells:
            named = []
            for words in self.cells:
                named.append(_cell_of(words))
            return self._by_seed(named)
        decisive = []
        for task in DECISIVE_TASKS:
            for algo in DECISIVE_ALGORITHMS:
                decisive.append((task, algo, DEFAULT_MAX_STEPS))
        runs = self._by_seed(decisive)
        by_run = {}
        for record in finished:
            by_run[run_of(record)] = record
        shorter = decisive
        for max_steps in LONGER:
            without = []
            for task, algo, before in shorter:
                if self._gave_nothing((task, algo, before), by_run):
                    without.append((task, algo, max_steps))
            runs += self._by_seed(without)
            shorter = without
        others = []
        for task in (*OTHER_TASKS, *DECISIVE_TASKS):
            for algo in SIX:
                if (task, algo, DEFAULT_MAX_STEPS) not in decisive:
                    others.append((task, algo, DEFAULT_MAX_STEPS))
        return runs + self._by_seed(others)

    def _gave_nothing(self, place: tuple[str, str, int], by_run: dict[Run, dict[str, Any]]) -> bool:
        """Return whether all seeds of a cell have ended, none with a success in its last fifth."""
        records = [by_run.get(run) for run in self._by_seed([place])]
        return all(record is not None and record["last_fifth"] == 0 for record in records)

    def _by_seed(self, places: Sequence[tuple[str, str, int]]) -> list[Run]:
        """Return the runs of some cells: the first seed of each, then the second of each, and so on."""
        runs = []
        for seed in self.seeds:
            for task, algo, max_steps in places:
                steps = self.steps or RELEASED_STEPS[task]
                protocol = self.protocol or RELEASED[algo]
                runs.append(Run(task, algo, max_steps, protocol, steps, seed))
        return runs


def _cell_of(words: str) -> tuple[str, str, int]:
    """Return task, algorithm and step limit of a cell that is named ``task/algorithm`` or ``task/algorithm/28``."""
    task, _, after = words.partition("/")
    algo, _, limit = after.partition("/")
    if task not in RELEASED_STEPS or algo not in ALGORITHMS or not (limit or "18").isdigit():
        raise SystemExit(
            f"no cell '{words}'; allowed: TASK/ALGORITHM or TASK/ALGORITHM/MAX_STEPS with tasks "
            f"{', '.join(RELEASED_STEPS)} and algorithms {', '.join(ALGORITHMS)}"
        )
    return task, algo, int(limit or DEFAULT_MAX_STEPS)


def run_of(record: dict[str, Any]) -> Run:
    """Return which run a stored record is of."""
    names = ("task", "algo", "max_steps", "protocol", "steps", "seed")
    return Run(**{name: record[name] for name in names})


def command_of(run: Run, out: Path) -> list[str]:
    """Return the command that trains, or goes on training."""
    words = f"train {run.task} --algo {run.algo} {PROTOCOLS[run.protocol]} --steps {run.steps}"
    words += f" --max-steps {run.max_steps} --seed {run.seed} --resume"
    return [sys.executable, "-P", "-m", "craftsim", *words.split(), "--out", str(out)]


class Folder:
    """The folder of runs that are finished and under way, which several processes share."""

    def __init__(self, path: Path) -> None:
        """Take a folder, which is made with the first run."""
        self.path = path

    def report(self, run: Run) -> Path:
        """Return where the report of a run is once it has ended."""
        return self.path / run.name / "report.json"

    def finished(self, run: Run) -> bool:
        """Return whether a run has ended."""
        return self.report(run).is_file()

    def records(self) -> list[dict[str, Any]]:
        """Return the record of each run that has ended."""
        records = []
        for path in sorted(self.path.glob("*.begun.json")):
            begun = json.loads(path.read_text(encoding="utf-8"))
            run = run_of(begun["run"])
            if self.finished(run):
                records.append(self._record(run, begun["revisions"]))
        return records

    def _record(self, run: Run, revisions: Sequence[str]) -> dict[str, Any]:
        """Return what is stored of a run that has ended."""
        report = json.loads(self.report(run).read_text(encoding="utf-8"))
        figures = report["figures"]
        curve = []
        for point in figures["learning_curve"]:
            success = point["successes"] / point["episodes"]
            curve.append([point["steps"], success, point["mean_return"]])
        return asdict(run) | {
            "revision": ", ".join(revisions),
            "versions": figures["training_versions"],
            "cpu_s": round(report["wall"]["training_cpu_s"]),
            "last_fifth": figures["last_fifth"],
            "mean_return": figures["mean_return"],
            "curve": curve,
        }

    @contextmanager
    def claimed(self, run: Run) -> Iterator[int | None]:
        """Claim a run against all other processes; None if one has it.

        The lock is that of the operating system, on a file whose number the training process inherits: it lasts as
        long as any of both processes lives, and ends with them, however they end.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        number = os.open(self.path / f"{run.name}.lock", os.O_RDWR | os.O_CREAT, 0o644)
        try:
            try:
                fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                yield None
            else:
                yield number
        finally:
            os.close(number)

    def train(self, run: Run, lock: int) -> int:
        """Train, or go on training; return the exit status."""
        begun = self.path / f"{run.name}.begun.json"
        revisions: list[str] = []
        if begun.exists():
            revisions = json.loads(begun.read_text(encoding="utf-8"))["revisions"]
        if revision() not in revisions:
            revisions.append(revision())
        write_whole(begun, json.dumps({"run": asdict(run), "revisions": revisions}))
        with (self.path / f"{run.name}.log").open("a", encoding="utf-8") as log:
            process = subprocess.Popen(
                command_of(run, self.path / run.name),
                cwd=ROOT,
                stdout=log,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                pass_fds=(lock,),
                start_new_session=True,
            )
            try:
                return process.wait()
            except KeyboardInterrupt:
                process.terminate()  # it saves what it has
                process.wait()
                raise


def train(folder: Folder, plan: Plan) -> int:
    """Do all runs of a plan that nobody else does; return the exit status: 1 if some have failed."""
    failed: set[Run] = set()
    while True:
        known = read_runs(STORED) + folder.records()
        stored = set(map(run_of, known))
        goes_on = False
        for run in plan.runs(known):
            if run in stored or run in failed:
                continue
            with folder.claimed(run) as lock:
                if lock is None:
                    continue
                goes_on = True
                if folder.finished(run):
                    break  # meanwhile, by another process
                print(f"{run.name}: begins, or goes on", flush=True)
                status = folder.train(run, lock)
            if folder.finished(run):
                # What only an interrupted run goes on from, with all of its replay memory.
                (folder.path / run.name / RUN_FILE).unlink(missing_ok=True)
                print(f"{run.name}: finished", flush=True)
            else:
                failed.add(run)
                print(f"{run.name}: ended with {status}, see {run.name}.log", flush=True)
            break
        if not goes_on:
            return int(bool(failed))


def status(folder: Folder, plan: Plan) -> int:
    """Say of each run of a plan how far it is."""
    records = {run_of(record): record for record in read_runs(STORED) + folder.records()}
    done_s = 0
    for run in plan.runs(records.values()):
        if run in records:
            record = records[run]
            done_s += record["cpu_s"] or 0
            words = f"finished, success {record['last_fifth']:.2f} in the last fifth"
        else:
            words = _progress(folder, run)
        print(f"{run.name:60} {words}")
    print(f"CPU hours of what is finished: {done_s / 3600:.1f}")
    return 0


def _progress(folder: Folder, run: Run) -> str:
    """Return how far a run is that has not ended."""
    if not (folder.path / f"{run.name}.lock").exists():
        return "not run"
    with folder.claimed(run) as lock:
        state = "interrupted" if lock is not None else "under way"
    try:
        last = last_point(folder.path / run.name / CURVE_FILE)
    except InputError:
        last = None
    if last is None:
        return f"{state}, nothing is evaluated yet"
    return (
        f"{state}, {last.steps:,} steps, success {last.success:.2f}, return {last.mean_return:.1f}"
    )


def collect(folder: Folder) -> int:
    """Store what is finished beside what is stored already."""
    runs = {run_of(record): record for record in read_runs(STORED)}
    new = {}
    for record in folder.records():
        run = run_of(record)
        if run not in runs and run.seed < FIRST_HELD_OUT:
            new[run] = record
    write_runs(STORED, [record for _, record in sorted((runs | new).items())])
    print(f"{len(new)} runs are new of {len(runs) + len(new)}")
    return 0


def check_held_out(folder: Folder, plan: Plan) -> int:
    """Train cells of the page with other seeds; say and store how far they are from what the page says.

    Return the exit status: 1 if the intervals of some differences exclude none.
    """
    cells = cells_of(read_runs(STORED))
    checked = []
    n_others = 0
    for words in plan.cells:
        task, algo, max_steps = _cell_of(words)
        candidates = []
        for cell in cells:
            if (cell.task, cell.algo, cell.max_steps) == (task, algo, max_steps):
                candidates.append(cell)
        if not candidates:
            raise SystemExit(f"the page has no cell '{words}'")
        # That of the protocol of the plan, or else of the released one, if there is one; and the longest one.
        wanted = plan.protocol or RELEASED[algo]
        candidates.sort(key=lambda cell: (cell.protocol == wanted, cell.steps))
        cell = candidates[-1]
        listed = {record["seed"] for record in cells[cell]}
        if listed & {*plan.seeds}:
            raise SystemExit(f"{words}: the page has seeds {sorted(listed)}; take others: --first")
        of_cell = replace(plan, cells=(words,), protocol=cell.protocol, steps=cell.steps)
        if train(folder, of_cell):
            return 2
        runs = set(of_cell.runs(()))
        records = [record for record in folder.records() if run_of(record) in runs]
        if len(records) < len(runs):
            raise SystemExit(f"{words}: another process trains it; wait until it has ended")
        rates = [record["last_fifth"] for record in records]
        of_page = cell.success(cells[cell])
        mean, low, high = difference(of_page, mean_success(rates))
        is_another = not low <= 0 <= high
        n_others += is_another
        checked.append(
            asdict(cell)
            | {
                "success": of_page[0],
                "low": of_page[1],
                "high": of_page[2],
                "seeds": [record["seed"] for record in records],
                "rates": rates,
                "revision": ", ".join(sorted({record["revision"] for record in records})),
            }
        )
        verdict = "another" if is_another else "no difference seen"
        print(f"{words}: {mean:+.2f} ({low:+.2f} to {high:+.2f}), {verdict}", flush=True)
    lines = ",\n".join(json.dumps(record) for record in checked)
    write_whole(HELD_OUT, f"[\n{lines}\n]\n")
    return int(n_others > 0)


def main(argv: Sequence[str] | None = None) -> int:
    """Do what is asked; return the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("command", choices=("train", "status", "collect", "held-out"))
    parser.add_argument(
        "cells", nargs="*", metavar="TASK/ALGORITHM[/MAX_STEPS]", help="some cells alone"
    )
    parser.add_argument(
        "--protocol",
        choices=PROTOCOLS,
        help="of all runs; default: fork, of others than Q-learning coded",
    )
    parser.add_argument("--seeds", type=int, help=f"how many; {SEEDS}, of held-out ones 1")
    parser.add_argument(
        "--first", type=int, help=f"the first; 0, of held-out ones {FIRST_HELD_OUT}"
    )
    parser.add_argument("--steps", type=int, help="of a run, other than the paper's")
    parser.add_argument(
        "--folder", type=Path, default=OUT, help=f"default: {OUT.relative_to(ROOT)}"
    )
    arguments = parser.parse_args(argv)
    is_held_out = arguments.command == "held-out"
    count = arguments.seeds or (1 if is_held_out else SEEDS)
    first = arguments.first
    if first is None:
        first = FIRST_HELD_OUT if is_held_out else 0
    cells = tuple(arguments.cells)
    if is_held_out and not cells:
        cells = HELD_OUT_CELLS
    plan = Plan(range(first, first + count), cells, arguments.protocol, arguments.steps)
    folder = Folder(arguments.folder.resolve())
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        if arguments.command == "train":
            return train(folder, plan)
        if arguments.command == "status":
            return status(folder, plan)
        if arguments.command == "collect":
            return collect(folder)
        return check_held_out(folder, plan)
    except KeyboardInterrupt:
        print("Interrupted; the same command goes on.")
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
