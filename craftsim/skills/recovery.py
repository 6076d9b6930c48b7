"""Second tries: a car whose action failed for a reason that may pass goes back to where it began, and tries again.

What it goes back by: a move or a turn by driving to the pose that it began at, lifting by lowering the board, folding
by unfolding, and the other way round. Back and at the next try it drives as carefully as under or beside something on
an uneven floor.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

from craftsim.discrete.kinds import MOVE_DIRECTION, Action
from craftsim.discrete.readback import nearest_yaw
from craftsim.models.measuring import CarMeasurement
from craftsim.skills.driving import Move, cell_middle
from craftsim.skills.library import make_skill
from craftsim.skills.mecanum import Triple
from craftsim.skills.outcome import Outcome, Reason
from craftsim.skills.skill import Skill, SkillSetup, Terrain

_REVERSE: Final[Mapping[Action, Action]] = {
    Action.LIFT: Action.DROP,
    Action.DROP: Action.LIFT,
    Action.FOLD: Action.UNFOLD,
    Action.UNFOLD: Action.FOLD,
}
_TURNS: Final = (Action.ROTATE_LEFT, Action.ROTATE_RIGHT)
_MAY_PASS: Final = (Reason.BLOCKED, Reason.SLIPPED, Reason.MISALIGNED, Reason.TIMEOUT)


class Return(Move):
    """Drive back to a pose from wherever a move or a turn has failed."""

    def __init__(self, setup: SkillSetup, home: Triple, direction: int) -> None:
        """Prepare to drive to ``home``, (x, y, heading) in the world frame; it lies in the grid direction 0..3."""
        super().__init__(setup, direction)
        self._home = home

    def _target(self, now: CarMeasurement) -> Triple:
        return self._home


@dataclass
class Tries:
    """An action of one car, tried once or more often."""

    action: Action
    setup: SkillSetup
    number: int
    """Of the present try, from 1."""
    home: Triple
    """The middle of the cell, and the heading, in which it began."""
    elapsed_s: float = 0.0
    """In what has ended."""
    failed: Outcome | None = None
    """How the last try ended, while the car goes back."""

    @classmethod
    def begin(cls, action: Action, setup: SkillSetup, now: CarMeasurement) -> tuple[Tries, Skill]:
        """Return the tries of an action from what the car measures, and the skill that begins the first one."""
        yaw, _ = nearest_yaw(now.heading)
        return cls(action, setup, 1, cell_middle(now, yaw)), make_skill(action, setup)

    def next(self, outcome: Outcome) -> Skill | None:
        """Take in how a skill ended, and return what comes next; None where it is over."""
        self.elapsed_s += outcome.duration_s
        if self.failed is not None:
            if not outcome.succeeded:
                return None
            self.failed, self.number = None, self.number + 1
            ground = replace(self.setup.terrain, tight=True)
            return make_skill(self.action, self.setup.on(ground).carefully())
        nothing_felt = self.action is Action.LIFT and outcome.reason is Reason.LOAD_LOST
        may_pass = outcome.reason in _MAY_PASS or nothing_felt
        if not may_pass or self.number >= self.setup.gains.recovery.tries:
            return None
        back = self._back()
        if back is not None:
            self.failed = outcome
        return back

    def outcome(self, last: Outcome) -> Outcome:
        """Return the outcome of all tries, of which ``last`` ended last."""
        return replace(self.failed or last, duration_s=self.elapsed_s, tries=self.number)

    def _back(self) -> Skill | None:
        """Return the skill that undoes what a failed try may have done; None for an action that has none."""
        if self.action in _REVERSE:
            return make_skill(_REVERSE[self.action], self.setup)
        if self.action not in MOVE_DIRECTION and self.action not in _TURNS:
            return None
        ground = self.setup.terrain
        setup = self.setup.on(Terrain(ground.end_rad, ground.start_rad, tight=True)).carefully()
        return Return(setup, self.home, (MOVE_DIRECTION.get(self.action, 0) + 2) % 4)
