"""The result of an episode: a plan, a list of actions or a policy's play in physics, from its start to its end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

from craftsim.checking.attempt import Attempt
from craftsim.checking.checked_site import CheckedSite
from craftsim.checking.recipe import Recipe


@dataclass(frozen=True)
class Ending:
    """How a building that was planned, and planned again, came to its end; made of what JSON knows."""

    ended: str
    """``built``, ``gave up`` or ``not readable``."""
    why: str
    """Why it is not built; empty when it is."""
    replans: int
    """How often it was planned again."""
    planned_s: float
    """Makespan of the first plan by the table of durations."""
    disturbed: str
    """What was done to the world on purpose, in words; empty where nothing was."""


@dataclass(frozen=True)
class Episode:
    """An episode in physics."""

    recipe: Recipe
    """Its start and all its steps: it is re-run bit for bit from this."""
    steps: tuple[tuple[Attempt, ...], ...]
    """The attempts of each step, forbidden ones included."""
    reached: bool | None
    """Whether the goal is reached in physics; None where there is none."""
    reached_by_rules: bool | None
    """Whether the same plan or policy reaches it by the rules alone."""
    end_s: float
    """Simulated time."""
    problems: tuple[str, ...]
    """Why the world at the end cannot be read as a grid; empty when it can."""
    ending: Ending | None = None
    """Where plans were made on the way."""

    @property
    def attempts(self) -> tuple[Attempt, ...]:
        """All attempts."""
        return tuple(attempt for step in self.steps for attempt in step)

    @property
    def forbidden(self) -> tuple[Attempt, ...]:
        """What the rules forbid, and was not tried."""
        return tuple(attempt for attempt in self.attempts if not attempt.legal)

    @property
    def agrees(self) -> bool:
        """Whether all that the rules allow did what they predict, within all limits."""
        return all(attempt.agrees for attempt in self.attempts if attempt.legal)

    @property
    def n_ticks(self) -> int:
        """Ticks that were begun."""
        return 1 + max((attempt.tick for attempt in self.attempts), default=-1)

    @property
    def makespan_s(self) -> float:
        """Simulated time from the start of the first action to the end of the last."""
        performed = [attempt for attempt in self.attempts if attempt.performed]
        ends = max((a.start_s + a.duration_s for a in performed), default=0.0)
        return round(ends - min((a.start_s for a in performed), default=0.0), 6)

    @property
    def first_disagreement(self) -> int | None:
        """The first step in which something allowed did not go as predicted."""
        wrong = (n for n, step in enumerate(self.steps) if any(a.legal and not a.agrees for a in step))
        return next(wrong, None)

    def until(self, step: int) -> Recipe:
        """Return the recipe that ends with a step."""
        return replace(self.recipe, steps=self.recipe.steps[: step + 1])


@dataclass(frozen=True)
class Watch:
    """Who looks on while an episode runs."""

    begin: Callable[[CheckedSite], None] = lambda checked: None
    """Called with the world at its start."""
    on_attempts: Callable[[tuple[Attempt, ...]], None] = lambda attempts: None
    """Called after each step."""


UNWATCHED: Final = Watch()
