"""From a primitive action to the skill that performs it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final

from craftsim.discrete.actions import check_complete
from craftsim.discrete.kinds import MOVE_DIRECTION, Action
from craftsim.errors import InputError
from craftsim.skills.driving import Move, Rotate
from craftsim.skills.folding import Fold, Unfold
from craftsim.skills.lifting import Drop, Lift
from craftsim.skills.skill import Skill, SkillSetup
from craftsim.skills.stopping import Stop

SKILLS: Final[dict[Action, Callable[[SkillSetup], Skill]]] = {
    **{action: partial(Move, direction=direction) for action, direction in MOVE_DIRECTION.items()},
    Action.ROTATE_LEFT: partial(Rotate, quarter=+1),
    Action.ROTATE_RIGHT: partial(Rotate, quarter=-1),
    Action.LIFT: Lift,
    Action.DROP: Drop,
    Action.FOLD: Fold,
    Action.UNFOLD: Unfold,
    Action.STOP: Stop,
}
"""What performs each action; the four diagonal moves are never legal, and no skill performs them."""


check_complete(SKILLS, "skill", "craftsim/skills/library.py")


def make_skill(action: Action, setup: SkillSetup) -> Skill:
    """Return a fresh skill for an action. Raises InputError for one that no skill performs."""
    if action not in SKILLS:
        known = ", ".join(a.name for a in SKILLS)
        raise InputError(f"no skill performs {action.name}; there are skills for {known}")
    return SKILLS[action](setup)
