"""The skill of each primitive action, built in or user-defined; and what happens after a failed try."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final

from craftsim.discrete.actions import ACTIONS, check_complete
from craftsim.discrete.kinds import MOVE_DIRECTION, Action
from craftsim.errors import InputError
from craftsim.skills import skill
from craftsim.skills.mecanum import Triple
from craftsim.skills.outcome import Outcome, Reason
from craftsim.skills.setup import SkillSetup, Terrain
from craftsim.skills.skill import Begin, Skill
from craftsim.workers.modules import MAIN, import_user_module, note, plug_ins

Performer = Begin | type[Skill]
"""What performs an action: a function that sets up the task of a compiled law, or a class of skills in Python."""

BUILT_IN: Final[Mapping[Action, Performer]] = {
    **{
        action: partial(skill.begin_move, direction=direction)
        for action, direction in MOVE_DIRECTION.items()
    },
    Action.ROTATE_LEFT: partial(skill.begin_turn, quarter=+1),
    Action.ROTATE_RIGHT: partial(skill.begin_turn, quarter=-1),
    Action.LIFT: skill.begin_lift,
    Action.DROP: partial(skill.begin_board, target_m=0.0),
    Action.FOLD: partial(skill.begin_hinge, folds=True),
    Action.UNFOLD: partial(skill.begin_hinge, folds=False),
    Action.STOP: skill.begin_stop,
}
"""What performs each of the 15 actions; the four diagonal moves are never legal, and nothing performs them."""
check_complete(BUILT_IN, "skill", "craftsim/skills/library.py")


def begin_of(action: Action) -> Performer:
    """Return the built-in or registered skill of an action. Raises InputError if there is none."""
    performer = BUILT_IN.get(action) or ACTIONS[action].skill
    if performer is None:
        names = ", ".join(a.name for a, spec in ACTIONS.items() if spec.performed)
        raise InputError(f"no skill performs {action.name}; there are skills for {names}")
    return performer


@dataclass(frozen=True)
class OwnSkill:
    """A user-defined skill in place of a built-in one, by its name, as reports and worker processes need it."""

    action: str
    skill: str
    """``module:NAME`` of the class."""
    car: int | None = None
    """Number of its car; None for all cars."""


SkillChoice = Mapping[Any, Any] | Sequence[OwnSkill] | str
"""User-defined skills: a class for each action, ``{Action.LIFT: MyLift}``, for a car ``{0: {Action.LIFT: MyLift}}``, or
``module:NAME`` of such a mapping, or the name that an installed package gives one (group ``craftsim.skills``)."""


def check_cars(user_skills: Sequence[OwnSkill], n_cars: int) -> None:
    """Raise InputError for a user-defined skill of a car that does not exist."""
    for entry in user_skills:
        if entry.car is not None and entry.car >= n_cars:
            raise InputError(
                f"skills: there is no car {entry.car}; there are {n_cars}, counted from 0"
            )


def own_skills(choice: SkillChoice | None) -> tuple[OwnSkill, ...]:
    """Return user-defined skills by name.

    Raises InputError for an unknown action, a class without ``step``, or one that cannot be imported.
    """
    if choice is None:
        return ()
    if isinstance(choice, str):
        installed = {}
        if ":" not in choice:
            installed = plug_ins("skills")
        text = installed.get(choice, choice)
        module, _, name = text.partition(":")
        chosen = None
        if module and name:
            chosen = _imported(text)
        if not isinstance(chosen, Mapping):
            allowed = ", ".join(
                ["module:NAME of a mapping such as {Action.LIFT: MyLift}", *installed]
            )
            raise InputError(f"skills '{choice}': allowed is {allowed}")
        return own_skills(chosen)
    if not isinstance(choice, Mapping):
        return tuple(choice)
    user_skills: list[OwnSkill] = []
    for key, value in choice.items():
        if isinstance(key, Action) and not isinstance(value, Mapping):
            user_skills.append(OwnSkill(key.name, _name_of(key, value)))
        elif type(key) is int and key >= 0 and isinstance(value, Mapping):
            user_skills += [replace(entry, car=key) for entry in own_skills(value)]
        elif isinstance(key, int) and key in tuple(Action):
            raise InputError(
                f"skills: the action {Action(key).name} and the car {int(key)} are one key of a mapping, which keeps "
                "one value; where both are meant, give each car a mapping of its own"
            )
        else:
            raise InputError(f"skills: {key!r} is no action, and no car with a mapping of its own")
    return tuple(user_skills)


def check_known(user_skills: Sequence[OwnSkill]) -> None:
    """Raise InputError for skills whose modules are not imported yet: reading a file must not run code."""
    for entry in user_skills:
        if entry.skill.partition(":")[0] not in sys.modules:
            origin = f"it was made with a user-defined skill, {entry.skill}"
            raise InputError(f"{origin}; give its module with --skills")


def performers(user_skills: Sequence[OwnSkill], n_cars: int) -> list[dict[Action, Performer]]:
    """Return the skill of each action, for each of these cars. Raises InputError for a name that is no skill's."""
    performers_by_car: list[dict[Action, Performer]] = [dict(BUILT_IN) for _ in range(n_cars)]
    # Those for one car come after those for all.
    for entry in sorted(user_skills, key=lambda entry: entry.car is not None):
        kind = _imported(entry.skill)
        action = Action.__members__.get(entry.action, Action.MOVE_FORWARD_LEFT)
        if not ACTIONS[action].performed or not (
            isinstance(kind, type) and issubclass(kind, Skill)
        ):
            raise InputError(
                f"skills: {entry.skill} for {entry.action} is no skill of a known action"
            )
        for car in range(n_cars):
            if entry.car in (None, car):
                performers_by_car[car][action] = kind
    return performers_by_car


