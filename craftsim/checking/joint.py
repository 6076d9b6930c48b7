"""One tick of many cars in physics: all act at once where their actions allow it, and the world is read after it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from craftsim.checking.scheduled_run import run_schedule
from craftsim.discrete.actions import Action
from craftsim.discrete.grid import Grid
from craftsim.discrete.readback import Reading, read_grid
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Order, make_schedule
from craftsim.discrete.verdict import Verdict
from craftsim.models.sensing import read_poses
from craftsim.models.site import Site
from craftsim.skills.executor import Executor
from craftsim.skills.outcome import Outcome


@dataclass(frozen=True)
class CarStep:
    """What one car was told in a tick, and what came of it."""

    car: int
    action: Action
    legal: bool
    """Whether the rules allow it when the car's turn comes; what they forbid is not performed."""
    outcome: Outcome | None
    """What the skill says; None where it never started: forbidden, or what it waits for has failed."""
    in_place: bool
    """Whether the car, and every cell that the action changes, read as predicted when it ended."""
    difference: str
    """What read otherwise, in words."""

    @property
    def applied(self) -> bool:
        """Whether the action was performed and did what the rules predict."""
        return self.in_place and self.outcome is not None and self.outcome.succeeded


@dataclass(frozen=True)
class JointStep:
    """One tick of many cars in physics."""

    cars: tuple[CarStep, ...]
    """In the order in which the cars were given."""
    predicted: Grid
    """The world that the rules predict from the reading before the tick."""
    reading: Reading
    """What was read after it."""
    verdict: Verdict
    """The reading against the prediction."""
    duration_s: float
    """Simulated time from the first start to the last end."""


class JointSite:
    """A Site on which ticks of many cars are run; each is predicted from what was read last."""

    def __init__(self, site: Site, rules: Rules, executor: Executor) -> None:
        """Read the start from poses."""
        self.site, self.rules, self.executor = site, rules, executor
        self.reading = read_grid(read_poses(site), site.size, site.walls)

    @property
    def grid(self) -> Grid:
        """The world as it was read last."""
        return self.reading.grid

    def step(self, joint: Sequence[tuple[int, Action]], order: Order = "concurrent") -> JointStep:
        """Run one tick and return what came of it; :attr:`reading` is then the world after it.

        Args:
            joint: (car, action), each car at most once, in the order in which the rules let them act.
            order: which of them may run at the same time.
        """
        schedule = make_schedule(self.grid, [joint], self.rules, order)
        run = run_schedule(self.executor, schedule)
        self.reading = run.final
        records = {schedule.steps[record.index].car: record for record in run.records}
        forbidden = {car for _, car, _ in schedule.forbidden}
        cars = []
        for car, action in joint:
            record = records.get(car)
            cars.append(
                CarStep(
                    car=car,
                    action=action,
                    legal=car not in forbidden,
                    outcome=None if record is None else record.outcome,
                    in_place=record is not None and record.in_place,
                    difference="" if record is None else record.difference,
                )
            )
        return JointStep(tuple(cars), schedule.final, run.final, run.verdict, run.makespan_s)
