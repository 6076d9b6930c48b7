"""The table of actions: one row each, with all that makes an action in the grid world. docs/extending.md adds one.

What is missing is refused when this module is loaded. The skills that perform actions stand in
``craftsim/skills/library.py`` and their nominal durations in ``craftsim/data/durations.yaml``; both are checked against
this table in turn.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from craftsim.discrete import footprint as space
from craftsim.discrete.footprint import Footprint
from craftsim.discrete.grid import Grid
from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.state import Pose, World, pose_of
from craftsim.discrete.kinds import MOVE_DIRECTION, Action
from craftsim.discrete.rules import reasons
from craftsim.discrete.rules.effects import drop, fold, lift, move, rotate, unfold
from craftsim.discrete.rules.legality import (
    FIRST_MOVE,
    LAST_MOVE,
    drop_legal,
    fold_legal,
    lift_legal,
    move_direction,
    rotate_legal,
    unfold_legal,
)
from craftsim.discrete.rules.moves import move_legal
from craftsim.discrete.rules.reasons import RuleReason


def _number(name: str) -> int:
    """Return the number of an action for the compiled rules; raise RuntimeError if it has none."""
    if name not in Action.__members__:
        raise RuntimeError(f"{name} has no number in craftsim/discrete/kinds.py")
    return int(Action[name])


LIFT = _number("LIFT")
DROP = _number("DROP")
FOLD = _number("FOLD")
UNFOLD = _number("UNFOLD")
ROTATE_LEFT = _number("ROTATE_LEFT")
ROTATE_RIGHT = _number("ROTATE_RIGHT")
STOP = _number("STOP")


@compiled
def legal(w: World, me: int, car: Pose, action: int) -> bool:
    """Return whether car ``me``, were it in the state ``car``, could do a primitive action now."""
    if FIRST_MOVE <= action <= LAST_MOVE:
        return move_legal(w, me, car, move_direction(action))
    if car.slope != 0:
        return False
    if action == STOP:
        return True
    if action == LIFT:
        return lift_legal(w, me, car)
    if action == DROP:
        return drop_legal(w, me, car)
    if action == FOLD:
        return fold_legal(w, me, car)
    if action == UNFOLD:
        return unfold_legal(w, me, car)
    if action == ROTATE_LEFT:
        return rotate_legal(w, me, car, 1)
    if action == ROTATE_RIGHT:
        return rotate_legal(w, me, car, -1)
    return False


@compiled
def apply(w: World, me: int, action: int) -> None:
    """Carry out an action that is legal; the diagonal moves never are, and STOP changes nothing."""
    car = pose_of(w, me)
    if FIRST_MOVE <= action <= LAST_MOVE:
        move(w, me, car, move_direction(action))
    elif action == ROTATE_LEFT:
        rotate(w, me, car, 1)
    elif action == ROTATE_RIGHT:
        rotate(w, me, car, -1)
    elif action == LIFT:
        lift(w, me, car)
    elif action == DROP:
        drop(w, me, car)
    elif action == FOLD:
        fold(w, car)
    elif action == UNFOLD:
        unfold(w, car)


@dataclass(frozen=True)
class Variation:
    """What the audit's contexts vary for an action, beyond the car's level, ground, cell and load."""

    ahead: tuple[int, ...] = ()
    """Directions, relative to the heading, in which the action goes: what is in the next cell there is varied."""
    over: bool = False
    """Whether it matters what is above the own cell or, with ``ahead``, above the next one."""
    beyond: int | None = None
    """Relative direction in which it matters whether a block is in the cell after the next."""


@dataclass(frozen=True)
class ActionSpec:
    """All that makes an action in the grid world; see the table :data:`ACTIONS`."""

    verb: str
    """What it is called whatever the map direction: reports, the audit and its contexts group by it."""
    words: str
    """How captions and logs say it."""
    legal: Any
    """The compiled rule that :func:`legal` asks; None where nothing is asked."""
    effect: Any
    """The compiled effect that :func:`apply` carries out; None where nothing changes."""
    why_not: Callable[[World, int, Pose, int], RuleReason | None]
    """Says why it is forbidden: (world, car's number, its state, action) -> reason, None where it is legal."""
    footprint: Callable[[Grid, Grid, int], Footprint]
    """What it needs beyond what the car needs where it stands: (before, after, car) -> footprint."""
    duration: str
    """Its row in ``craftsim/data/durations.yaml``; empty where no skill performs it."""
    no_goal: Callable[[World, Pose], str] = reasons.always_a_goal
    """Says why there is nothing to try where it is forbidden: (world, the car's state) -> words, else empty."""
    varies: Variation = Variation()
    direction: int | None = None
    """Of a move: the grid yaw in which it goes."""
    performed: bool = True
    """Whether a skill performs it; what no rule ever allows needs none."""


def _move(name: str) -> ActionSpec:
    return ActionSpec(
        *("MOVE", name.replace("_", " ").lower(), move_legal, move),
        *(reasons.why_move, space.of_move, "move"),
        varies=Variation(ahead=(0, 1, 2, 3)),
        direction=MOVE_DIRECTION[Action[name]],
    )


def _diagonal(name: str) -> ActionSpec:
    words = name.replace("_", " ").lower()
    return ActionSpec("MOVE", words, None, None, reasons.why_never, space.of_nothing, "", performed=False)


_ROWS: Final = {
    "LIFT": ActionSpec(
        *("LIFT", "lift", lift_legal, lift, reasons.why_lift, space.of_board, "lift"),
        no_goal=reasons.nothing_to_lift,
        varies=Variation(over=True),
    ),
    "DROP": ActionSpec(
        *("DROP", "drop", drop_legal, drop, reasons.why_drop, space.of_board, "drop"),
        no_goal=reasons.nothing_to_drop,
    ),
    "FOLD": ActionSpec(
        *("FOLD", "fold", fold_legal, fold, reasons.why_fold, space.of_flap, "fold"),
        no_goal=reasons.nothing_to_fold,
        varies=Variation(over=True, beyond=2),
    ),
    "UNFOLD": ActionSpec(
        *("UNFOLD", "unfold", unfold_legal, unfold, reasons.why_unfold, space.of_flap, "unfold"),
        no_goal=reasons.nothing_to_unfold,
        varies=Variation(over=True, beyond=2),
    ),
    "ROTATE_LEFT": ActionSpec(
        *("ROTATE_LEFT", "rotate left", rotate_legal, rotate, reasons.why_rotate, space.of_turn, "rotate")
    ),
    "ROTATE_RIGHT": ActionSpec(
        *("ROTATE_RIGHT", "rotate right", rotate_legal, rotate, reasons.why_rotate, space.of_turn, "rotate")
    ),
    **{name: _move(name) for name in ("MOVE_FORWARD", "MOVE_BACK", "MOVE_LEFT", "MOVE_RIGHT")},
    "STOP": ActionSpec("STOP", "stop", None, None, reasons.why_stop, space.of_nothing, "stop"),
    **{
        name: _diagonal(name)
        for name in ("MOVE_FORWARD_LEFT", "MOVE_FORWARD_RIGHT", "MOVE_BACK_LEFT", "MOVE_BACK_RIGHT")
    },
}


def _checked(rows: Mapping[str, ActionSpec]) -> dict[Action, ActionSpec]:
    """Return the rows by action; raise RuntimeError for what is missing, with the file that it belongs in."""
    here = "craftsim/discrete/rules/table.py"
    for name in rows:
        _number(name)
    for action in Action:
        if action.name not in rows:
            raise RuntimeError(
                f"{action.name} has a number in craftsim/discrete/kinds.py, but no row in {here}"
            )
        spec = rows[action.name]
        for dispatch, part in ((legal, spec.legal), (apply, spec.effect)):
            asked = getattr(dispatch, "py_func", dispatch)
            if part is not None and part.__name__ not in asked.__code__.co_names:
                raise RuntimeError(
                    f"{action.name}: {asked.__name__}() in {here} does not call {part.__name__}()"
                )
    return {action: rows[action.name] for action in Action}


ACTIONS: Final[Mapping[Action, ActionSpec]] = _checked(_ROWS)
"""The table of actions."""

VERBS: Final = tuple(dict.fromkeys(spec.verb for spec in ACTIONS.values()))
"""All verbs, in the order of the actions."""


def check_complete(parts: Mapping[Action, object], what: str, where: str) -> None:
    """Raise RuntimeError, with the action, if one that is performed has no part, or one has a part that is not.

    Args:
        parts: by action.
        what: they are, such as ``skill``.
        where: the file that lists them.
    """
    for action, spec in ACTIONS.items():
        if spec.performed and action not in parts:
            raise RuntimeError(f"{action.name} has no {what} in {where}")
        if not spec.performed and action in parts:
            raise RuntimeError(f"{action.name} has a {what} in {where}, but is never performed")


def footprint(before: Grid, after: Grid, car: int, action: Action) -> Footprint:
    """Return the footprint of a legal action, given the predicted worlds before and after it."""
    ends = space.standing(before, car) | space.standing(after, car)
    return ends | ACTIONS[action].footprint(before, after, car)
