"""Attack every format with damaged files. Run by ``python -m fuzzing.fuzz``, and for fewer cases by the tests.

A case may end well or with :class:`craftsim.errors.InputError`; another exception, more than two seconds or more than
500 MB, imports included, are failures. Case n of a format depends on the seed, the format and n alone.
"""

from __future__ import annotations

import argparse
import faulthandler
import shutil
import sys
import tempfile
import time
import traceback
import zlib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from craftsim.errors import InputError
from fuzzing.damage import damaged
from fuzzing.formats import FORMATS

MAX_S = 2.0
MAX_GROWTH = 250e6
"""In bytes. A command's imports take up to 250 MB, so that this stays below 500 MB in all."""
HANGS_S = 60.0
"""After which a process is ended, with a traceback of where it hangs."""
CHUNK = 250


@dataclass
class Outcome:
    """What came of some cases of one format."""

    cases: int = 0
    refused: int = 0
    slowest_s: float = 0.0
    grown_bytes: int = 0
    """By how much the process was larger at its largest than before its first case, imports aside."""
    failures: list[str] = field(default_factory=list)

    def add(self, other: Outcome) -> None:
        """Count others, too."""
        self.cases, self.refused = self.cases + other.cases, self.refused + other.refused
        self.slowest_s = max(self.slowest_s, other.slowest_s)
        self.grown_bytes = max(self.grown_bytes, other.grown_bytes)
        self.failures += other.failures


def attack(name: str, first: int, count: int, seed: int) -> Outcome:
    """Try some cases of one format."""
    # Cases of which one is the first to compile the rules, or to import something, are measured once more.
    for _ in range(2):
        outcome = Outcome()
        before = _peak_bytes(anew=True)
        for case in range(first, first + count):
            _try(outcome, name, case, seed)
        outcome.grown_bytes = _peak_bytes() - before
        if outcome.grown_bytes <= MAX_GROWTH:
            return outcome
    outcome.failures.append(
        f"{name}: one of the cases {first} to {first + count - 1} took too much memory"
    )
    return outcome


def _peak_bytes(anew: bool = False) -> int:
    """Return the most memory that this process has held, or since it was last asked for ``anew``."""
    if anew:
        Path("/proc/self/clear_refs").write_text("5")
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(line for line in lines if line.startswith("VmHWM")).split()[1])


def damage(name: str, case: int, seed: int, folder: Path) -> None:
    """Write an example of a format into a folder, one of its files damaged."""
    rng = np.random.default_rng([seed, zlib.crc32(name.encode()), case])
    examples = FORMATS[name].examples()
    files = examples[rng.integers(len(examples))]
    wrong = list(files)[max(0, int(rng.integers(1 - len(files), len(files))))]
    for file, data in files.items():
        (folder / file).write_bytes(damaged(file, data, rng) if file == wrong else data)


def _try(outcome: Outcome, name: str, case: int, seed: int) -> None:
    for _ in range(2):
        refused, failure = False, ""
        folder = Path(tempfile.mkdtemp())
        damage(name, case, seed, folder)
        faulthandler.dump_traceback_later(HANGS_S, exit=True)
        begun = time.process_time()
        try:
            FORMATS[name].read(folder)
        except InputError:
            refused = True
        except BaseException:
            failure = f"{name} case {case}:\n{traceback.format_exc(limit=-4)}"
        took_s = time.process_time() - begun
        faulthandler.cancel_dump_traceback_later()
        shutil.rmtree(folder)
        # A case that is the first to compile the rules, or to import something, is timed once more.
        if took_s <= MAX_S:
            break
    slow = f"{name} case {case}: took {took_s:.1f} s" if took_s > MAX_S else ""
    outcome.add(Outcome(1, int(refused), took_s, 0, [text for text in (failure, slow) if text]))


def main(total: int, seed: int, workers: int, parts: list[str]) -> int:
    """Print a table of what came of the cases, spread evenly over the formats; return 1 if there was a failure."""
    names = [name for name in FORMATS if not parts or any(part in name for part in parts)]
    each = -(-total // len(names))
    chunks = [
        (name, first, min(CHUNK, each - first)) for first in range(0, each, CHUNK) for name in names
    ]
    found = {name: Outcome() for name in names}
    with ProcessPoolExecutor(workers) as pool:
        outcomes = pool.map(attack, *zip(*chunks, strict=True), [seed] * len(chunks))
        for (name, *_), outcome in zip(chunks, outcomes, strict=True):
            print(*outcome.failures, sep="\n", end="\n" * bool(outcome.failures), flush=True)
            found[name].add(outcome)
    print(f"{'format':<16}{'cases':>8}{'refused':>9}{'slowest':>10}{'memory':>10}{'failures':>10}")
    for name, one in found.items():
        print(
            f"{name:<16}{one.cases:>8}{one.refused:>9}{one.slowest_s:>8.2f} s{one.grown_bytes / 1e6:>7.0f} MB"
            f"{len(one.failures):>10}"
        )
    failures = sum(len(one.failures) for one in found.values())
    print(f"{sum(one.cases for one in found.values())} cases, {failures} failures")
    return 1 if failures else 0


def sweep(workers: int, parts: list[str]) -> int:
    """Try what commands take in all hostile forms; return 1 if there was a failure."""
    from fuzzing.commands import SLOTS, attack_slot, forms

    slots = [slot for slot in SLOTS if not parts or any(part in slot for part in parts)]
    found: list[str] = []
    with ProcessPoolExecutor(workers) as pool:
        for slot, wrong in zip(slots, pool.map(attack_slot, slots), strict=True):
            print(f"{slot:<70}{len(wrong):>4} failures", *wrong, sep="\n", flush=True)
            found += wrong
    print(f"{len(slots) * len(forms())} cases, {len(found)} failures")
    return 1 if found else 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="parts of names of formats; all unless given")
    parser.add_argument("--cases", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument(
        "--commands", action="store_true", help="all that commands take, in all hostile forms"
    )
    given = parser.parse_args()
    if given.commands:
        sys.exit(sweep(given.workers, given.names))
    sys.exit(main(given.cases, given.seed, given.workers, given.names))
