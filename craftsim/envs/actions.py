"""The action form: the actions that are offered as columns of masks, what they stand for, and which were forbidden."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from craftsim.discrete.kinds import Action
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.errors import InputError

Masks = NDArray[np.int8]
"""(B, n, n_actions): 1 for each action that a car is offered."""


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


class ActionForm:
    """The 15 primitive actions, and after them registered ones, for a batch of worlds."""

    def __init__(self, own: Sequence[Action] = ()) -> None:
        """Offer the registered actions ``own`` in this order."""
        self.own = tuple(own)
        self.n_actions = len(Action) + len(self.own)
        """How many an agent chooses from."""
        self._numbers = np.array([*Action, *self.own], np.int64) if self.own else None
        """The number of the action of each column, unless it is the same."""

    def masks(self, episodes: Episodes) -> Masks:
        """Return the offered actions; STOP, which does nothing, where the rules leave a car nothing."""
        return episodes.offered().view(np.int8)

    def begin(
        self, episodes: Episodes, chosen: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_] | None]:
        """Return the numbers of chosen actions (B, n), and which cars go on with the queue of the action helper.

        The latter is None without the helper. Whatever such a car is asked for is not done: it counts as STOP.
        """
        queued = None if episodes.depth is None else episodes.queue[:, :, 0] >= 0
        if self._numbers is None:
            return chosen, queued
        numbers = self._numbers[chosen]
        return (numbers if queued is None else np.where(queued, int(Action.STOP), numbers)), queued

    def spaces(self) -> dict[str, spaces.Space[Any]]:
        """Return the spaces of what a car observes, by key, to choose its actions by."""
        return {}

    def observed(self, episodes: Episodes) -> dict[str, NDArray[Any]]:
        """Return what cars observe to choose their actions by, each (B, n, ...), after :meth:`masks`."""
        return {}


def illegal(
    chosen: NDArray[np.int64],
    applied: NDArray[np.bool_],
    offered: Masks,
    queued: NDArray[np.bool_] | None,
) -> NDArray[np.bool_]:
    """Return (B, n): which cars had a forbidden action chosen, and therefore did nothing.

    Args:
        chosen: (B, n) the actions, as columns of the masks.
        applied: (B, n) whether the rules allowed each when the car's turn came.
        offered: the masks before the tick.
        queued: (B, n) which cars went on with the queue of the action helper; None without it.
    """
    forbidden = ~applied
    if queued is not None:
        # A helper that finds no way makes a STOP of a move, which is legal but not what was asked for.
        unoffered = np.take_along_axis(offered, chosen[..., None], -1)[..., 0] == 0
        forbidden |= unoffered & ~queued
    wrong: NDArray[np.bool_] = forbidden & (chosen != Action.STOP)
    return wrong
