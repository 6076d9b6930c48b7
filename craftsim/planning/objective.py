"""What a plan is to be good at, and how long it is looked for."""

from __future__ import annotations

from typing import Final, Literal

Objective = Literal["makespan", "work"]
"""The time until all is done, or the sum of all actions' durations."""

DEFAULT_ROUNDS: Final = 2000
DEFAULT_TIME_S: Final = 10.0
