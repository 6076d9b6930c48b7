"""The steps in which the ticks of a plan are carried out."""

from __future__ import annotations

from collections.abc import Sequence

from craftsim.checking.episode import Step
from craftsim.choices import PlanOrder as PlanOrder
from craftsim.discrete.kinds import Action
from craftsim.discrete.schedule import Constraints


def steps_of(
    ticks: Sequence[Sequence[tuple[int, Action]]], order: PlanOrder, after: Constraints | None = None
) -> tuple[Step, ...]:
    """Return the steps of a plan's ticks, each (car, action) in acting order, with its order constraints."""
    after = after or {}
    if order == "concurrent":
        return (Step.joint(0, *ticks, after=after),)
    numbered = [(tick, joint) for tick, joint in enumerate(ticks) if joint]
    if order == "ticks":
        return tuple(Step.joint(tick, joint, after=_within(after, tick, joint)) for tick, joint in numbered)
    return tuple(Step.single(tick, *act) for tick, joint in numbered for act in joint)


def _within(after: Constraints, tick: int, joint: Sequence[tuple[int, Action]]) -> Constraints:
    """Return the order constraints between the actions of one tick, as those of tick 0; others hold anyway."""
    return {
        (0, car): [(0, other) for at, other in after.get((tick, car), ()) if at == tick] for car, _ in joint
    }
