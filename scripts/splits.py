"""Draw the starts that are shipped with the tasks that vary: held-out ones with a plan for each, designs to train from.

    python scripts/splits.py random_strip designs

Nothing decides but the seed: the planner makes so many attempts at each start, however long they take.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from craftsim.designs.tasks import DrawnDesigns, shape_digest
from craftsim.discrete.tasks import Task, as_task
from craftsim.discrete.tasks.batches import Starts
from craftsim.discrete.tasks.random_tasks import LISTED, RANDOM
from craftsim.discrete.tasks.splits import write_split
from craftsim.discrete.tasks.varied import DESIGNS
from craftsim.planning import NoPlanError, plan_building

HELD_OUT = {f"{RANDOM}{name}": 1000 for name in LISTED} | {DESIGNS: 800}
TRAINED = 4096
"""Designs to train from."""
SAME = 25
"""Held-out designs of one shape at most, so that no simple one prevails."""
ROUNDS = 8
"""Attempts of the planner at each start."""
BATCH = 50


def held_out(name: str) -> Iterator[Starts]:
    """Yield batches of held-out starts, without end."""
    rng = np.random.default_rng(0)
    train = as_task(name).source
    draw = DrawnDesigns(split="test").fresh if name == DESIGNS else replace(train, split="test").draw
    while True:
        yield draw(rng, BATCH)


def planned_ticks(task: Task, starts: Starts, i: int) -> int:
    """Return how many ticks a plan takes, 0 where none is found."""
    grid = starts.grid(i)
    one = task.starting_at(grid, starts.design(i, DESIGNS)) if task.draws_designs else task
    try:
        return len(plan_building(grid, one, rounds=ROUNDS, time_s=math.inf).ticks)
    except NoPlanError:
        return 0


def write_held_out(name: str, n: int) -> None:
    """Write n distinct starts that a plan within the task's step limit is known for."""
    task = as_task(name)
    kept: list[Starts] = []
    seen: set[bytes] = set()
    shapes: Counter[bytes] = Counter()
    ticks: list[int] = []
    lengths: list[int] = []
    for starts in held_out(name):
        for i, digest in enumerate(starts.digests()):
            if digest in seen:
                continue
            seen.add(digest)
            if task.draws_designs:
                shape = shape_digest(starts.designs[i])
                if shapes[shape] == SAME:
                    continue
                shapes[shape] += 1
            lengths.append(planned_ticks(task, starts, i))
            # An episode has two ticks more than its step limit.
            if 0 < lengths[-1] <= task.max_steps + 2:
                kept.append(starts.take(np.array([i])))
                ticks.append(lengths[-1])
            if len(kept) == n:
                path = write_split(
                    name, "test", Starts(*map(np.concatenate, zip(*kept, strict=True))), np.array(ticks)
                )
                found = [length for length in lengths if length]
                print(
                    f"{name}: {len(found)} of {len(lengths)} starts planned, in {np.median(found):.0f} ticks in the "
                    f"median, {np.percentile(found, 95):.0f} in 95 %; {n} of at most {task.max_steps + 2} in {path}",
                    flush=True,
                )
                return


def main() -> None:
    """Write the files of the tasks that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tasks", nargs="*", default=list(HELD_OUT), choices=HELD_OUT)
    args = parser.parse_args()
    for name in args.tasks:
        if name == DESIGNS:
            starts = DrawnDesigns().fresh(np.random.default_rng(1), TRAINED)
            write_split(name, "train", starts, np.zeros(TRAINED, np.int64))
        write_held_out(name, HELD_OUT[name])


if __name__ == "__main__":
    main()
