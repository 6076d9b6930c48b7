"""Run a campaign for long and hold that the memory of this process and of its workers stays flat.

First many cheap trials, which show what the campaign itself keeps; then small random worlds in physics until the time
is up, which show what the simulation leaves behind in the workers.
"""

from __future__ import annotations

import argparse
import contextlib
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median

import cheap_work

from craftsim.checking.setup import setup_of
from craftsim.experiments.experiment import Experiment, RunOptions, Trial, TrialRecord
from craftsim.experiments.session import run_experiment
from craftsim.learning.policies import RANDOM
from craftsim.validation.rollout import PLAY, run_job
from craftsim.validation.sources import policy_source, rollout_trials, rollout_worlds

WORKERS = 2
ALLOWED_MB = 30.0
SAMPLE_S = 0.5


class _EnoughError(Exception):
    """The time is up."""


class Memory:
    """Resident memory of this process and of its workers in MB, by their names, over a campaign.

    Worlds differ in size, so that growth is the distance of the medians of the first and of the last quarter of what
    was seen when all was warm.
    """

    def __init__(self, warm: int, until: float) -> None:
        """Leave out so many trials at the beginning, and end at a time of the clock."""
        self.warm, self.until = warm, until
        self.trials, self._next = 0, 0.0
        self.seen: defaultdict[str, list[float]] = defaultdict(list)

    def on_record(self, record: TrialRecord) -> None:
        """Look, now and then."""
        self.trials += 1
        now = time.monotonic()
        if self.trials <= self.warm or now < self._next:
            return
        self._next = now + SAMPLE_S
        for name, pid in (
            {"parent": "self"} | {f"worker {pid}": pid for pid in _workers()}
        ).items():
            self.seen[name].append(_resident_mb(pid))
        if now > self.until:
            raise _EnoughError

    def print_and_check(self, what: str) -> None:
        """Print a table, and hold that nothing grew by more than it may."""
        print(f"{what}: {self.trials} trials, of which the first {self.warm} do not count")
        print(f"  {'process, MB':16} {'begin':>8} {'end':>8} {'most':>8} {'growth':>8}")
        assert self.seen, "it ended before anything was warm"
        for name, sizes in self.seen.items():
            quarter = max(1, len(sizes) // 4)
            begin, end = median(sizes[:quarter]), median(sizes[-quarter:])
            print(
                f"  {name:16} {begin:8.1f} {end:8.1f} {max(sizes):8.1f} {end - begin:8.1f}",
                flush=True,
            )
            assert end - begin < ALLOWED_MB, f"{name} grew by more than {ALLOWED_MB:g} MB"


def _resident_mb(pid: str) -> float:
    lines = _read(Path(f"/proc/{pid}/status")).splitlines()
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("VmRSS")), 0.0)


def _workers() -> list[str]:
    """Return the children of this process that do work; the tracker of resources is none."""
    children = [
        pid
        for task in Path("/proc/self/task").iterdir()
        for pid in _read(task / "children").split()
    ]
    return sorted(pid for pid in children if "spawn_main" in _read(Path(f"/proc/{pid}/cmdline")))


def _read(path: Path) -> str:
    try:
        return path.read_text()
    except (FileNotFoundError, ProcessLookupError):
        return ""


def _soak(
    what: str, items: Sequence[Trial], work: Callable[..., object], memory: Memory, batch: int = 1
) -> None:
    with tempfile.TemporaryDirectory() as folder, contextlib.suppress(_EnoughError):
        options = RunOptions(
            WORKERS, progress=lambda total: contextlib.nullcontext(memory.on_record)
        )
        run_experiment(Experiment("soak", 0, {}, items, work, batch=batch), Path(folder), options)
    memory.print_and_check(what)


def main(minutes: float, cheap: int, warm: int, worlds_warm: int) -> None:
    """Run so many cheap trials, then physics until the time is up."""
    until = time.monotonic() + 60 * minutes
    large = cheap_work.items(cheap, **{f"i{i}": "large" for i in range(cheap)})
    _soak("cheap trials with long records", large, cheap_work.work, Memory(warm, until), batch=5)
    source = policy_source(PLAY, rollout_worlds([RANDOM], 1, None, 4))
    subjects, setup = rollout_worlds([RANDOM], 1, None, 4), setup_of("mild", "physical")
    worlds = list(rollout_trials(subjects, [source], 100_000, 0, setup, order="ticks"))
    _soak("random worlds in physics", worlds, run_job, Memory(worlds_warm, until))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument(
        "--cheap", type=int, default=20_000, help="cheap trials before those in physics"
    )
    parser.add_argument(
        "--warm", type=int, default=1000, help="cheap trials after which nothing may grow"
    )
    parser.add_argument("--worlds-warm", type=int, default=60, help="the same of worlds")
    given = parser.parse_args()
    main(given.minutes, given.cheap, given.warm, given.worlds_warm)
