"""Runs that are recorded, for tests of films, figures and views."""

from craftsim import Action, Grid, Trajectory
from craftsim.checking.recipe import Recipe, Step, perform_step, start
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.rendering.trajectory import Recorder


def record(grid: Grid, *actions: Action, title: str = "a run", rest: int = 0) -> Trajectory:
    """Let car 0 act, one action a tick, and then rest for so many control periods."""
    steps = tuple(Step.single(tick, 0, action) for tick, action in enumerate(actions))
    recipe, recorder = Recipe(blueprint_text(grid), steps), Recorder()
    judge = start(recipe)
    recorder.begin(judge)
    attempts = [attempt for step in steps for attempt in perform_step(judge, step)]
    for _ in range(rest):
        judge.executor.advance()
    return recorder.trajectory(title, recipe, attempts)
