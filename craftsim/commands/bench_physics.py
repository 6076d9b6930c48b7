"""Measure how fast physics is: what ``craftsim bench physics`` prints and plots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from craftsim.commands.bench_batches import mib_a_world, time_workers
from craftsim.commands.bench_calibration import Rate, measure, pace, repeat
from craftsim.commands.bench_cells import listed
from craftsim.commands.bench_text import batch_lines, rate_table, yard_lines, yard_table
from craftsim.commands.bench_worlds import to_and_fro, yard
from craftsim.envs.options import Options
from craftsim.envs.parallel import ParallelConstruction
from craftsim.envs.timing import PhysicsTiming, parallel_step, time_physics
from craftsim.mjcf.parameters import DRIVES
from craftsim.storage.writing import write_whole

if TYPE_CHECKING:
    from rich.console import Console

CARS: Final = (2, 4, 8, 16, 32)
BLOCKS: Final = (8, 32, 128)
"""At rest, beside the cars of :data:`_BLOCKS_BESIDE`."""
_BLOCKS_BESIDE: Final = 4
_REPEATS: Final = 3
_RESETS_S: Final = 0.3
_PACE_S: Final = 0.2


def options_of(drive: str) -> dict[str, Any]:
    """Return the options of an environment whose cars have this drive."""
    return {"drive": drive}


@dataclass(frozen=True)
class YardTiming:
    """How fast a world with so many cars that drive to and fro, and so many blocks at rest, is."""

    drive: str
    n_cars: int
    n_blocks: int
    timing: PhysicsTiming
    resets_a_second: float
    """To the same start; CPU seconds."""
    units_a_second: float
    """Of the calibration work, in a CPU second just before or after, the better of the two as of all timings."""

    @property
    def joint_steps_a_second(self) -> float:
        """Of the environment, observations and masks included; CPU seconds."""
        return self.timing.n_steps / self.timing.env_s

    @property
    def units_a_step(self) -> float:
        """What a joint step costs in units of the calibration work: a figure that a slower moment leaves as it is."""
        return self.units_a_second / self.joint_steps_a_second

    @property
    def physics_step_us(self) -> float:
        """What MuJoCo takes for a physics step, in microseconds."""
        return 1e6 * self.timing.bare_s / self.timing.n_physics_steps

    def as_dict(self) -> dict[str, Any]:
        """Return all figures by name."""
        return asdict(self) | {
            "joint_steps_a_second": self.joint_steps_a_second,
            "units_a_step": self.units_a_step,
            "physics_step_us": self.physics_step_us,
            "times_bare": self.timing.ratio,
            "share_of_mj_step": 1 / self.timing.ratio,
        }


def bench_physics(
    console: Console,
    tasks: Sequence[str],
    seconds: float,
    seed: int,
    out: Path | None,
    drives: Sequence[str] = DRIVES,
    cars: Sequence[int] = CARS,
    blocks: Sequence[int] = BLOCKS,
) -> dict[str, Any]:
    """Print how fast physics is, and return it.

    Args:
        console: where to print.
        tasks: names of the tasks for which CraftEnv's rate is known; many worlds are of the first of them.
        seconds: how long each of these is played.
        seed: seed of starts, actions and orders.
        out: folder for the plot and the tables in Markdown, if there are to be any.
        drives: which models of the wheels to measure.
        cars: numbers of cars that drive to and fro.
        blocks: numbers of blocks at rest beside four of them.

    Raises:
        InputError: the disk does not take the files.
    """
    rates = [(task, drive, _rate(task, drive, seconds, seed)) for task in tasks for drive in drives]
    tables = [rate_table(rates)]
    console.print(tables[0].for_terminal())
    yards = [_time_yard(drive, n, 0, seed) for drive in drives for n in cars]
    yards += [_time_yard(drive, _BLOCKS_BESIDE, n, seed) for drive in drives for n in blocks]
    tables.append(yard_table(yards))
    console.print(tables[1].for_terminal())
    workers = {drive: time_workers(tasks[0], options_of(drive), seconds, seed) for drive in drives}
    memory = {drive: mib_a_world(tasks[0], options_of(drive)) for drive in drives}
    lines = [*yard_lines(yards), *batch_lines(tasks[0], workers, memory)]
    for line in lines:
        console.print(line, soft_wrap=True)
    if out is not None:
        from craftsim.commands.bench_plot import plot_physics

        plot_physics(out / "physics.png", yards)
        paragraphs = [*(table.as_markdown() for table in tables), *listed(lines)]
        write_whole(out / "physics.md", "\n\n".join(paragraphs) + "\n")
    return {
        "joint_steps": {
            f"{task}, {drive}": asdict(rate) | {"times": rate.times} for task, drive, rate in rates
        },
        "yards": [row.as_dict() for row in yards],
        "workers": {
            drive: asdict(timing) | {"ratio": timing.ratio, "free_ratio": timing.free_ratio}
            for drive, timing in workers.items()
        },
        "mib_a_world": memory,
    }


def _rate(task: str, drive: str, seconds: float, seed: int) -> Rate:
    env = ParallelConstruction(task, Options(**options_of(drive)))
    return measure(parallel_step(env, seed), 1, seconds, task, helper=True)


def _time_yard(drive: str, n_cars: int, n_blocks: int, seed: int) -> YardTiming:
    task, options = yard(n_cars, n_blocks), Options(**options_of(drive))
    before = pace(_PACE_S)
    timing = time_physics(task, seed, _REPEATS, options, to_and_fro)
    env = ParallelConstruction(task, options)
    env.reset(seed=seed)
    resets, spent = repeat(lambda _: env.reset(), _RESETS_S)
    return YardTiming(drive, n_cars, n_blocks, timing, resets / spent, max(before, pace(_PACE_S)))
