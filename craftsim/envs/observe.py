"""Observations of one's own, in place of the rows of all entities."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from gymnasium import spaces

from craftsim.discrete.grid import Grid


@dataclass(frozen=True)
class Observe:
    """What each car observes: the PettingZoo forms' ``observation``; the action mask stays beside it."""

    space: spaces.Space[Any]
    """Of one car's observation."""
    of: Callable[[Grid, int], Any]
    """Returns the observation of a car, given by number, in the world as it is seen."""
