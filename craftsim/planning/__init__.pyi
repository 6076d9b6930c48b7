from .goals import NoPlanError
from .planned import Planned
from .planner import plan_building

__all__ = ["NoPlanError", "Planned", "plan_building"]
