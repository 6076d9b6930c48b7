"""The actions chosen for cars: checked before a tick, and judged after it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kinds import Action
from craftsim.errors import InputError


def by_agent(actions: Mapping[str, Any], agents: Sequence[str]) -> list[Any]:
    """Return the actions of agents in their order; raise InputError where one has none."""
    missing = [agent for agent in agents if agent not in actions]
    if missing:
        raise InputError(
            f"no action for {', '.join(missing)}; actions must be a dictionary with one for each agent"
        )
    return [actions[agent] for agent in agents]


def checked(actions: Any, shape: tuple[int, ...], n_actions: int = len(Action)) -> NDArray[np.int64]:
    """Return actions as integers of this shape, whose last dimension is the cars.

    Raises InputError for another shape, and for anything but whole numbers from 0 to ``n_actions`` - 1.
    """
    try:
        chosen = np.asarray(actions)
    except ValueError as error:  # rows of different lengths
        raise InputError(f"actions must have shape {shape}, not {actions}") from error
    if chosen.shape != shape:
        raise InputError(f"actions must have shape {shape}, not {chosen.shape}")
    if chosen.dtype.kind not in "iu" or (chosen < 0).any() or (chosen >= n_actions).any():
        raise InputError(f"actions must be whole numbers from 0 to {n_actions - 1}, not {actions}")
    return chosen.astype(np.int64)


def numbers_of(
    chosen: NDArray[np.int64], own: Sequence[Action], queued: NDArray[np.bool_] | None
) -> NDArray[np.int64]:
    """Return the numbers of actions that are chosen as columns of masks, registered ones in this order last.

    What a car is asked for while it goes on with what the helper has queued is STOP: it is not done.
    """
    if not own:
        return chosen
    numbers = np.array([*Action, *own], np.int64)[chosen]
    return numbers if queued is None else np.where(queued, int(Action.STOP), numbers)


def illegal(
    chosen: NDArray[np.int64],
    applied: NDArray[np.bool_],
    offered: NDArray[np.integer],
    queued: NDArray[np.bool_] | None,
) -> NDArray[np.bool_]:
    """Return (..., n): which cars had a forbidden action chosen, and therefore did nothing.

    Args:
        chosen: (..., n) the actions, as columns of the masks.
        applied: (..., n) whether the rules allowed each when the car's turn came.
        offered: (..., n, 15) the masks before the tick.
        queued: (..., n) which cars went on with what the action helper had queued; None without the helper.
    """
    forbidden = ~applied
    if queued is not None:
        # A helper that finds no way makes a STOP of a move, which is legal but not what was asked for.
        unoffered = np.take_along_axis(offered, chosen[..., None], -1)[..., 0] == 0
        forbidden |= unoffered & ~queued
    wrong: NDArray[np.bool_] = forbidden & (chosen != Action.STOP)
    return wrong
