"""What ``craftsim bench physics`` has measured, in tables and lines, for the terminal and for the documentation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from craftsim.commands.bench_batches import WORLDS, WorkersTiming
from craftsim.commands.bench_calibration import Rate
from craftsim.commands.bench_cells import Cells

if TYPE_CHECKING:
    from craftsim.commands.bench_physics import YardTiming


def rate_table(rates: Sequence[tuple[str, str, Rate]]) -> Cells:
    """Return the rates of tasks, by drive."""
    rows = (
        (task, drive, f"{rate.steps_a_second:.1f}", f"{rate.reference_a_second:.1f}", f"{rate.times:.3f}")
        for task, drive, rate in rates
    )
    return Cells(
        "Joint steps a CPU second", ("task", "drive", "steps/s", "CraftEnv", "times CraftEnv"), tuple(rows)
    )


def yard_table(yards: Sequence[YardTiming]) -> Cells:
    """Return what worlds with so many cars and blocks cost."""
    rows = (
        (
            row.drive,
            str(row.n_cars),
            str(row.n_blocks),
            f"{row.joint_steps_a_second:.1f}",
            f"{row.units_a_step:.1f}",
            f"{row.physics_step_us:.0f}",
            f"{100 / row.timing.ratio:.0f} %",
            f"{row.timing.ratio:.2f}",
            f"{row.resets_a_second:.0f}",
        )
        for row in yards
    )
    head = ("drive", "cars", "blocks", "steps/s", "units", "us", "mj_step", "x bare", "resets/s")
    return Cells("Cars that drive to and fro, blocks at rest", head, tuple(rows))


def yard_lines(yards: Sequence[YardTiming]) -> list[str]:
    """Return, by drive, how costs grow with moving cars and with resting blocks."""
    lines = []
    for drive in dict.fromkeys(row.drive for row in yards):
        cost = {(row.n_cars, row.n_blocks): row.units_a_step for row in yards if row.drive == drive}
        alone = sorted(cars for cars, blocks in cost if not blocks)
        few, many = alone[0], alone[-1]
        grown = cost[many, 0] / many / (cost[few, 0] / few)
        lines.append(f"{drive}: a car of {many} costs {grown:.2f} times what one of {few} costs.")
        beside, blocks = max(cost, key=lambda key: key[1])
        if blocks and beside in alone:
            more = 100 * (cost[beside, blocks] / cost[beside, 0] - 1)
            lines.append(
                f"{drive}: {blocks} blocks at rest add {more:.0f} % to the cost of {beside} moving cars."
            )
    return lines


def batch_lines(
    task: str, workers: Mapping[str, WorkersTiming], mib_a_world: Mapping[str, float]
) -> list[str]:
    """Return, by drive, what many worlds of a task cost."""
    lines = []
    for drive, timing in workers.items():
        lines += [
            f"{drive}, {WORLDS} worlds of {task}: by CPU times two workers do {timing.free_ratio:.2f} times the joint "
            "steps of one, each on a processor of its own, with equal results; a joint step takes "
            f"{1e3 * timing.one_worker_cpu_s:.1f} ms.",
            f"{drive}: by the clock, {timing.one_worker:.1f} joint steps a second with one worker, "
            f"{timing.two_workers:.1f} with two, {timing.ratio:.2f} times as many ({timing.processors} processors, "
            f"load {timing.load:.1f}). A world takes {mib_a_world[drive]:.1f} MiB.",
        ]
    return lines
