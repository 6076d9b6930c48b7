"""Objectives and default limits of a search for a plan."""

from __future__ import annotations

from typing import Final, Literal

Objective = Literal["makespan", "work"]
"""Quantity to minimize: the makespan, or the sum of all actions' durations."""
DEFAULT_ROUNDS: Final = 2000
"""Default number of attempts at a plan."""
FIRST_PLAN_S: Final = 60.0
"""Default time in which a first plan must be found."""
BETTER_PLAN_S: Final = 10.0
"""Default time after which a plan is not improved any more."""
