"""Simulate how often intervals and tests of a success rate are ever wrong, with a look after every trial.

python scripts/anytime_coverage.py      # writes docs/results/anytime.json, some minutes

Every run is looked at after each of its trials; it counts as wrong if any of these looks is: the interval excludes the
true rate, a test rejects what is true, a certificate says the opposite. Wilson's interval is beside it, and for pairs
McNemar's exact test.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.audit.audit import BOUNDED_RATES
from craftsim.audit.stopping import FAILING_ERROR, PERFECT_TRIALS, SOUND_SHARE, error_bounds
from craftsim.experiments.anytime import (
    CONFIDENCE,
    log_evidence_above,
    log_evidence_below,
    log_evidence_of_difference,
)
from craftsim.experiments.intervals import wilson
from craftsim.reports.json_file import versions
from craftsim.storage.writing import write_whole

ROOT: Final = Path(__file__).parents[1]
STORED: Final = ROOT / "docs" / "results" / "anytime.json"
RUNS: Final = 10_000
TRIALS: Final = 1000
PAIRS: Final = 300
RATES: Final = (0.5, 0.8, 0.9, 0.95, 0.99, 0.999)
PAIR_SHARES: Final = ((0.05, 0.05), (0.25, 0.25), (0.05, 0.15))
"""Shares of pairs in which only the first, and only the second setting succeeds."""
AUDIT_ROWS, AUDIT_TRIALS = 300, 20
ERROR: Final = 1 - CONFIDENCE
NEEDED: Final = -math.log(ERROR)
NEEDED_OF_SIDE: Final = -math.log(ERROR / 2)

Booleans = NDArray[np.bool_]
Counts = NDArray[np.int64]


def wrong_table(is_wrong: Callable[[int, int], bool], n: int) -> Booleans:
    """Return whether an interval is wrong, by the number of successes and of trials."""
    table = np.zeros((n + 1, n + 1), bool)
    for trials in range(1, n + 1):
        for successes in range(trials + 1):
            table[successes, trials] = is_wrong(successes, trials)
    return table


def shares_of_rate(rate: float, rng: np.random.Generator) -> dict[str, Any]:
    """Return how often what is said of a success rate is ever wrong, for one true rate."""
    good = np.cumsum(rng.random((RUNS, TRIALS)) < rate, axis=1, dtype=np.int64)
    trials = np.arange(1, TRIALS + 1)
    above = log_evidence_above(good, trials, rate)
    below = log_evidence_below(good, trials, rate)

    def wilson_excludes(successes: int, n: int) -> bool:
        low, high = wilson(successes, n)
        return not low <= rate <= high

    wilson_wrong = wrong_table(wilson_excludes, TRIALS)[good, trials]
    every_tenth = np.arange(9, 300, 10)
    return {
        "rate": rate,
        "interval": _ever((above >= NEEDED_OF_SIDE) | (below >= NEEDED_OF_SIDE)),
        "certificate_yes": _ever(above >= NEEDED),
        "certificate_no": _ever(below >= NEEDED),
        "wilson": _ever(wilson_wrong),
        "wilson_every_tenth_to_300": _ever(wilson_wrong[:, every_tenth]),
    }


def shares_of_pairs(worse: float, better: float, rng: np.random.Generator) -> dict[str, Any]:
    """Return how often what is said of a difference of two settings is ever wrong, for one true difference."""
    from scipy.stats import binom

    drawn = rng.random((RUNS, PAIRS))
    only_first = np.cumsum(drawn < worse, axis=1, dtype=np.int64)
    only_second = np.cumsum((drawn >= worse) & (drawn < worse + better), axis=1, dtype=np.int64)
    difference = better - worse
    pairs = np.broadcast_to(np.arange(1, PAIRS + 1), only_first.shape)
    counts, place = np.unique(
        np.stack([only_first, only_second, pairs], axis=-1).reshape(-1, 3),
        axis=0,
        return_inverse=True,
    )
    evidence = np.array([log_evidence_of_difference(*map(int, row), difference) for row in counts])
    shares: dict[str, Any] = {
        "only_first": worse,
        "only_second": better,
        "interval": _ever((evidence >= NEEDED)[place.reshape(only_first.shape)]),
    }
    if difference == 0:
        fewer = np.minimum(only_first, only_second)
        p_value = np.minimum(1.0, 2 * binom.cdf(fewer, only_first + only_second, 0.5))
        shares["mcnemar"] = _ever(p_value < ERROR)
    return shares


def shares_of_audits(rng: np.random.Generator) -> dict[str, Any]:
    """Return how often a working row is called failing early, and how often the bound of wrongly passing rows is
    exceeded, over audits with all kinds of rows."""
    good = np.cumsum(rng.random((RUNS, AUDIT_TRIALS)) < SOUND_SHARE, axis=1, dtype=np.int64)
    trials = np.arange(1, AUDIT_TRIALS + 1)
    failing = log_evidence_below(good, trials, SOUND_SHARE) >= -math.log(FAILING_ERROR)
    exceeded = dict.fromkeys(BOUNDED_RATES, 0)
    for _ in range(RUNS):
        rates = rng.beta(*rng.uniform(0.1, 10, 2), size=AUDIT_ROWS)
        rates[rng.random(AUDIT_ROWS) < rng.random()] = 1.0
        outcomes = rng.random((AUDIT_ROWS, PERFECT_TRIALS)) < rates[:, None]
        half = PERFECT_TRIALS // 2
        passing = outcomes[:, :half].all(axis=1)
        for bound in error_bounds(outcomes.tolist(), BOUNDED_RATES):
            bad = passing & (rates <= bound.success_rate)
            exceeded[bound.success_rate] += bool((rates[bad] ** half).sum() > bound.rows)
    return {
        "called_failing": _ever(failing),
        "bound_exceeded": {str(rate): n / RUNS for rate, n in exceeded.items()},
    }


def _ever(wrong: Booleans) -> float:
    """Return the share of runs with a look that is wrong."""
    return float(wrong.any(axis=1).mean())


def main() -> int:
    """Simulate, and store the shares."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    start_s = time.process_time()
    audits = shares_of_audits(np.random.default_rng([asked.seed, 2]))
    print(audits, flush=True)
    rates = []
    for number, rate in enumerate(RATES):
        rates.append(shares_of_rate(rate, np.random.default_rng([asked.seed, 0, number])))
        print(rates[-1], flush=True)
    pairs = []
    for number, (worse, better) in enumerate(PAIR_SHARES):
        rng = np.random.default_rng([asked.seed, 1, number])
        pairs.append(shares_of_pairs(worse, better, rng))
        print(pairs[-1], flush=True)
    stored = {
        "seed": asked.seed,
        "versions": versions(),
        "runs": RUNS,
        "trials": TRIALS,
        "pairs": PAIRS,
        "error": round(ERROR, 6),
        "cpu_s": round(time.process_time() - start_s, 1),
        "rates": rates,
        "differences": pairs,
        "audits": audits,
    }
    write_whole(STORED, json.dumps(stored, indent=1) + "\n")
    shares = [
        row[name] for row in rates for name in ("interval", "certificate_yes", "certificate_no")
    ]
    shares += [row["interval"] for row in pairs]
    shares += audits["bound_exceeded"].values()
    return int(max(shares) > ERROR or audits["called_failing"] > FAILING_ERROR)


if __name__ == "__main__":
    raise SystemExit(main())
