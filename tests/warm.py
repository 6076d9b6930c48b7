"""What the process that tests copy does at its start: compiled code is then loaded, and no copy loads it again."""

import numpy as np

from craftsim.checking.setup import Seed, set_up, setup_of
from craftsim.discrete.files.plan import read_plan
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.kinds import Action
from craftsim.discrete.tasks import make_task
from craftsim.envs import vector_env
from craftsim.mjcf.parameters import DRIVES

_task = make_task("strip")
_start = _task.draw(np.random.default_rng(0))
for _drive in DRIVES:
    _judge = set_up(_start, setup_of("mild", drive=_drive), Seed((5,)))
    _judge.perform_tick(read_plan(shipped_plan("strip"), _start.n_cars).ticks[0])
_worlds = vector_env(_task, 1, "grid")
_worlds.reset(seed=0)
_worlds.step(np.full((1, _start.n_cars), int(Action.STOP)))
