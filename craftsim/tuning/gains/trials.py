"""Trying a candidate's gains: the same situations, physics and noise for all candidates (common random numbers)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Annotated, Final

import numpy as np
from pydantic import Field

from craftsim.audit.survey import situation_of
from craftsim.checking.attempt import BOUNDED_ERRORS, Attempt, Thresholds
from craftsim.checking.setup import Seed, Setup, compile_world, set_up
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.errors import CraftsimError, StartError
from craftsim.experiments.experiment import Done
from craftsim.experiments.schema import STRICT, Form
from craftsim.models.world import PhysicsWorld
from craftsim.tuning.gains.knobs import Subject
from craftsim.tuning.gains.situations import situations

WORST: Final = 10.0
"""Share of a limit beyond which an error counts no more, nor one that is no number."""
WORLDS_KEPT: Final = 96
"""Compiled worlds that a process keeps for the next candidate: 1 MB each."""


@dataclass(frozen=True)
class TriedAction:
    """What one action showed; shares are of the limits (:class:`~craftsim.checking.setup.Thresholds`)."""

    __pydantic_config__ = STRICT
    situation: str
    """Its properties as text."""
    block: Annotated[int, Field(ge=0)]
    agrees: bool
    """Whether it did what the rules predict, within all limits, and nothing else."""
    duration_s: float
    error_share: float
    """The largest error, at the end, of the car and of what it sets down."""
    used_share: float
    """The same, or the displacement of a bystander, if that is more."""
    energy_j: float
    """Work of all wheel, board and hinge motors: the integral of ``|torque * speed|``, sampled each control period."""
    peak_force_n: float
    """Between any two machines, the ground included."""


@dataclass(frozen=True)
class _Extra:
    """What else the record of a candidate holds."""

    __pydantic_config__ = STRICT
    gains: dict[str, float]
    """The tuned ones, by name."""


FORM: Final = Form(TriedAction, _Extra)


@dataclass(frozen=True)
class Job:
    """A candidate to be tried."""

    subject: Subject
    setup: Setup
    """With its gains."""
    values: tuple[tuple[str, float], ...]
    """Those of them that are tuned, by name."""
    seed: int
    blocks: tuple[int, ...]
    """Each is one trial of every situation: its own place on the map, physics and noise."""


def try_gains(job: Job) -> Done:
    """Try a candidate in every situation of its blocks.

    Left out, for all candidates alike, are worlds that cannot be as they were drawn.
    """
    wanted = product(job.blocks, range(len(situations(job.subject))))
    trials = [trial for block, number in wanted if (trial := _try(job, block, number))]
    if not trials:
        raise CraftsimError("none of the worlds that were drawn can be")
    return Done(all(trial.agrees for trial in trials), trials, extra={"gains": dict(job.values)})


def _try(job: Job, block: int, number: int) -> TriedAction | None:
    setup = job.setup
    world, grid, action = _world(job.subject, number, job.seed, block, replace(setup, gains=Setup().gains))
    try:
        judge = set_up(grid, setup, Seed((job.seed, block, number)), reuse=world)
    except StartError:
        return None
    meter = _Meter(judge.physics)
    judge.executor.observers.append(meter.note)
    attempt = judge.perform(0, action)
    own, all_of_it = shares(attempt, setup.thresholds)
    return TriedAction(
        str(situations(job.subject)[number]),
        block,
        attempt.agrees,
        attempt.duration_s,
        own,
        all_of_it,
        meter.work_j,
        attempt.peak_force_n,
    )


@lru_cache(maxsize=WORLDS_KEPT)
def _world(
    subject: Subject, number: int, seed: int, block: int, setup: Setup
) -> tuple[PhysicsWorld, Grid, Action]:
    """Return the compiled world of a situation, its grid, and the action; gains have no part in it."""
    situation = situation_of(situations(subject)[number], setup.rules, forbidden=True)
    placed = situation.placed(np.random.default_rng([seed, block, number]))
    return compile_world(placed.grid, setup), placed.grid, placed.acts[0]


def shares(attempt: Attempt, limits: Thresholds) -> tuple[float, float]:
    """Return the largest share of a limit that an action's own errors took, and that they or a bystander took."""
    own, of_it_all = (
        _worst(
            (getattr(attempt, measure.field) or 0.0, getattr(limits, measure.limit))
            for measure in BOUNDED_ERRORS
            if of_bystanders or not measure.of_bystanders
        )
        for of_bystanders in (False, True)
    )
    return own, of_it_all


def _worst(measured: Iterable[tuple[float, float]]) -> float:
    found = [value / limit for value, limit in measured]
    return max(min(share, WORST) if math.isfinite(share) else WORST for share in found)


class _Meter:
    """Adds up the work of the motors of a PhysicsWorld."""

    def __init__(self, physics: PhysicsWorld) -> None:
        motors = [int(motor) for car in physics.cars for motor in car.wheel_actuators]
        motors += [car.board.actuator for car in physics.cars] + [
            slope.hinge.actuator for slope in physics.slopes
        ]
        self._motors = np.array(motors, np.intp)
        self._period_s = physics.config.control_period_s
        self.work_j = 0.0

    def note(self, physics: PhysicsWorld) -> None:
        """Add the work of a control period."""
        force, speed = physics.data.actuator_force[self._motors], physics.data.actuator_velocity[self._motors]
        self.work_j += float(np.abs(force * speed).sum()) * self._period_s
