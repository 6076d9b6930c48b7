from .planned import NoPlanError, Planned
from .planner import plan_building

__all__ = ["NoPlanError", "Planned", "plan_building"]
