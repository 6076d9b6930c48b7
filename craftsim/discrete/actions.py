"""The table of actions: one row each, with what makes an action beyond its rules. docs/extending.md adds one.

When an action is legal and what it changes stand in ``craftsim/discrete/kernel/rules.py``, the words for why it is
forbidden in ``craftsim/discrete/reasons.py``, the skills that perform actions in ``craftsim/skills/library.py`` and
their nominal durations in ``craftsim/data/durations.yaml``. Skills and durations are checked against this table.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from craftsim.discrete import footprint as space
from craftsim.discrete.footprint import Footprint
from craftsim.discrete.grid import Grid
from craftsim.discrete.kernel.effects import apply
from craftsim.discrete.kernel.rules import why
from craftsim.discrete.kinds import MOVE_DIRECTION, Action, CarField, Kind


def _nothing(grid: Grid, car: int) -> str:
    return ""


@dataclass(frozen=True)
class ActionSpec:
    """What makes an action in the grid world beyond its rules; see the table :data:`ACTIONS`."""

    verb: str
    """What it is called whatever the map direction: reports, the audit and its contexts group by it."""
    words: str
    """How captions and logs say it."""
    footprint: Callable[[Grid, Grid, int], Footprint]
    """What it needs beyond what the car needs where it stands: (before, after, car) -> footprint."""
    duration: str
    """Its row in ``craftsim/data/durations.yaml``; empty where no skill performs it, as no rule ever allows it."""
    nothing_to_try: Callable[[Grid, int], str] = _nothing
    """Says why there is nothing to try where it is forbidden: (grid, car) -> words, empty where there is something."""
    direction: int | None = None
    """Of a move: the grid yaw in which it goes."""
    ahead: tuple[int, ...] = ()
    """Directions, relative to the heading, in which it goes: the audit's contexts vary what is in the next cell there,
    beyond the car's level, ground, cell and load."""
    over: bool = False
    """Whether it matters what is above the own cell or, with ``ahead``, above the next one."""
    beyond: int | None = None
    """Relative direction in which it matters whether a block is in the cell after the next."""

    @property
    def performed(self) -> bool:
        """Whether a skill performs it."""
        return bool(self.duration)


def _own(grid: Grid, car: int) -> Kind:
    x, y, z = grid.cars[car, : CarField.YAW].tolist()
    return grid.kind_at((x, y, z))


def _nothing_to_lift(grid: Grid, car: int) -> str:
    lifted = grid.cars[car, CarField.LOAD] == Kind.AIR and _own(grid, car) in (
        Kind.BLOCK,
        Kind.FLAG,
        Kind.FSLOPE,
    )
    return "" if lifted else "there is nothing to lift"


def _nothing_to_drop(grid: Grid, car: int) -> str:
    if grid.cars[car, CarField.LOAD] == Kind.AIR:
        return "there is nothing to drop"
    return "nothing stands on a slope" if grid.cars[car, CarField.SLOPE] else ""


def _nothing_to_fold(grid: Grid, car: int) -> str:
    return "" if _own(grid, car) == Kind.BODY else "there is nothing to fold"


def _nothing_to_unfold(grid: Grid, car: int) -> str:
    return "" if _own(grid, car) == Kind.FSLOPE else "there is nothing to unfold"


def _move(action: Action) -> ActionSpec:
    words = action.name.replace("_", " ").lower()
    return ActionSpec(
        "MOVE", words, space.of_move, "move", direction=MOVE_DIRECTION[action], ahead=(0, 1, 2, 3)
    )


def _diagonal(action: Action) -> ActionSpec:
    return ActionSpec("MOVE", action.name.replace("_", " ").lower(), space.of_nothing, "")


ACTIONS: Final[Mapping[Action, ActionSpec]] = {
    Action.LIFT: ActionSpec("LIFT", "lift", space.of_board, "lift", _nothing_to_lift, over=True),
    Action.DROP: ActionSpec("DROP", "drop", space.of_board, "drop", _nothing_to_drop),
    Action.FOLD: ActionSpec("FOLD", "fold", space.of_flap, "fold", _nothing_to_fold, over=True, beyond=2),
    Action.UNFOLD: ActionSpec(
        "UNFOLD", "unfold", space.of_flap, "unfold", _nothing_to_unfold, over=True, beyond=2
    ),
    Action.ROTATE_LEFT: ActionSpec("ROTATE_LEFT", "rotate left", space.of_turn, "rotate"),
    Action.ROTATE_RIGHT: ActionSpec("ROTATE_RIGHT", "rotate right", space.of_turn, "rotate"),
    Action.MOVE_FORWARD: _move(Action.MOVE_FORWARD),
    Action.MOVE_BACK: _move(Action.MOVE_BACK),
    Action.MOVE_LEFT: _move(Action.MOVE_LEFT),
    Action.MOVE_RIGHT: _move(Action.MOVE_RIGHT),
    Action.STOP: ActionSpec("STOP", "stop", space.of_nothing, "stop"),
    Action.MOVE_FORWARD_LEFT: _diagonal(Action.MOVE_FORWARD_LEFT),
    Action.MOVE_FORWARD_RIGHT: _diagonal(Action.MOVE_FORWARD_RIGHT),
    Action.MOVE_BACK_LEFT: _diagonal(Action.MOVE_BACK_LEFT),
    Action.MOVE_BACK_RIGHT: _diagonal(Action.MOVE_BACK_RIGHT),
}
"""The table of actions, in the order of their numbers."""

if list(ACTIONS) != list(Action):
    missing = next(action for action in Action if action not in ACTIONS)
    raise RuntimeError(
        f"{missing.name} has a number in craftsim/discrete/kinds.py, but no row in craftsim/discrete/actions.py"
    )

for _rules in (why, apply):
    _code = getattr(_rules, "py_func", _rules).__code__
    for _action, _spec in ACTIONS.items():
        if (
            _spec.performed
            and _action not in (*MOVE_DIRECTION, Action.STOP)
            and _action.name not in _code.co_names
        ):
            raise RuntimeError(f"{_action.name} is not chosen by {_code.co_name}() in {_rules.__module__}")

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
