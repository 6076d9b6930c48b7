"""What the rules alone predict, while physics goes its way: the grid that is drawn beside a film."""

from __future__ import annotations

from bisect import bisect_right

from craftsim.discrete.actions import Action
from craftsim.discrete.grid import Grid
from craftsim.discrete.rules import Rules
from craftsim.rendering.trajectory import Trajectory


class Prediction:
    """The predicted world at each moment of a trajectory; an action counts from its end on."""

    def __init__(self, trajectory: Trajectory) -> None:
        """Apply all that was done, in acting order, to the start."""
        story = trajectory.story
        recipe, attempts = story.recipe, story.attempts
        rules, grid = Rules(recipe.setup.rules), recipe.grid
        acts = [(act, step.intended_grid) for step in recipe.steps for act in step.acts]
        before = len(acts) - len(attempts)  # what was done before the recording
        self._times, self._grids = [float(trajectory.time[0])], [grid]
        for number, (act, intended) in enumerate(acts):
            action = Action[act.action]
            if intended is not None:
                grid = intended
            elif rules.legal(grid, act.car, action):
                grid = rules.apply(grid, act.car, action)
            ended = self._times[-1]
            if number >= before:
                attempt = attempts[number - before]
                ended = max(ended, attempt.start_s + attempt.duration_s)
            self._times.append(ended)
            self._grids.append(grid)

    @property
    def grids(self) -> tuple[Grid, ...]:
        """All that are predicted, in their order; not to be changed."""
        return tuple(self._grids)

    def at(self, time_s: float) -> Grid:
        """Return the world that the rules predict at a simulated time; not to be changed."""
        return self._grids[bisect_right(self._times, time_s) - 1]
