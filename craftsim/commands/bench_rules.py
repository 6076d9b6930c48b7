"""Measure how fast the grid rules are: what ``craftsim bench rules`` prints."""

from __future__ import annotations

import resource
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from craftsim.commands.bench_calibration import COLUMNS, measure
from craftsim.commands.bench_cells import Cells, show
from craftsim.discrete.rules import RuleSet
from craftsim.discrete.tasks import make_task
from craftsim.discrete.tasks.episodes import Episodes

if TYPE_CHECKING:
    from rich.console import Console


def bench_rules(
    console: Console,
    tasks: Sequence[str],
    depth: int,
    rules: RuleSet,
    worlds: int,
    seconds: float,
    memory_worlds: int,
    seed: int,
    out: Path | None,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Print the rates of the rules; return the figures that are the same every time, and what the clock said.

    Args:
        console: where to print.
        tasks: names of the tasks, those for which CraftEnv's rate is known; the last one's memory is measured.
        depth: search depth of the helper.
        rules: the rule set.
        worlds: how many worlds a batch has.
        seconds: how long each measurement runs.
        memory_worlds: how many worlds to make for the memory figure.
        seed: seed of starts and actions.
        out: folder for the table in Markdown, if there is to be one.

    Raises:
        InputError: the disk does not take the file.
    """
    rows: list[tuple[str, ...]] = []
    rates: dict[str, dict[str, Any]] = {}
    state, peak_mib, grown_mib = _memory(tasks[-1], memory_worlds, rules, depth, seed)
    for name in tasks:
        task = make_task(name, reward="published_code")
        rates[name] = {}
        for searched, n in ((None, worlds), (depth, worlds), (depth, 1)):
            rng = np.random.default_rng(seed)
            if n == 1:
                step = _single_step(Episodes(task, rng, 1, rules, searched), rng)
            else:
                step = _batch_step(Episodes(task, rng, n, rules, searched), rng)
            rate = measure(step, n, seconds, name, helper=searched is not None)
            work = "primitive" if searched is None else "helper"
            rates[name][f"{work}, {n} world{'s' if n > 1 else ''}"] = rate
            rows.append((name, work, str(n), *rate.cells()))
    table = Cells("Rules on the grid", ("task", "work", "worlds", *COLUMNS), tuple(rows))
    lines = (
        f"{memory_worlds:,} worlds of {tasks[-1]}: {state * memory_worlds / 2**20:.1f} MiB of state, {state} bytes "
        "each.",
        f"Peak memory {peak_mib:.0f} MiB, {grown_mib:.0f} MiB more than one world (helper masks and observations "
        "included).",
    )
    show([table], lines, console, None if out is None else out / "rules.md")
    figures = {"memory_worlds": memory_worlds, "bytes_a_world": state}
    return figures, {"rates": rates, "peak_mib": peak_mib, "grown_mib": grown_mib}


def _pick(rng: np.random.Generator, mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return for each car one of its allowed actions, uniformly; 0 where there is none."""
    picked: NDArray[np.int64] = (rng.random(mask.shape, dtype=np.float32) * mask).argmax(-1)
    return picked


def _batch_step(episodes: Episodes, rng: np.random.Generator) -> Callable[[], None]:
    helper = episodes.depth is not None
    masks = [episodes.reachable() if helper else episodes.legal()]

    def step() -> None:
        done = episodes.step(_pick(rng, masks[0])).done
        if done.any():
            episodes.reset(done.nonzero()[0])
        masks[0] = episodes.reachable() if helper else episodes.legal()
        if helper:
            episodes.vectors()

    return step


def _single_step(episodes: Episodes, rng: np.random.Generator) -> Callable[[], None]:
    masks = [episodes.reachable()]

    def step() -> None:
        if episodes.step(_pick(rng, masks[0])).done[0]:
            episodes.reset()
        masks[0] = episodes.reachable()
        episodes.vectors()

    return step


def _peak_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _memory(name: str, n: int, rules: RuleSet, depth: int, seed: int) -> tuple[int, float, float]:
    """Return what n worlds of a task take: bytes each, and peak memory and its growth in MiB.

    The growth is that of a step with helper masks and observations, after a batch of one has compiled everything.
    """
    task = make_task(name)
    peaks = []
    for size in (1, n):
        rng = np.random.default_rng(seed)
        episodes = Episodes(task, rng, size, rules, depth)
        _batch_step(episodes, rng)()
        peaks.append(_peak_mib())
    grids = episodes.grids
    state = grids.cells.nbytes + grids.cars.nbytes
    return state // n, peaks[1], peaks[1] - peaks[0]
