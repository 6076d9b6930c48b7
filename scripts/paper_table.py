"""The table of CraftEnv's paper, from the runs that scripts/paper.py has stored: cells, verdicts and curves.

A cell is an algorithm on a task by one way of training. The interval of its success holds for the mean over seeds of
shares between 0 and 1, at every number of seeds, so that seeds may be added at any time.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from craftsim.discrete.grid import Grid, Kind, beside
from craftsim.experiments.anytime import bounds
from craftsim.learning.algorithms import ALGORITHMS
from craftsim.learning.curve import share_reaching
from craftsim.learning.study import Study, Threshold, read_study
from craftsim.storage.writing import write_whole
from craftsim.tasks import make_task
from craftsim.tasks.potentials import PUBLISHED_COMPLETION
from craftsim.tasks.starts import targets_of
from craftsim.tasks.task import DEFAULT_MAX_STEPS

EPISODES: Final = 20
"""Of each evaluation."""
TICKS_MORE: Final = 2
"""An episode has so many ticks more than ``max_steps``."""
LEARNED: Final = 0.9
"""From this success in the last fifth of its evaluations on a seed counts as one that has learned."""
SIX: Final = ("iql", "vdn", "coma", "qmix", "qtran", "mappo")
"""The paper's algorithms, in its order."""
PROTOCOLS: Final = {
    "fork": "--preset fork",
    "paper": "--preset paper",
    "coded": "--preset paper --reward published_code",
}
"""Options by protocol: the released learner with its reward; the paper's; the paper's with the released reward."""
WITH_RELEASED_REWARD: Final = ("fork", "coded")
RELEASED: Final = {
    **dict.fromkeys(ALGORITHMS, "coded"),
    **dict.fromkeys(("iql", "vdn", "qmix"), "fork"),
}
"""The protocol that is nearest to what was released, by algorithm."""
NONE: Final = "-"
HEAD: Final = (
    "task",
    "algorithm",
    "published",
    "ticks",
    "seeds",
    "success (95 %)",
    "by return",
    "nothing built",
    "steps, k",
    "protocol",
)
"""Of the table; what is stored has the revision of each run."""


@dataclass(frozen=True, order=True)
class Cell:
    """An algorithm on a task, trained in one way."""

    task: str
    algo: str
    max_steps: int
    protocol: str
    steps: int

    def success(self, runs: Sequence[Mapping[str, Any]]) -> tuple[float, float, float]:
        """Return the mean success over the seeds of the cell, and its 95 % interval."""
        return mean_success([run["last_fifth"] for run in runs])


def mean_success(rates: Sequence[float]) -> tuple[float, float, float]:
    """Return the mean over seeds, and its 95 % interval."""
    low, high = bounds(sum(rates), len(rates))
    return sum(rates) / len(rates), low, high


