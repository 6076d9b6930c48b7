"""From a primitive action to the skill that performs it, built in or one's own; and its second tries."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

from craftsim.discrete.actions import ACTIONS, check_complete
from craftsim.discrete.kinds import MOVE_DIRECTION, Action
from craftsim.errors import InputError
from craftsim.modules import import_own
from craftsim.skills.mecanum import Triple
from craftsim.skills.outcome import Outcome, Reason
from craftsim.skills.skill import (
    Begin,
    Skill,
    SkillSetup,
    Terrain,
    begin_board,
    begin_hinge,
    begin_lift,
    begin_move,
    begin_stop,
    begin_turn,
)

Performer = Begin | type[Skill]
"""What performs an action: a function that sets up the task of a compiled law, or a class of skills in Python."""

BUILT_IN: Final[Mapping[Action, Performer]] = {
    **{action: partial(begin_move, direction=direction) for action, direction in MOVE_DIRECTION.items()},
    Action.ROTATE_LEFT: partial(begin_turn, quarter=+1),
    Action.ROTATE_RIGHT: partial(begin_turn, quarter=-1),
    Action.LIFT: begin_lift,
    Action.DROP: partial(begin_board, target_m=0.0),
    Action.FOLD: partial(begin_hinge, folds=True),
    Action.UNFOLD: partial(begin_hinge, folds=False),
    Action.STOP: begin_stop,
}
"""What performs each of the 15 actions; the four diagonal moves are never legal, and no skill performs them."""


check_complete(SKILLS, "skill", "craftsim/skills/library.py")


def make_skill(action: Action, setup: SkillSetup) -> Skill:
    """Return a fresh skill for an action. Raises InputError for one that no skill performs."""
    make = SKILLS.get(action) or ACTIONS[action].skill
    if make is None:
        known = ", ".join(a.name for a, spec in ACTIONS.items() if spec.performed)
        raise InputError(f"no skill performs {action.name}; there are skills for {known}")
    skill = make(setup)
    if not isinstance(skill, Skill):
        raise InputError(f"{action.name}: skill(setup) returned {skill!r}; it must return a Skill")
    return skill