def _name_of(action: Action, kind: object) -> str:
    """Return ``module:NAME`` of a class that performs an action."""
    begin_of(action)
    if not (isinstance(kind, type) and issubclass(kind, Skill)):
        raise InputError(f"skills: {kind!r} for {action.name} is no subclass of craftsim.Skill")
    if kind.__abstractmethods__:
        raise InputError(f"the skill {kind.__name__} has no {min(kind.__abstractmethods__)}()")
    name = f"{kind.__module__}:{kind.__qualname__}"
    if "<locals>" in name or _imported(name) is not kind:
        raise InputError(
            f"the skill {kind.__name__} must stand at the top of a module that can be imported"
        )
    if kind.__module__ in MAIN:
        note(kind.__module__)
    return name


def _imported(name: str) -> Any:
    module, _, path = name.partition(":")
    try:
        target: Any = sys.modules.get(module) or import_user_module(module)
        for attribute in path.split("."):
            target = getattr(target, attribute)
    except (ImportError, AttributeError) as error:
        raise InputError(f"skills: cannot import '{name}': {error}") from error
    return target


_Part = tuple[Performer, SkillSetup]
"""A part of a try: what performs it, and with what."""
_UNDO: Final = {Action.LIFT: Action.DROP, Action.FOLD: Action.UNFOLD}
_UNDO.update({undo: action for action, undo in _UNDO.items()})
_TURNS: Final = (Action.ROTATE_LEFT, Action.ROTATE_RIGHT)
_WAYS_BACK: Final = 2
"""Times that a car which recovers sets out to go back, each from where it then believes to be."""
WENT_BACK: Final = "the car went back"
"""End of the outcome of such an action."""
_MAY_PASS: Final = (Reason.BLOCKED, Reason.SLIPPED, Reason.MISALIGNED, Reason.TIMEOUT)
_LEAVES: Final = (*_MAY_PASS, Reason.LOAD_LOST, Reason.TIPPED)
"""What a car goes back after; one that still leans is not driven."""


