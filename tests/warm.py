"""What the process that tests copy does at its start: it imports, and loads compiled code, so that no copy has to."""

import gc
from contextlib import suppress
from importlib import import_module

NAMES = (
    *("craftsim.validation.rollout", "craftsim.validation.validation", "craftsim.experiments.session"),
    *("craftsim.envs.vector", "craftsim.cli.app", "craftsim.reports.report"),
    # The second is what torch imports when the first optimizer is made.
    *("craftsim.training.trainer", "torch._dynamo", "pandas", "scipy.stats", "matplotlib.figure"),
)


def _load():
    import numpy as np

    from craftsim.checking.setup import Seed, set_up, setup_of
    from craftsim.discrete.files.plan import read_plan
    from craftsim.discrete.files.shipped import shipped_plan
    from craftsim.discrete.kinds import Action
    from craftsim.discrete.tasks import make_task
    from craftsim.envs import vector_env
    from craftsim.mjcf.parameters import DRIVES

    task = make_task("strip")
    start = task.draw(np.random.default_rng(0))
    for drive in DRIVES:
        judge = set_up(start, setup_of("mild", drive=drive), Seed((5,)))
        judge.perform_tick(read_plan(shipped_plan("strip"), start.n_cars).ticks[0])
    worlds = vector_env(task, 1, "grid")
    worlds.reset(seed=0)
    worlds.step(np.full((1, start.n_cars), int(Action.STOP)))


gc.disable()
for name in NAMES:
    with suppress(ImportError):  # of an extra
        import_module(name)
_load()
# To look for garbage among all of that would copy its memory into each process.
gc.freeze()
gc.enable()
