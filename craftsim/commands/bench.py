"""Measure how fast rules, environments, physics, workers and films are, and how long actions take."""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import tyro

from craftsim.commands.text import say
from craftsim.discrete.rules import RuleSet
from craftsim.errors import CraftsimError
from craftsim.models.parameters import Drive
from craftsim.storage.limits import BATCH, BENCH_RUNS, BENCH_S, BENCH_TICKS, SEED

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from rich.console import Console

    from craftsim.discrete.tasks.episodes import Episodes, GridEpisode

TASKS: Final = ("simple_two_story", "complex_two_story")
"""Those with two and with four cars."""

DEPTH: Final = 20
"""The search depth of CraftEnv's published training settings, the costlier of the two."""


def bench(
    what: tyro.conf.Positional[
        Literal["rules", "env", "physics", "steps", "trials", "workers", "render", "durations"]
    ],
    rules: RuleSet = "published",
    worlds: Annotated[int, BATCH] = 1000,
    seconds: Annotated[float, BENCH_S] = 2.0,
    memory_worlds: Annotated[int, BATCH] = 10_000,
    episode: Annotated[int, BENCH_TICKS] = 20,
    runs: Annotated[int, BENCH_RUNS] = 40,
    contexts: Annotated[int, BENCH_RUNS] = 60,
    drive: Drive = "rollers",
    seed: Annotated[int, SEED] = 0,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
) -> int:
    """Measure how fast the grid rules, the environments and worker processes are, or how long actions take.

    rules: steps a CPU second, and the memory of many worlds. A step is one tick of one world, with reward,
    end of episode and reset, and the masks of all cars for the next one; "helper" adds the helper's search to masks
    and moves, and the global observation of every car. Drawing actions from the masks is part of the time.
    A fixed calibration work in plain Python is timed in turns with it: "per unit" is steps in the time of one unit of
    that work, "CraftEnv" what CraftEnv would do here and now by an estimate from the calibration, "times" the ratio.

    env: the same through PettingZoo and in batches; and in physics, the CPU time of a step against that of MuJoCo's
    steps alone under the same commands.

    physics: joint steps a CPU second against CraftEnv's; with growing numbers of cars that drive and of blocks that
    rest against MuJoCo's steps alone under the same commands ("x bare"; "us" is what one of these takes, "units"
    what a joint step costs in units of the calibration work); resets; many worlds with one worker process and with two.

    steps: how verdicts, errors, durations and forces depend on the physics step, over contexts of the audit.

    trials: the CPU time of a trial of the audit, stage by stage, over contexts taken evenly from all that it tries.

    workers: two worker processes against one, building a task again and again, their start included; and what a single
    run costs in a campaign, apart from such starts.

    render: frames a second of a film with its captions, encoded, beside a bare loop over MuJoCo's renderer; two
    processes against one; what recording a run adds to its CPU time.

    durations: how long actions take in physics, as craftsim/data/durations.yaml holds it for the grid environments.

    Args:
        what: what to measure.
        rules: the rule set to run; rules only.
        worlds: how many worlds a batch has.
        seconds: how long each measurement on the grid runs, and each play of a task in physics.
        memory_worlds: how many worlds to make for the memory figure; rules only.
        episode: ticks of the episode that is timed in physics, 2 or more; env only.
        runs: how often the task is built; workers only.
        contexts: how many contexts of the audit are tried; steps and trials only.
        drive: of the cars; steps and trials only.
        seed: decides starts, actions and orders.
        out: folder for report.json; for physics.png and physics.md, too.
    """
    from craftsim.commands.terminal import Terminal
    from craftsim.report import output_directory, write_report

    if out is not None:
        output_directory(out)
    console = Terminal(highlight=False)
    figures: dict[str, Any] = {}
    wall: dict[str, Any] = {}
    config: dict[str, Any] = {"what": what}
    match what:
        case "rules":
            config |= {"rules": rules, "worlds": worlds, "depth": DEPTH}
            figures, wall = _bench_rules(console, rules, worlds, seconds, memory_worlds, seed)
        case "env":
            from craftsim.commands.bench_env import bench_env

            config |= {"worlds": worlds, "depth": DEPTH, "episode": episode}
            wall = bench_env(console, TASKS, DEPTH, worlds, seconds, episode, seed)
        case "physics":
            from craftsim.commands.bench_physics import bench_physics

            config |= {"seconds": seconds}
            wall = bench_physics(console, TASKS, seconds, seed, out)
        case "steps":
            from craftsim.commands.bench_steps import bench_steps

            config |= {"contexts": contexts, "drive": drive}
            figures = bench_steps(console, drive, contexts, seed)
        case "trials":
            from craftsim.commands.bench_trials import bench_trials

            config |= {"contexts": contexts, "drive": drive}
            wall = bench_trials(console, drive, contexts, seed)
        case "workers":
            config |= {"runs": runs}
            wall = _bench_workers(console, runs, seed)
        case "render":
            from craftsim.commands.bench_render import bench_render

            wall = bench_render(console, seed)
        case "durations":
            import yaml

            from craftsim.checking.nominal import measure_durations

            figures = measure_durations()
            console.print(yaml.safe_dump(figures, sort_keys=False), end="")
    if out is not None:
        write_report(out, figures, command="bench", seed=seed, config=config, wall=wall)
    return 0


