"""What every backend returns: the result of a tick, and of actions that end one by one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import Grid

if TYPE_CHECKING:
    from craftsim.checking.attempt import Attempt


@dataclass(frozen=True)
class Tick:
    """The result of a tick."""

    applied: NDArray[
        np.bool_
    ]  # (n,): by car, whether the rules allowed its action when its turn came
    duration_s: float  # simulated time
    durations_s: tuple[float, ...]  # by car: how long its action took
    problems: tuple[
        str, ...
    ] = ()  # why the world cannot be read as a grid any more; empty when it can
    attempts: tuple[Attempt | None, ...] = ()  # by car: the judge's finding; empty on the grid
    contacts: tuple[Any, ...] | None = None  # what touched what; None where that is not logged


@dataclass(frozen=True)
class Ended:
    """The actions that end next in an asynchronous world; not a :class:`Tick`, because others still run."""

    time_s: float  # simulated time since the world was set up
    confirmed: Grid  # what is so: without what actions have changed that still run
    failed: Mapping[
        int, bool
    ]  # by car whose action has ended: without effect? Empty where the time came first
    problems: tuple[str, ...] = ()  # as of a tick
    lost: Mapping[int, str] = field(
        default_factory=dict
    )  # by car: why it cannot be driven any more
    attempts: Mapping[int, Attempt] = field(
        default_factory=dict
    )  # by car whose action has ended, in physics
    contacts: tuple[Any, ...] | None = None  # of these cars and what they handled; None: not logged
