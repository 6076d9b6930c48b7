"""One run, recorded: of a plan, a list of actions or a policy in one world."""

from __future__ import annotations

from pathlib import Path

from craftsim.checking.setup import Setup
from craftsim.errors import InputError
from craftsim.rendering.trajectory import Trajectory
from craftsim.validation.runs.choice import PLANNER, World, items_of, plan_pilot, policy_pilot, subjects_of
from craftsim.validation.runs.run import Terms, record_episode
from craftsim.validation.runs.steps import PlanOrder


def record_once(
    world: World,
    setup: Setup,
    seed: int,
    *,
    plan: Path | None = None,
    policy: str | None = None,
    order: PlanOrder = "concurrent",
) -> Trajectory:
    """Run a plan or a policy in a world once, and return what moved; the shipped plan unless one is given.

    Raises InputError where there is none, and where a file is not as it should be.
    """
    if plan is not None and policy is not None:
        raise InputError("plan and policy exclude each other")
    subjects = subjects_of([world])
    if plan is not None:
        pilot = plan_pilot(plan, subjects[0], order)
    else:
        pilot = policy_pilot(policy or PLANNER, subjects, order, setup.rules)
    (item,) = items_of(subjects, [pilot], 1, Terms(seed, setup))
    return record_episode(item.job).trajectory
