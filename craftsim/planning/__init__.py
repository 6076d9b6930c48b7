"""From a start and a goal to a plan: what goes where in which order, by which car, and every move of it."""

from craftsim.planning.goals import NoPlanError
from craftsim.planning.planner import Planned, plan_building

__all__ = ["NoPlanError", "Planned", "plan_building"]
