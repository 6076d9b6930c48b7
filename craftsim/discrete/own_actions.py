"""Registered actions on grids: legality and effects are a user's functions in Python, beside the compiled rules."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import Grid
from craftsim.discrete.grid_checks import check_values
from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.kernel.state import DERIVED_MARKS
from craftsim.discrete.kinds import Action
from craftsim.errors import InputError

_NOT_PUBLISHED: Final = "the published rules know no other actions than CraftEnv's"


def is_own(action: int) -> bool:
    """Return whether an action is a registered one."""
    return N_ACTIONS <= action < len(ACTIONS)


def as_own(actions: Any) -> tuple[Action, ...]:
    """Return registered actions that are given by themselves or by their names, in this order.

    Raises InputError for what is none, and for one that stands twice.
    """
    if isinstance(actions, str) or not isinstance(actions, tuple | list):
        raise InputError(f"actions is {actions!r}; allowed: a sequence of registered actions, or their names")
    own = {action.name: action for action in ACTIONS if is_own(action)}
    found: list[Action] = []
    for name in (str(getattr(one, "name", one)) for one in actions):
        if name not in own:
            known = ", ".join(own)
            there = f"there are {known}" if own else "none is registered; import the module that does"
            raise InputError(f"no registered action '{name}'; {there}")
        if own[name] in found:
            raise InputError(f"the action '{name}' stands twice; allowed: once")
        found.append(own[name])
    return tuple(found)


def why(grid: Grid, corrections: int, car: int, action: int) -> str:
    """Return why a registered action is forbidden, in words; empty if it is legal."""
    if not corrections & DERIVED_MARKS:
        return _NOT_PUBLISHED
    spec = ACTIONS[Action(action)]
    assert spec.legality is not None
    reason = spec.legality(grid, car)
    if reason is not None and not isinstance(reason, str):
        raise InputError(f"{spec.verb}: legal(grid, car) returned {reason!r}; it must return a text or None")
    return reason or ""


def carry_out(grid: Grid, car: int, action: int) -> None:
    """Change a grid as a registered action does. Raises InputError where that leaves no grid world."""
    spec = ACTIONS[Action(action)]
    assert spec.effect is not None
    result: object = spec.effect(grid, car)
    if result is not None:
        raise InputError(
            f"{spec.verb}: effect(grid, car) must change the grid and return None, not {result!r}"
        )
    grid.occupant[:], grid.landing[:] = (
        -1,
        0,
    )  # they are derived below, of a world that compiled code can look at
    try:
        check_values(grid)
    except InputError as error:
        raise InputError(f"{spec.verb}: after effect(grid, {car}) {error}") from error
    grid.derive_marks()


def act(grid: Grid, corrections: int, car: int, action: int) -> bool:
    """Carry out a registered action if it is legal now; return whether it was."""
    if why(grid, corrections, car, action):
        return False
    carry_out(grid, car, action)
    return True


def add_columns(
    mask: NDArray[np.bool_], grids: Grid, corrections: int, own: tuple[Action, ...]
) -> NDArray[np.bool_]:
    """Return the masks (B, n, 15) of a batch with a further column for each of some registered actions."""
    columns = np.array(
        [
            [[not why(grid, corrections, car, action) for action in own] for car in range(grids.n_cars)]
            for grid in (grids[i] for i in range(len(grids)))
        ],
        np.bool_,
    ).reshape(*mask.shape[:2], len(own))
    return np.concatenate([mask, columns], axis=-1)
