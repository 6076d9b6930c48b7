"""Measure what workers do and cost: what ``craftsim bench workers`` prints."""

from __future__ import annotations

import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from craftsim.commands.bench_campaign import cost_of_a_trial
from craftsim.commands.bench_handing import hand_over
from craftsim.errors import CraftsimError
from craftsim.extras import install
from craftsim.validation.validation import validate

if TYPE_CHECKING:
    from rich.console import Console


def bench_workers(console: Console, task: str, runs: int, seed: int) -> dict[str, Any]:
    """Print what worker processes do, and cost; return wall times, and CPU times of a single run.

    Args:
        console: where to print.
        task: of which joint steps are handed over to other processes.
        runs: how often ``strip`` is built with one worker, and with two.
        seed: of these runs.

    Raises CraftsimError where two workers give other results than one.
    """
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
    cost = cost_of_a_trial("strip", max(1, runs // 4), seed)
    console.print(
        f"A run takes {cost.trial_s:.2f} s of CPU, {1e3 * cost.handing_out_s:.1f} ms of them for handing it out and "
        f"writing it down: {cost.million_h:.0f} CPU hours for a million.",
        soft_wrap=True,
    )
    handed = hand_over(task)
    for engine, over in handed.items():
        who = "A process of this machine" if engine == "local" else "An actor of Ray on this machine"
        console.print(
            f"{who} adds {over.joint_step_cpu_us:.0f} us of CPU to a joint step, its answer is there "
            f"{over.joint_step_wall_us:.0f} us later; to a trial of a campaign {over.trial_cpu_us:.0f} us of CPU.",
            soft_wrap=True,
        )
    if "ray" not in handed:
        text = f"Ray is not installed, so its actors are not measured; try: {install('ray')}"
        console.print(text, soft_wrap=True, markup=False)
    return {
        "one_worker_s": seconds[0],
        "two_workers_s": seconds[1],
        "ratio": seconds[0] / seconds[1],
        "cpu_s_a_run": cost.trial_s,
        "cpu_s_of_handing_out": cost.handing_out_s,
        "cpu_h_a_million": cost.million_h,
        "handing_over": {engine: asdict(over) for engine, over in handed.items()},
    }