def _bench_rules(
    console: Console, rules: RuleSet, worlds: int, seconds: float, memory_worlds: int, seed: int
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Print the rates of the rules; return the figures that are the same every time, and what the clock said."""
    import numpy as np
    from rich.box import SIMPLE
    from rich.table import Table

    from craftsim.commands.bench_calibration import COLUMNS, measure
    from craftsim.discrete.tasks import make_task
    from craftsim.discrete.tasks.episodes import Episodes, GridEpisode

    table = Table("task", "work", "worlds", *COLUMNS, box=SIMPLE)
    rates: dict[str, dict[str, Any]] = {}
    state, peak_mib, grown_mib = _memory(memory_worlds, rules, seed)
    for name in TASKS:
        task = make_task(name, reward="published_code")
        rates[name] = {}
        for depth, n in ((None, worlds), (DEPTH, worlds), (DEPTH, 1)):
            rng = np.random.default_rng(seed)
            if n == 1:
                step = _single_step(GridEpisode(task, rng, rules, depth), rng)
            else:
                step = _batch_step(Episodes(task, rng, n, rules, depth), rng)
            rate = measure(step, n, seconds, name, helper=depth is not None)
            work = "primitive" if depth is None else "helper"
            rates[name][f"{work}, {n} world{'s' if n > 1 else ''}"] = rate
            table.add_row(name, work, str(n), *rate.cells())
    console.print(table)
    say(
        f"{memory_worlds:,} worlds of {TASKS[1]}: {state * memory_worlds / 2**20:.1f} MiB of state, {state} bytes each"
    )
    say(
        f"peak memory {peak_mib:.0f} MiB, {grown_mib:.0f} MiB more than one world "
        "(helper masks and observations included)"
    )
    figures = {"memory_worlds": memory_worlds, "bytes_a_world": state}
    return figures, {"rates": rates, "peak_mib": peak_mib, "grown_mib": grown_mib}


def _pick(rng: np.random.Generator, mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return for each car one of its allowed actions, uniformly; 0 where there is none."""
    import numpy as np

    picked: NDArray[np.int64] = (rng.random(mask.shape, dtype=np.float32) * mask).argmax(-1)
    return picked


def _batch_step(episodes: Episodes, rng: np.random.Generator) -> Callable[[], None]:
    helper = episodes.worlds.depth is not None
    masks = [episodes.reachable() if helper else episodes.legal()]

    def step() -> None:
        done = episodes.step(_pick(rng, masks[0])).done
        if done.any():
            episodes.reset(done.nonzero()[0])
        masks[0] = episodes.reachable() if helper else episodes.legal()
        if helper:
            episodes.vectors()

    return step


def _single_step(episode: GridEpisode, rng: np.random.Generator) -> Callable[[], None]:
    masks = [episode.reachable()]

    def step() -> None:
        if episode.step(_pick(rng, masks[0])).done:
            episode.reset()
        masks[0] = episode.reachable()
        episode.vectors()

    return step


def _peak_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _memory(n: int, rules: RuleSet, seed: int) -> tuple[int, float, float]:
    """Return what n worlds of the complex two-story task take: bytes each, and peak memory and its growth in MiB.

    The growth is that of a step with helper masks and observations, after a batch of one has compiled everything.
    """
    import numpy as np

    from craftsim.discrete.tasks import make_task
    from craftsim.discrete.tasks.episodes import Episodes

    task = make_task(TASKS[1])
    peaks = []
    for size in (1, n):
        rng = np.random.default_rng(seed)
        episodes = Episodes(task, rng, size, rules, DEPTH)
        _batch_step(episodes, rng)()
        peaks.append(_peak_mib())
    arrays = episodes.worlds.arrays
    state = sum(a.nbytes for a in (arrays.kind, arrays.yaw, arrays.top, arrays.back, arrays.cars))
    return state // n, peaks[1], peaks[1] - peaks[0]


def _bench_workers(console: Console, runs: int, seed: int) -> dict[str, float]:
    """Build ``strip`` so many times with one worker and with two; return wall times, and CPU times of a single run."""
    from craftsim.commands.bench_campaign import cost_of_a_trial
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
    cost = cost_of_a_trial("strip", max(1, runs // 4), seed)
    console.print(
        f"A run takes {cost.trial_s:.2f} s of CPU, {1e3 * cost.handing_out_s:.1f} ms of them for handing it out and "
        f"writing it down: {cost.million_h:.0f} CPU hours for a million.",
        soft_wrap=True,
    )
    return {
        "one_worker_s": seconds[0],
        "two_workers_s": seconds[1],
        "ratio": seconds[0] / seconds[1],
        "cpu_s_a_run": cost.trial_s,
        "cpu_s_of_handing_out": cost.handing_out_s,
        "cpu_h_a_million": cost.million_h,
    }
