"""Ranges of options of the planner.

Help and tab completion import this, so it imports nothing heavy.
"""

from typing import Final

from craftsim.storage.limits import Range

PLAN_ROUNDS: Final = Range(1, 1_000_000)
PLAN_TIME_S: Final = Range(0, 604_800)
