"""Attack every format with damaged files. Run by ``make fuzz``, and for fewer cases by the tests.

A case may end well or with :class:`craftsim.errors.InputError`; another exception, more than two seconds or more than
500 MB, imports included, are failures. Case n of a format depends on the seed, the format and n alone.
"""

from __future__ import annotations

import argparse
import faulthandler
import importlib
import pkgutil
import sys
import tempfile
import time
import traceback
import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import fuzzing
from craftsim.errors import InputError

MAX_S = 2.0
MAX_GROWTH = 250e6
"""In bytes. A command's imports take up to 250 MB, so that this stays below 500 MB in all."""
HANGS_S = 60.0
"""After which a process is ended, with a traceback of where it hangs."""
CHUNK = 250

Attack = Callable[[np.random.Generator, Path], None]


@dataclass
class Outcome:
    """What came of some cases of one format."""

    target: str
    cases: int = 0
    refused: int = 0
    slowest_s: float = 0.0
    grown_bytes: int = 0
    """By how much the process was larger at its largest than before its first case, imports aside."""
    failures: tuple[str, ...] = ()

    def __add__(self, other: Outcome) -> Outcome:
        return Outcome(
            self.target,
            self.cases + other.cases,
            self.refused + other.refused,
            max(self.slowest_s, other.slowest_s),
            max(self.grown_bytes, other.grown_bytes),
            (*self.failures, *other.failures),
        )


def targets() -> dict[str, Attack]:
    """Return all attacks by name."""
    modules = [importlib.import_module(f"fuzzing.{module.name}") for module in pkgutil.iter_modules(fuzzing.__path__)
               if module.name not in ("fuzz", "mutations", "commands")]  # fmt: skip
    return {
        name: attack
        for module in modules
        if hasattr(module, "TARGETS")
        for name, attack in module.TARGETS.items()
    }


def attack(target: str, first: int, count: int, seed: int) -> Outcome:
    """Try some cases of one format."""
    run = targets()[target]
    # Cases of which one is the first to compile the rules, or to import something, are measured once more.
    for _ in range(2):
        outcome = Outcome(target)
        before = _peak_bytes(anew=True)
        with tempfile.TemporaryDirectory() as folder:
            for case in range(first, first + count):
                _try(outcome, run, case, seed, Path(folder))
        outcome.grown_bytes = _peak_bytes() - before
        if outcome.grown_bytes <= MAX_GROWTH:
            break
    else:
        outcome.failures += (
            f"{target}: one of the cases {first} to {first + count - 1} took too much memory",
        )
    return outcome


def _peak_bytes(anew: bool = False) -> int:
    """Return the most memory that this process has held, or since it was last asked for ``anew``."""
    if anew:
        Path("/proc/self/clear_refs").write_text("5")
    (line,) = (
        line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM")
    )
    return 1024 * int(line.split()[1])


def _try(outcome: Outcome, run: Attack, case: int, seed: int, folder: Path) -> None:
    for _ in range(2):
        rng = np.random.default_rng([seed, zlib.crc32(outcome.target.encode()), case])
        faulthandler.dump_traceback_later(HANGS_S, exit=True)
        begun, refused, failure = time.process_time(), False, ""
        try:
            run(rng, folder)
        except InputError:
            refused = True
        except BaseException:
            failure = f"{outcome.target} case {case}:\n{traceback.format_exc(limit=-4)}"
        took_s = time.process_time() - begun
        faulthandler.cancel_dump_traceback_later()
        # A case that is the first to compile the rules, or to import something, is timed once more.
        if took_s <= MAX_S:
            break
    outcome.cases, outcome.refused = outcome.cases + 1, outcome.refused + refused
    outcome.failures += (failure,) if failure else ()
    outcome.slowest_s = max(outcome.slowest_s, took_s)
    if took_s > MAX_S:
        outcome.failures += (f"{outcome.target} case {case}: took {took_s:.1f} s",)


def campaign(cases: int, seed: int, workers: int, names: list[str]) -> Iterator[Outcome]:
    """Yield what came of each chunk, the cases spread evenly over the formats."""
    chunks = [(name, first, min(CHUNK, cases - first)) for first in range(0, cases, CHUNK) for name in names]
    with ProcessPoolExecutor(workers) as pool:
        yield from pool.map(attack, *zip(*chunks, strict=True), [seed] * len(chunks))


def main(total: int, seed: int, workers: int, parts: list[str]) -> int:
    """Print a table of what came of the cases; return 1 if there was a failure."""
    names = [name for name in targets() if not parts or any(part in name for part in parts)]
    found = {name: Outcome(name) for name in names}
    each = -(-total // len(names))
    for outcome in campaign(each, seed, workers, names):
        for failure in outcome.failures:
            print(failure, flush=True)
        found[outcome.target] += outcome
        done = sum(one.cases for one in found.values())
        if sys.stderr.isatty():
            print(f"\r{done} of {each * len(names)} cases", end="", file=sys.stderr)
    print(f"{'format':<16}{'cases':>8}{'refused':>9}{'slowest':>10}{'memory':>10}{'failures':>10}")
    for one in found.values():
        print(
            f"{one.target:<16}{one.cases:>8}{one.refused:>9}{one.slowest_s:>8.2f} s{one.grown_bytes / 1e6:>7.0f} MB"
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
