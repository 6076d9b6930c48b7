"""From a primitive action to the skill that performs it."""

from __future__ import annotations

from craftsim.discrete.actions import MOVE_DIRECTION, Action
from craftsim.discrete.errors import InputError
from craftsim.skills.driving import Move, Rotate, Terrain
from craftsim.skills.folding import Fold, Unfold
from craftsim.skills.gains import Gains
from craftsim.skills.lifting import Drop, Lift
from craftsim.skills.skill import Skill
from craftsim.skills.stopping import Stop


def make_skill(action: Action, gains: Gains, period_s: float, terrain: Terrain | None = None) -> Skill:
    """Return a fresh skill for an action, for a control period in seconds; ``terrain`` is the ground of a move.

    Raises InputError for the four diagonal moves: the rules never allow them, and no skill performs them.
    """
    if action in MOVE_DIRECTION:
        return Move(period_s, gains.drive, MOVE_DIRECTION[action], terrain or Terrain())
    match action:
        case Action.LIFT:
            return Lift(period_s, gains.board)
        case Action.DROP:
            return Drop(period_s, gains.board)
        case Action.FOLD:
            return Fold(period_s, gains.hinge)
        case Action.UNFOLD:
            return Unfold(period_s, gains.hinge)
        case Action.ROTATE_LEFT:
            return Rotate(period_s, gains.drive, +1)
        case Action.ROTATE_RIGHT:
            return Rotate(period_s, gains.drive, -1)
        case Action.STOP:
            return Stop(period_s)
    raise InputError(f"no skill performs {action.name}: diagonal moves are never legal")
