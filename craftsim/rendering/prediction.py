"""What the rules alone predict, while physics goes its way: the grid that is drawn beside a film."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate

from craftsim.checking.episode import Act
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.rendering.trajectory import Trajectory


class Prediction:
    """The predicted world at each moment of a trajectory; an action counts from its end on."""

    def __init__(self, trajectory: Trajectory) -> None:
        """Apply all that was done to the start, in the order in which it ended where that leads to the same world."""
        story = trajectory.story
        recipe, attempts = story.recipe, story.attempts
        acts = [(act, step.intended_grid) for step in recipe.steps for act in step.acts]
        before = len(acts) - len(attempts)  # what was done before the recording
        begun = float(trajectory.time[0])
        ends = [begun] * before + [attempt.start_s + attempt.duration_s for attempt in attempts]
        rules = Rules(recipe.setup.rules)
        in_order = _worlds(recipe.grid, acts, rules)
        by_end = sorted(range(len(acts)), key=ends.__getitem__)
        as_they_end = _worlds(recipe.grid, [acts[i] for i in by_end], rules)
        if not as_they_end[-1].same_visible(in_order[-1]):
            # Some of them depend on each other: then each waits for those that act before it.
            as_they_end, by_end = in_order, list(range(len(acts)))
            ends = list(accumulate(ends, max))
        self._times = [begun, *(ends[i] for i in by_end)]
        self._grids = as_they_end

    @property
    def grids(self) -> tuple[Grid, ...]:
        """All that are predicted, in their order; not to be changed."""
        return tuple(self._grids)

    def at(self, time_s: float) -> Grid:
        """Return the world that the rules predict at a simulated time; not to be changed."""
        return self._grids[bisect_right(self._times, time_s) - 1]


def _worlds(start: Grid, acts: Sequence[tuple[Act, Grid | None]], rules: Rules) -> list[Grid]:
    """Return a start, and what follows from each action, or what it was intended to lead to."""
    grids = [start]
    for act, intended in acts:
        grid, action = grids[-1], Action[act.action]
        if intended is not None:
            grid = intended
        elif rules.legal(grid, act.car, action):
            grid = rules.apply(grid, act.car, action)
        grids.append(grid)
    return grids
