"""Draw the starts that are shipped with the tasks that vary: held-out ones with a plan for each, designs to train from.

    python scripts/splits.py random_strip designs

Nothing decides but the seed: the planner makes so many attempts at each start, however long they take.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from craftsim.designs.tasks import DrawnDesigns, shape_digest
from craftsim.planning import NoPlanError, plan_building
from craftsim.storage.writing import whole
from craftsim.tasks import Task, as_task
from craftsim.tasks.random_tasks import RANDOM_NAMES, RandomPlacement
from craftsim.tasks.registry import DESIGNS
from craftsim.tasks.starts import Split, Starts, split_path

HELD_OUT = dict.fromkeys(RANDOM_NAMES, 1000) | {DESIGNS: 800}
TRAINED = 6000
"""Designs to train from."""
SAME = 25
"""Designs of one shape at most, so that no simple one prevails."""
ROUNDS = 8
"""Attempts of the planner at each start."""
BATCH = 50
AT_ONCE = 200
"""Starts that are planned between two looks at how many there are."""


def batches(name: str, split: Split) -> Iterator[Starts]:
    """Yield batches of starts, without end."""
    rng = np.random.default_rng(0 if split == "test" else 1)
    sampler = as_task(name).sampler
    while True:
        if isinstance(sampler, RandomPlacement):
            yield replace(sampler, task=replace(sampler.task, split=split)).draw(rng, BATCH)
        else:
            yield DrawnDesigns(split=split).fresh(rng, BATCH)


def distinct(name: str, split: Split) -> Iterator[Starts]:
    """Yield distinct starts one by one, without end; of designs not too many of one shape."""
    seen: set[bytes] = set()
    shapes: Counter[bytes] = Counter()
    for starts in batches(name, split):
        for i, digest in enumerate(starts.digests()):
            if digest in seen:
                continue
            seen.add(digest)
            if name == DESIGNS:
                shape = shape_digest(starts.designs[i])
                if shapes[shape] == SAME:
                    continue
                shapes[shape] += 1
            yield starts.take(np.array([i]))


def planned_ticks(task: Task, start: Starts) -> int:
    """Return how many ticks a plan takes, 0 where none is found."""
    grid = start.grid(0)
    one = task.starting_from([grid], start.design(0, DESIGNS)) if task.draws_designs else task
    try:
        return len(plan_building(grid, one, rounds=ROUNDS, time_s=math.inf).ticks)
    except NoPlanError:
        return 0


def write(name: str, split: Split, kept: list[Starts], ticks: list[int]) -> Path:
    """Write starts, with the ticks of a plan for each, into the file of a split; return the file."""
    path, starts = split_path(name, split), Starts.joined(kept)
    path.parent.mkdir(exist_ok=True)
    known = starts.grids.to_arrays() | {"designs": starts.designs}
    arrays = {array: known[array].astype(np.int8) for array in ("kind", "yaw", "cars", "designs")}
    with whole(path) as unfinished, unfinished.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays, ticks=np.array(ticks, np.int16))
    return path


def write_held_out(name: str, n: int) -> None:
    """Write n distinct starts that a plan within the task's step limit is known for."""
    task = as_task(name)
    kept: list[Starts] = []
    ticks: list[int] = []
    lengths: list[int] = []
    drawn = distinct(name, "test")
    with ProcessPoolExecutor() as pool:
        while len(kept) < n:
            some = list(islice(drawn, AT_ONCE))
            for start, length in zip(
                some, pool.map(partial(planned_ticks, task), some), strict=True
            ):
                lengths.append(length)
                # An episode has two ticks more than its step limit.
                if 0 < length <= task.max_steps + 2:
                    kept.append(start)
                    ticks.append(length)
                if len(kept) == n:
                    break
    path = write(name, "test", kept, ticks)
    found = [length for length in lengths if length]
    print(
        f"{name}: {len(found)} of {len(lengths)} starts planned, in {np.median(found):.0f} ticks in the "
        f"median, {np.percentile(found, 95):.0f} in 95 %; {n} of at most {task.max_steps + 2} in {path}",
        flush=True,
    )


def write_trained() -> None:
    """Write designs to train from, whether a plan is known or not."""
    kept = list(islice(distinct(DESIGNS, "train"), TRAINED))
    shapes = {shape_digest(start.designs[0]) for start in kept}
    path = write(DESIGNS, "train", kept, [0] * TRAINED)
    print(f"{DESIGNS}: {TRAINED} of {len(shapes)} shapes in {path}", flush=True)


def main() -> None:
    """Write the files of the tasks that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tasks", nargs="*", default=list(HELD_OUT), choices=HELD_OUT)
    args = parser.parse_args()
    for name in args.tasks:
        if name == DESIGNS:
            write_trained()
        write_held_out(name, HELD_OUT[name])


if __name__ == "__main__":
    main()
