"""``craftsim bench workers``: how much faster two worker processes are than one."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from rich.console import Console

from craftsim.discrete.errors import CraftsimError


def bench_workers(console: Console, runs: int, seed: int) -> dict[str, float]:
    """Build ``strip`` so many times with one worker and with two; return wall times, starts of processes included."""
    from craftsim.validation.validation import validate

    seconds, lines = [], []
    for workers in (1, 2):
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder)
            begun = time.perf_counter()
            validate("strip", randomize="mild", trials=runs, seed=seed, workers=workers, out=out)
            seconds.append(time.perf_counter() - begun)
            lines.append((out / "trials.jsonl").read_bytes())
        console.print(f"{workers} workers: {runs} runs in {seconds[-1]:.1f} s")
    if lines[0] != lines[1]:
        raise CraftsimError("two workers gave other results than one")
    console.print(f"Two are {seconds[0] / seconds[1]:.2f} times faster than one, with equal results.")
    return {"one_worker_s": seconds[0], "two_workers_s": seconds[1], "ratio": seconds[0] / seconds[1]}
