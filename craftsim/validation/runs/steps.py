"""The steps in which the ticks of a plan are carried out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from craftsim.checking.recipe import Step
from craftsim.discrete.actions import Action

PlanOrder = Literal["sequential", "ticks", "concurrent"]
"""How a plan is carried out: one action after the other; tick after tick, all cars of one at the same time; or each
action as early as those that it depends on have ended."""


def steps_of(ticks: Sequence[Sequence[tuple[int, Action]]], order: PlanOrder) -> tuple[Step, ...]:
    """Return the steps of a plan's ticks, each (car, action) in acting order."""
    if order == "concurrent":
        return (Step.joint(0, *ticks),)
    numbered = [(tick, joint) for tick, joint in enumerate(ticks) if joint]
    if order == "ticks":
        return tuple(Step.joint(tick, joint) for tick, joint in numbered)
    return tuple(Step.single(tick, *act) for tick, joint in numbered for act in joint)
