"""What a replay bundle shows as a trajectory: its last step, simulated again."""

from __future__ import annotations

from craftsim.checking.recipe import do, start
from craftsim.checking.timekeeper import Timekeeper
from craftsim.rendering.recorder import Recorder
from craftsim.rendering.trajectory import Trajectory
from craftsim.validation.replays.bundle import TEXT, Recorded


def trajectory_of(recorded: Recorded) -> Trajectory:
    """Return what happens in the last step of a bundle.

    Raises InputError for a recipe that makes no world, or takes longer than the bundle says.
    """
    bundle, recorder = recorded.bundle, Recorder()
    checked = start(bundle.recipe)
    what = f"{recorded.folder / TEXT}: the recipe, which end_s says takes {bundle.end_s:.4g} s,"
    Timekeeper(checked, bundle.most_s, what)
    for step in bundle.recipe.steps[:-1]:
        do(checked, step)
    recorder.begin(checked)
    attempts = do(checked, bundle.recipe.steps[-1])
    return recorder.trajectory(bundle.key, bundle.recipe, attempts)
