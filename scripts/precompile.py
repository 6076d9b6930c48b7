"""Take each way through the compiled code once, so that all of it is compiled and kept for later processes.

The first that needs a compiled function compiles it, and all others wait: before a test suite it is done beside what
else is to be done, and for a wheel with its own code before it is built (``scripts/make_wheel.py``).
"""

from __future__ import annotations

import numpy as np

from craftsim.checking.setup import Seed, set_up, setup_of
from craftsim.compiled import jit
from craftsim.compiled.progress import report_compiling
from craftsim.designs.drawn import random_start
from craftsim.discrete.files.design import Design
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.grid import Grid, Kind, Piece
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules, has_room
from craftsim.envs import vector_env
from craftsim.envs.actions import ObjectChoice
from craftsim.mjcf.drives import DRIVES
from craftsim.planning import plan_building
from craftsim.planning.plan_file import read_plan
from craftsim.skills.mecanum import Mecanum
from craftsim.tasks import as_task, make_task
from craftsim.tasks.episodes import Episodes
from craftsim.tasks.task import TASK_NAMES


def main() -> None:
    """Play and plan tasks, on the grid and in physics, with every kind of imperfection."""
    report_compiling()
    jit.INTERPRETED_S = 0.0
    for name, options in (
        ("simple_two_story", {"rule_set": "physical"}),
        ("strip", {"rule_set": "published", "helper_depth": 2}),
        ("strip", {"helper_depth": 2, "object_choice": ObjectChoice()}),
        ("strip", {"execution": "asynchronous", "jitter": 0.1}),
    ):
        task = make_task(name)
        envs = vector_env(task, 1, "grid", **options)
        envs.reset(seed=0)
        envs.step(np.full((1, task.layout.n_cars), int(Action.STOP)))
    for name in TASK_NAMES:
        for reward in ("paper", "published_code"):
            Episodes(make_task(name, reward), np.random.default_rng(0))
    Episodes(as_task("large_free_building_4"), np.random.default_rng(0))
    start = task.draw(np.random.default_rng(0))
    rules = Rules("physical")
    rules.explain(start, 0, Action.LIFT)
    rules.enforce(start, 0, Action.STOP)
    rules.plan_move(start, 0, Action.MOVE_RIGHT)
    has_room(start)
    plan_building(start, task, rounds=1)
    small = Grid.empty((3, 2, 1), n_cars=1)
    small.put(Piece(Kind.BLOCK, (1, 0, 1)))
    plan_building(small, Design.of("small", [(2, 0, 1)]))
    random_start(np.random.default_rng(0))
    for drive in DRIVES:
        for preset in ("none", "workshop_floor"):
            judge = set_up(start, setup_of(preset, drive=drive), Seed((5,)))
            Mecanum(judge.physics.cars[0].parameters).body_twist(np.zeros(4))
            for tick in read_plan(shipped_plan("strip"), start.n_cars).ticks[:2]:
                judge.perform_tick(tick)


if __name__ == "__main__":
    main()
