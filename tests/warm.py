"""What the process that tests copy does at its start: it imports, and loads compiled code, so that no copy has to."""

import gc
import pkgutil
from contextlib import suppress
from importlib import import_module

import craftsim

NAMES = (
    *(
        name
        for _, name, _ in pkgutil.walk_packages(craftsim.__path__, "craftsim.")
        if "__main__" not in name
    ),
    # The first is what torch imports when the first optimizer is made.
    *(
        "torch._dynamo",
        "pandas",
        "scipy.stats",
        "matplotlib.figure",
        "matplotlib.backends.backend_svg",
    ),
)


def _load():
    import numpy as np

    from craftsim.checking.setup import Seed, set_up, setup_of
    from craftsim.discrete.files.shipped import shipped_plan
    from craftsim.discrete.kinds import Action
    from craftsim.envs import vector_env
    from craftsim.mjcf.drives import DRIVES
    from craftsim.planning.plan_file import read_plan
    from craftsim.tasks import make_task

    task = make_task("strip")
    start = task.draw(np.random.default_rng(0))
    for drive in DRIVES:
        judge = set_up(start, setup_of("mild", drive=drive), Seed((5,)))
        judge.perform_tick(read_plan(shipped_plan("strip"), start.n_cars).ticks[0])
    worlds = vector_env(task, 1, "grid")
    worlds.reset(seed=0)
    worlds.step(np.full((1, start.n_cars), int(Action.STOP)))

    import bare_drawings
    import numba

    from craftsim.reports import html

    # What numba loads before it compiles the first function.
    numba.njit(lambda values: values.sum() + 1)(np.arange(3))
    bare_drawings.bare(True)
    for name in html._environment().list_templates(extensions=["j2"]):
        html._environment().get_template(name)


gc.disable()
for name in NAMES:
    with suppress(ImportError):  # of an extra
        import_module(name)
_load()
# To look for garbage among all of that would copy its memory into each process.
gc.freeze()
gc.enable()
