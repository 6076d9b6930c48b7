"""What a joint step in physics costs: beside MuJoCo's own steps alone, beside blocks that sleep, and in a large world;
and how much faster two processes are than one.

    python benchmarks/joint_steps.py    # three minutes on a machine that does nothing else

The share is the time of ``mj_step`` under the commands that were kept, over that of the environment, for the same
motion: no change outside of MuJoCo can make a joint step shorter than that. Writes docs/results/joint_steps.json.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, Final

import numpy as np
from benches import ToAndFro, yard

from craftsim.cli.bench import pick
from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint
from craftsim.discrete.grid import Grid, Kind
from craftsim.envs.options import Options
from craftsim.envs.parallel import ParallelConstruction
from craftsim.envs.physics_vector import PhysicsVectorEnv
from craftsim.mjcf.drives import DRIVES
from craftsim.models.world import PhysicsWorld
from craftsim.reports.json_file import versions
from craftsim.tasks import free_play

STORED: Final = Path(__file__).parents[1] / "docs" / "results" / "joint_steps.json"
CASES: Final = ((2, 0), (4, 0), (4, 128), (4, 512))
"""Cars that drive to and fro, and sleeping blocks."""
_LARGE: Final = ((40, 40, 6), 50, 500)
"""Size, cars and blocks of the large world."""
_LARGE_STEPS: Final = 10
_WORLDS: Final = 8
_WORLD_STEPS: Final = 20
"""Joint steps of each world that two workers share..."""
_WORKER_ROUNDS: Final = 12
"""...so often."""


def rows(rounds: int) -> list[dict[str, Any]]:
    """Return what joint steps of all cases cost, the least of some rounds, in which the cases take turns."""
    episodes = {}
    for drive in DRIVES:
        for case in CASES:
            episodes[drive, *case] = ToAndFro(yard(*case), drive=drive)
    least_s: dict[tuple[Any, ...], dict[str, float]] = {case: {} for case in episodes}
    for _ in range(rounds):
        for case, episode in episodes.items():
            for kind in ("play", "replay"):
                episode.reset()
                began_s = time.process_time()
                getattr(episode, kind)()
                taken_s = time.process_time() - began_s
                least_s[case][kind] = min(taken_s, least_s[case].get(kind, taken_s))
    found = []
    for (drive, cars, blocks), seconds in least_s.items():
        found.append(
            {
                "drive": drive,
                "cars": cars,
                "blocks": blocks,
                "joint_step_ms": 1e3 * seconds["play"] / 2,
                "share_of_mj_step": seconds["replay"] / seconds["play"],
                "times_without_blocks": seconds["play"] / least_s[drive, cars, 0]["play"],
            }
        )
    return found


def large_grid() -> Grid:
    """Return a large world: cars anywhere, towers of up to three blocks."""
    size, n_cars, n_blocks = _LARGE
    rng = np.random.default_rng(0)
    grid = Grid.empty(size, n_cars)
    columns = iter(rng.permutation(size[0] * size[1]).tolist())
    for car in range(n_cars):
        x, y = divmod(next(columns), size[1])
        grid.cars[car, :4] = x, y, 1, int(rng.integers(4))
    n_placed = 0
    while n_placed < n_blocks:
        x, y = divmod(next(columns), size[1])
        height = min(n_blocks - n_placed, int(rng.integers(1, 4)))
        grid.kind[x, y, 1 : height + 1] = Kind.BLOCK
        n_placed += height
    grid.derive_marks()
    return grid


def large() -> dict[str, Any]:
    """Return what compiling, a reset, and a joint step of masked random play cost in the large world."""
    size, n_cars, n_blocks = _LARGE
    grid = large_grid()
    began_s = time.process_time()
    PhysicsWorld(grid)
    start_s = time.process_time() - began_s
    blueprint = parse_blueprint(blueprint_text(grid), "large")
    task = free_play("large", (blueprint,), max_steps=_LARGE_STEPS)
    rng = np.random.default_rng(0)
    with closing(ParallelConstruction(task, Options())) as env:
        observations, _ = env.reset(seed=0)
        seconds = []
        while env.agents:
            masks = np.stack([observed["action_mask"] for observed in observations.values()])
            actions = dict(zip(env.agents, pick(rng, masks).tolist(), strict=True))
            began_s = time.process_time()
            observations = env.step(actions)[0]
            seconds.append(time.process_time() - began_s)
    return {
        "size": size,
        "cars": n_cars,
        "blocks": n_blocks,
        "start_s": start_s,
        "joint_step_s": float(np.median(seconds)),
        "longest_joint_step_s": max(seconds),
    }


def in_step(worlds: PhysicsVectorEnv) -> None:
    """Let all worlds play at random; each waits in every step for the slowest."""
    rng = np.random.default_rng(0)
    observations, _ = worlds.reset(seed=0)
    for _ in range(_WORLD_STEPS):
        actions = np.stack([pick(rng, masks) for masks in observations["action_mask"]])
        observations = worlds.step(actions)[0]


def at_own_pace(worlds: PhysicsVectorEnv) -> None:
    """Let all worlds play at random, each as fast as it can."""
    generators = [np.random.default_rng(world) for world in range(_WORLDS)]
    steps_left = [_WORLD_STEPS] * _WORLDS
    observations, _ = worlds.reset(seed=0)
    ids = list(range(_WORLDS))
    n_acting = 0
    while ids or n_acting:
        for row, world in enumerate(ids):
            if steps_left[world]:
                steps_left[world] -= 1
                n_acting += 1
                actions = pick(generators[world], observations["action_mask"][row])
                worlds.send(actions[None], [world])
        ids = []
        if n_acting:
            observations, *_, infos = worlds.recv()
            ids = infos["env_id"].tolist()
            n_acting -= len(ids)


def two_workers_over_one(play: Callable[[PhysicsVectorEnv], None]) -> float:
    """Return how many times as fast two worker processes are as one, by the clock, from the least of some rounds."""
    batches = {}
    with ExitStack() as stack:
        for workers in (1, 2):
            batch = PhysicsVectorEnv("simple_two_story", _WORLDS, workers=workers)
            batches[workers] = stack.enter_context(closing(batch))
            # Code is loaded in the first steps.
            play(batch)
        least_s = dict.fromkeys(batches, math.inf)
        for _ in range(_WORKER_ROUNDS):
            for workers, batch in batches.items():
                began_s = time.perf_counter()
                play(batch)
                least_s[workers] = min(least_s[workers], time.perf_counter() - began_s)
    return least_s[1] / least_s[2]


def main() -> None:
    """Measure and store."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=30)
    arguments = parser.parse_args()
    command = ["git", "rev-parse", "--short=8", "HEAD"]
    revision = subprocess.check_output(command, cwd=STORED.parent, text=True).strip()
    document = {
        "revision": revision,
        "versions": versions(),
        "large": large(),
        "rows": rows(arguments.rounds),
        "two_workers": {
            "worlds": _WORLDS,
            "step": two_workers_over_one(in_step),
            "send_and_recv": two_workers_over_one(at_own_pace),
        },
    }
    STORED.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(document, indent=1))


if __name__ == "__main__":
    main()
