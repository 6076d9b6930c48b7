"""The picture of what ``craftsim bench physics`` has measured."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from craftsim.storage.writing import whole

if TYPE_CHECKING:
    from craftsim.commands.bench_physics import YardTiming


def plot_physics(path: Path, yards: Sequence[YardTiming]) -> Path:
    """Draw, by drive, joint steps a second over moving cars and over resting blocks, and times bare over cars.

    Returns the path; raises InputError where the disk does not take it.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, StrMethodFormatter

    figure = Figure(figsize=(11.0, 3.6), layout="constrained")
    by_cars, by_blocks, over_bare = figure.subplots(1, 3)
    for drive in dict.fromkeys(row.drive for row in yards):
        alone = [row for row in yards if row.drive == drive and not row.n_blocks]
        beside = {row.n_cars for row in yards if row.drive == drive and row.n_blocks}
        blocks = [row for row in yards if row.drive == drive and row.n_cars in beside]
        blocks.sort(key=lambda row: row.n_blocks)
        cars = [row.n_cars for row in alone]
        by_cars.plot(cars, [row.joint_steps_a_second for row in alone], "o-", label=drive)
        over_bare.plot(cars, [row.timing.ratio for row in alone], "o-", label=drive)
        by_blocks.plot(
            [row.n_blocks for row in blocks], [row.joint_steps_a_second for row in blocks], "o-", label=drive
        )
    by_cars.set(xlabel="moving cars", ylabel="joint steps a CPU second", xscale="log", yscale="log")
    by_blocks.set(xlabel="blocks at rest beside 4 cars", ylabel="joint steps a CPU second")
    over_bare.set(xlabel="moving cars", ylabel="time over bare mj_step", xscale="log")
    by_cars.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    by_cars.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    by_blocks.set_ylim(0, 1.1 * by_blocks.get_ylim()[1])
    over_bare.set_ylim(1, 1 + 1.2 * (over_bare.get_ylim()[1] - 1))
    for axes in (by_cars, over_bare):
        axes.minorticks_off()
        axes.set_xticks(cars, [str(n) for n in cars])
    figure.legend(*by_cars.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    with whole(path) as partial:
        figure.savefig(partial, dpi=120)
    return path