@dataclass
class Tries:
    """An action of one car, tried once or more often.

    After a failure that may be temporary the car goes back to where a move or a turn began, or undoes what it did with
    board or hinge, and tries again, driving as under or beside something on an uneven floor. One that ``recovers`` also
    goes back after its last try, so that the others, and what decides next, find it in its cell; and at once where its
    load is lost, whose board it lowers there, or where it has leant.
    """

    action: Action
    setup: SkillSetup
    performers: Mapping[Action, Performer]
    home: Triple
    """The middle of the cell, and the heading, in which it began."""
    number: int = 1
    """Number of the present try, from 1."""
    elapsed_s: float = 0.0
    """Duration of the tries that have ended."""
    failed: Outcome | None = None
    """Outcome of the last try, while the car goes back."""
    recovers: bool = False
    """Whether it goes back after its last try."""
    ways_back: int = 0
    """Number of times that it has set out to go back after its last try."""
    next_parts: list[_Part] = field(default_factory=list)
    """What the car does when it has done this."""

    def first(self) -> _Part:
        """Return what the first try begins with.

        To lift what stands beside its cell's middle, the car goes below it, and with it to the middle.
        """
        performer = self.performers[self.action]
        offset = self.setup.terrain.load_offset
        if offset is None or performer is not BUILT_IN[Action.LIFT]:
            return performer, self.setup
        slowly = self.setup.carefully()
        x, y, heading = self.home
        below = x + offset[0], y + offset[1], heading + offset[2]
        raises = partial(
            skill.begin_board, target_m=self.setup.machine.board_travel_m, needs_load=True
        )
        self.next_parts = [(raises, slowly), (partial(skill.begin_pose, target=self.home), slowly)]
        return partial(skill.begin_pose, target=below), slowly

    def next(self, outcome: Outcome) -> _Part | None:
        """Process an outcome, and return what comes next; None if the action is over."""
        self.elapsed_s += outcome.duration_s
        if outcome.succeeded and self.next_parts:
            return self.next_parts.pop(0)
        self.next_parts.clear()
        if self.failed is not None:
            return self._after_way_back(outcome)
        nothing_felt = self.action is Action.LIFT and outcome.reason is Reason.LOAD_LOST
        if outcome.reason not in _LEAVES:
            return None
        may_pass = outcome.reason in _MAY_PASS or nothing_felt
        # What stood beside the middle stands elsewhere now.
        may_pass = may_pass and self.setup.terrain.load_offset is None
        if not may_pass or self.number >= self.setup.gains.recovery.tries:
            self.failed = outcome
            return self._leave()
        back = self._back()
        if back is not None:
            self.failed = outcome
        return back

    def _after_way_back(self, outcome: Outcome) -> _Part | None:
        if not outcome.succeeded:
            if outcome.reason not in _MAY_PASS:
                return None
            return self._leave()
        if self.ways_back:
            return None
        self.failed = None
        self.number += 1
        ground = replace(self.setup.terrain, tight=True)
        return self.performers[self.action], self.setup.on(ground).carefully()

    def outcome(self, last: Outcome) -> Outcome:
        """Return the outcome of all tries, of which ``last`` ended last."""
        outcome = self.failed or last
        detail = outcome.detail
        if self.ways_back:
            end = WENT_BACK if last.succeeded else "the car could not go back"
            detail = f"{detail}; {end}"
        return replace(outcome, duration_s=self.elapsed_s, detail=detail, tries=self.number)

    def stopped(self, last: Outcome) -> Outcome:
        """Return the outcome of an action that is stopped from outside: why, and what had failed before."""
        detail = last.detail
        if self.failed is not None:
            detail = "; ".join(filter(None, (detail, f"after {self.failed}")))
        duration_s = self.elapsed_s + last.duration_s
        return replace(last, duration_s=duration_s, detail=detail, tries=self.number)

    def _leave(self) -> _Part | None:
        """Return how the car goes back for good; None where it does not, or has tried often enough."""
        if not self.recovers or self.ways_back == _WAYS_BACK:
            return None
        self.ways_back += 1
        back = self._back()
        in_motion = self.action in MOVE_DIRECTION or self.action in _TURNS
        if in_motion and self.failed is not None and self.failed.reason is Reason.LOAD_LOST:
            self.next_parts = [(self.performers[Action.DROP], self.setup)]
        return back

    def _back(self) -> _Part | None:
        if self.action in _UNDO:
            if self.setup.terrain.load_offset is not None:
                home = partial(skill.begin_pose, target=self.home)
                self.next_parts = [(home, self.setup.carefully())]
            return self.performers[_UNDO[self.action]], self.setup
        ground = self.setup.terrain
        setup = self.setup.on(Terrain(ground.end_rad, ground.start_rad, tight=True)).carefully()
        if self.action in _TURNS:
            # A path of a few millimetres that turns by a quarter is led by its turn.
            return partial(skill.begin_turn, quarter=0, target=self.home), setup
        if self.action not in MOVE_DIRECTION:
            return None
        direction = (MOVE_DIRECTION[self.action] + 2) % 4
        return partial(skill.begin_move, direction=direction, target=self.home), setup