def difference(
    first: tuple[float, float, float], second: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Return the difference of two means, second minus first, and its 95 % interval, from those of both.

    Distances from the means to the ends of the intervals are added as standard errors are (Zou and Donner, 2008).
    """
    first_mean, first_low, first_high = first
    second_mean, second_low, second_high = second
    mean = second_mean - first_mean
    below = math.hypot(second_mean - second_low, first_high - first_mean)
    above = math.hypot(second_high - second_mean, first_mean - first_low)
    return mean, mean - below, mean + above


Cells = dict[Cell, list[dict[str, Any]]]


def read_runs(path: Path) -> list[dict[str, Any]]:
    """Return the runs that are stored."""
    runs: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))["runs"]
    return runs


def write_runs(path: Path, runs: Iterable[Mapping[str, Any]]) -> None:
    """Store runs, a line each."""
    lines = ",\n".join(json.dumps(run) for run in runs)
    write_whole(path, f'{{"runs": [\n{lines}\n]}}\n')


def cells_of(runs: Iterable[dict[str, Any]]) -> Cells:
    """Return the runs of each cell."""
    cells: Cells = {}
    for run in runs:
        cell = Cell(run["task"], run["algo"], run["max_steps"], run["protocol"], run["steps"])
        cells.setdefault(cell, []).append(run)
    return cells


@cache
def _paper() -> Study:
    return read_study("paper")


def published(task: str, algo: str) -> str:
    """Return the published success rate of an algorithm; its bound where only the best one's is at hand."""
    rates = _paper().reference.get(task, {})
    if algo in rates:
        return f"{rates[algo]:.2f}"
    if algo in SIX and rates:
        return f"≤ {max(rates.values()):.2f}"
    return ""


def table_rows(runs: Sequence[dict[str, Any]], lengths: Mapping[str, int]) -> list[tuple[str, ...]]:
    """Return the rows of the table: a cell each, and what is not run of the paper's.

    ``lengths`` are the paper's steps by task.
    """
    cells = cells_of(runs)
    rows = [HEAD]
    for task in lengths:
        of_task = [cell for cell in cells if cell.task == task]
        of_task.sort(
            key=lambda cell: (_place(cell.algo), cell.max_steps, cell.protocol, cell.steps)
        )
        whole = {cell.algo for cell in of_task if _is_released(cell, lengths[task])}
        for cell in of_task:
            # Shortened runs are something only as long as there are no whole ones.
            if cell.steps >= lengths[task] or cell.algo not in whole:
                _add(rows, _row(cell, cells[cell]))
        rows += _missing(task, of_task, lengths[task])
    return rows


def _add(rows: list[tuple[str, ...]], row: tuple[str, ...]) -> None:
    """Add a row, to that of an algorithm before with the same results, where there is one."""
    task, algo, *results = row
    for i, (other_task, others, *other_results) in enumerate(rows):
        if (other_task, other_results) == (task, results):
            rows[i] = task, f"{others}, {algo}", *results
            return
    rows.append(row)


def _place(algo: str) -> tuple[int, str]:
    """Return where an algorithm stands: the paper's before others."""
    if algo in SIX:
        return SIX.index(algo), algo
    return len(SIX), algo


def _row(cell: Cell, runs: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    mean, low, high = cell.success(runs)
    success = f"{mean:.2f} ({low:.2f}-{high:.2f})"
    returns = [run["mean_return"] for run in runs if run["mean_return"] is not None]
    if mean == 0 and returns:
        success += f", return {sum(returns) / len(returns):.1f}"
    learned = sum(run["last_fifth"] >= LEARNED for run in runs)
    return (
        f"`{cell.task}`",
        f"`{cell.algo}`",
        published(cell.task, cell.algo),
        str(cell.max_steps + TICKS_MORE),
        f"{learned}/{len(runs)}",
        success,
        *by_return(cell.task, runs),
        f"{cell.steps / 1000:.0f}",
        cell.protocol,
    )


def by_return(task: str, runs: Sequence[Mapping[str, Any]]) -> tuple[str, str]:
    """Return the share of evaluations that count by CraftEnv's threshold, and that of those that built nothing.

    Both are means over seeds; of what has no threshold, or another reward, there are none.
    """
    threshold = _paper().thresholds.get(task)
    if threshold is None or any(run["protocol"] not in WITH_RELEASED_REWARD for run in runs):
        return NONE, NONE
    counted = 0.0
    unbuilt = 0.0
    for run in runs:
        returns = [(steps, mean_return) for steps, _, mean_return in run["curve"]]
        counted += _share(returns, threshold)
        # An evaluation with a success is none of these.
        for i, (steps, success, _) in enumerate(run["curve"]):
            if success > 0:
                returns[i] = steps, -math.inf
        unbuilt += _share(returns, threshold)
    return f"{counted / len(runs):.2f}", f"{unbuilt / len(runs):.2f}"


def _share(returns: Sequence[tuple[int, float]], threshold: Threshold) -> float:
    return share_reaching(returns, threshold.mean_return, threshold.last)


def _is_released(cell: Cell, steps: int) -> bool:
    """Return whether a cell has the released protocol and step limit, and the paper's steps."""
    as_released = cell.max_steps, cell.protocol
    return as_released == (DEFAULT_MAX_STEPS, RELEASED[cell.algo]) and cell.steps >= steps


def _missing(task: str, cells: Sequence[Cell], steps: int) -> list[tuple[str, ...]]:
    """Return a row of the algorithms that are not run as released, for the paper's length; none where all are."""
    names = []
    rates = []
    for algo in SIX:
        if any(cell.algo == algo and _is_released(cell, steps) for cell in cells):
            continue
        names.append(f"`{algo}`")
        if algo in _paper().reference[task]:
            rates.append(f"`{algo}` {published(task, algo)}")
        else:
            rates.append(published(task, algo))
    if not names:
        return []
    rates = sorted(set(rates), key=lambda rate: (not rate.startswith("≤"), rate))
    ticks = str(DEFAULT_MAX_STEPS + TICKS_MORE)
    blank = ("",) * 3
    length = f"{steps / 1000:.0f}"
    last = length, "released"
    return [(f"`{task}`", ", ".join(names), ", ".join(rates), ticks, "not run", *blank, *last)]


def verdict_rows(
    runs: Sequence[dict[str, Any]], lengths: Mapping[str, int]
) -> list[tuple[str, ...]]:
    """Return for each published figure whether its algorithm reaches it, and which other cells do in the mean."""
    cells = cells_of(runs)
    rows = [("task", "algorithm", "published", "reproduced", "others, by means")]
    for task, rates in _paper().reference.items():
        for algo, rate in rates.items():
            usual = []
            otherwise = []
            for cell in sorted(cells):
                if cell.task != task:
                    continue
                success = cell.success(cells[cell])
                if cell.algo == algo and cell.max_steps == DEFAULT_MAX_STEPS:
                    usual.append((success, cell, len(cells[cell])))
                elif success[0] >= rate > 0:
                    ticks = ""
                    if cell.max_steps != DEFAULT_MAX_STEPS:
                        ticks = f" ({cell.max_steps + TICKS_MORE} ticks)"
                    otherwise.append(f"`{cell.algo}`{ticks}")
            others = ", ".join(dict.fromkeys(otherwise)) or NONE
            verdict = _verdict(rate, usual, lengths[task])
            rows.append((f"`{task}`", f"`{algo}`", f"{rate:.2f}", verdict, others))
    return rows


def _verdict(
    rate: float, cells: Sequence[tuple[tuple[float, float, float], Cell, int]], steps: int
) -> str:
    """Return what an algorithm's best cell says of a published rate.

    A cell comes with its mean success and interval, and its number of seeds. "Yes" and "no" are outside the interval;
    within it, a mean that reaches the rate is compatible with it, and one that does not decides nothing.
    """
    if not cells:
        return "not run"
    (mean, low, high), cell, seeds = max(cells)
    if rate == 0.0:
        verdict = "nothing, as published" if mean == 0.0 else "more than published"
    elif low >= rate:
        verdict = "yes"
    elif mean >= rate:
        verdict = "compatible"
    elif high >= rate:
        verdict = "undecided"
    else:
        verdict = "no"
    length = f"{cell.steps / 1000:.0f}k"
    if cell.steps < steps:
        length += f" of {steps / 1000:.0f}k steps"
    return f"{verdict}: {mean:.2f} ({low:.2f}-{high:.2f}), {seeds}x{length}, `{cell.protocol}`"


def explored_rows(report: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return for each task of the study paper_ippo how many seeds learned, their success, and when they did."""
    head = (
        "task",
        "best published",
        "seeds",
        "success (95 %)",
        "first success at, k",
        "steps, k",
        "CPU min",
    )
    rows: list[tuple[str, ...]] = [head]
    for row in report["figures"]["rows"]:
        task = row["task"]
        rates = row["by_seed"]
        mean, low, high = mean_success(rates)
        learned = sum(rate >= LEARNED for rate in rates)
        firsts = []
        times_s = []
        for run in report["figures"]["runs"]:
            if run["task"] != task:
                continue
            times_s.append(report["wall"]["cpu_s"][run["key"]])
            reached = [steps for steps, rate in run["curve"] if rate > 0]
            firsts.append(f"{reached[0] / 1000:.0f}" if reached else NONE)
        minutes = NONE
        if None not in times_s:
            minutes = f"{sum(times_s) / 60:.0f}"
        rows.append(
            (
                f"`{task}`",
                f"{max(_paper().reference[task].values()):.2f}",
                f"{learned}/{len(rates)}",
                f"{mean:.2f} ({low:.2f}-{high:.2f})",
                ", ".join(firsts),
                f"{row['median_steps'] / 1000:.0f}",
                minutes,
            )
        )
    return rows


def rule_rows() -> list[tuple[str, ...]]:
    """Return what CraftEnv's thresholds ask for, from what its reward pays."""
    rows = [
        (
            "task",
            "mean return that counts",
            "return of a finished building",
            f"episodes of {EPISODES} that must finish",
            "return of slopes unfolded where they stand",
        )
    ]
    for task, threshold in _paper().thresholds.items():
        finished = _worth(task, _finished)
        # All targets but one, without the bonus.
        most_unfinished = finished - PUBLISHED_COMPLETION - 1
        needed = (threshold.mean_return - most_unfinished) / (finished - most_unfinished)
        episodes = math.ceil(EPISODES * max(0.0, needed) - 1e-9)
        numbers = threshold.mean_return, finished, episodes, _worth(task, _unfolded)
        rows.append((f"`{task}`", *(f"{number:g}" for number in numbers)))
    return rows


def _worth(name: str, change: Any) -> float:
    """Return what CraftEnv's reward pays in all for a changed start."""
    task = make_task(name, reward="published_code")
    grid = task.draw(np.random.default_rng(0))
    change(grid, task.design)
    return float(task.potential(grid[None], targets_of(task.design)[None])[0])


def _finished(grid: Grid, design: Any) -> None:
    for target in design.targets:
        grid.kind[target.cell] = target.kind


def _unfolded(grid: Grid, design: Any) -> None:
    for x, y, z in np.argwhere(grid.kind == Kind.FSLOPE):
        foot = beside((int(x), int(y), int(z)), int(grid.yaw[x, y, z]))
        grid.kind[x, y, z] = Kind.BODY
        grid.kind[foot] = Kind.FOOT


def held_out_rows(cells: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return what held-out seeds came to beside what the page says, and what can be said of the difference."""
    rows = [
        (
            "cell",
            "page (95 %)",
            "held-out seeds",
            "success (95 %)",
            "difference (95 %)",
            "another",
            "revision",
        )
    ]
    for cell in cells:
        name = f"`{cell['task']}`, `{cell['algo']}`, {cell['max_steps'] + TICKS_MORE} ticks"
        of_page = (cell["success"], cell["low"], cell["high"])
        held_out = mean_success(cell["rates"])
        mean, low, high = difference(of_page, held_out)
        rows.append(
            (
                f"{name}, {cell['steps'] / 1000:.0f}k, `{cell['protocol']}`",
                f"{of_page[0]:.2f} ({of_page[1]:.2f}-{of_page[2]:.2f})",
                f"{len(cell['seeds'])}",
                f"{held_out[0]:.2f} ({held_out[1]:.2f}-{held_out[2]:.2f})",
                f"{mean:+.2f} ({low:+.2f} to {high:+.2f})",
                "not seen" if low <= 0 <= high else "yes",
                cell["revision"],
            )
        )
    return rows


def plot(runs: Sequence[dict[str, Any]], tasks: Sequence[str], path: Path) -> None:
    """Draw success and mean return of each seed over steps, a column a task and a colour an algorithm.

    Of each algorithm the runs of the released step limit are shown, as released or else the longest; returns where they
    are stored, with CraftEnv's threshold where they are of its reward.
    """
    algos = sorted({run["algo"] for run in runs}, key=_place)
    figure = Figure((3.2 * len(tasks), 5.2), layout="constrained")
    panels = figure.subplots(2, len(tasks), squeeze=False, sharex="col")
    shown = {}
    for number, task in enumerate(tasks):
        compares = False
        for color, algo in enumerate(algos):
            for run in _shown(runs, task, algo):
                compares |= run["protocol"] in WITH_RELEASED_REWARD
                curve = np.array(run["curve"]).T
                for row, values in enumerate(curve[1:]):
                    (line,) = panels[row, number].plot(
                        curve[0] / 1000, values, color=f"C{color}", linewidth=0.9, alpha=0.8
                    )
                    shown[algo] = line
        threshold = _paper().thresholds.get(task)
        if threshold is not None and compares:
            panels[1, number].axhline(threshold.mean_return, color="gray", linestyle=":")
        panels[0, number].set(title=task, ylim=(-0.04, 1.04))
        panels[1, number].set_xlabel("1000 steps")
        if not panels[1, number].lines:
            panels[1, number].set_yticks([])
            panels[1, number].text(
                0.5, 0.5, "not stored", transform=panels[1, number].transAxes, ha="center"
            )
    panels[0, 0].set_ylabel("success")
    panels[1, 0].set_ylabel("mean return")
    figure.legend(shown.values(), shown.keys(), loc="outside right center")
    figure.savefig(path, dpi=100)


def _shown(runs: Sequence[dict[str, Any]], task: str, algo: str) -> list[dict[str, Any]]:
    cells = []
    for cell in cells_of(runs):
        if (cell.task, cell.algo, cell.max_steps) == (task, algo, DEFAULT_MAX_STEPS):
            cells.append(cell)
    if not cells:
        return []
    chosen = max(cells, key=lambda cell: (cell.protocol == RELEASED[algo], cell.steps))
    return cells_of(runs)[chosen]
