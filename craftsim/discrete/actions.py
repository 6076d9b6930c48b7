"""The table of actions: one row each. :func:`register_action` adds a row for an action of a user's own, whose legality
and effect are functions in Python.

When one of the 15 is legal and what it changes is compiled (``craftsim/discrete/kernel``), with the words for why it is
forbidden in ``craftsim/discrete/rules.py``; the skills that perform them stand in ``craftsim/skills/library.py``,
their nominal durations in ``craftsim/data/durations.yaml``. Skills and durations are checked against this table.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.jit import seldom
from craftsim.discrete.grid import Cell, Grid, cell_of, check_values
from craftsim.discrete.kernel.claims import CHANGES, LOADS, MOST, SPACE, Claims, write_claims
from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.kernel.state import DERIVED_MARKS, NO_PATTERNS
from craftsim.discrete.kinds import (
    CARRIED,
    MOVE_DIRECTION,
    Action,
    CarField,
    CellField,
    Kind,
    add_action,
)
from craftsim.errors import InputError
from craftsim.workers.modules import note_registering

_write_claims = seldom(write_claims)

Legality = Callable[[Grid, int], str | None]
"""(grid, car) -> why the car cannot do it now, in words; None or "" if it can."""
Effect = Callable[[Grid, int], None]
"""(grid, car): changes the grid as the car's action does; marks need no attention."""
Touched = Callable[[Grid, Grid, int], Iterable[Cell]]
"""(before, after, car) -> the cells (x, y, z) that the action sweeps, or whose things it changes."""


@dataclass(frozen=True)
class ActionSpec:
    """An action of the grid world; see the table :data:`ACTIONS`."""

    verb: str
    """Its name whatever the map direction: reports, the audit and its contexts group by it."""
    words: str
    """Its name in captions and logs."""
    duration: str
    """Its row in ``craftsim/data/durations.yaml``; empty where no skill performs it, as no rule ever allows it."""
    nothing_to_try: Callable[[Grid, int], str] = lambda grid, car: ""
    """Reason why there is nothing to try where it is forbidden: (grid, car) -> words, empty where there is something.
    """
    direction: int | None = None
    """Grid yaw of a move."""
    ahead: tuple[int, ...] = ()
    """Directions, relative to the heading, in which it goes: the audit's contexts vary what is in the next cell there,
    beyond the car's level, ground, cell and load."""
    over: bool = False
    """It matters what is above the own cell or, with ``ahead``, above the next one."""
    beyond: int | None = None
    """Relative direction in which it matters whether a block is in the cell after the next."""
    legality: Legality | None = None
    effect: Effect | None = None
    """Effect of a registered action; those of the 15 are compiled."""
    footprint: Callable[[Grid, Grid, int], Claims] | None = None
    """Claims of a registered action beyond those of the car where it stands: (before, after, car) -> claims."""
    duration_s: float = 0.0
    """Nominal duration of a registered action, which has no row in the file."""
    skill: Callable[..., Any] | None = None
    """Class of skills of a registered action, or a function that sets up the task of a built-in law."""

    @property
    def performed(self) -> bool:
        """Whether a skill performs it."""
        return bool(self.duration) or self.skill is not None


def _needs(verb: str, *kinds: Kind) -> Callable[[Grid, int], str]:
    """Return the function ``nothing_to_try`` of an action that needs one of some kinds in the car's cell."""

    def nothing_to_try(grid: Grid, car: int) -> str:
        if grid.kind_at(cell_of(grid, car)) in kinds:
            return ""
        return f"there is nothing to {verb}"

    return nothing_to_try


def _nothing_to_lift(grid: Grid, car: int) -> str:
    loaded = grid.cars[car, CarField.LOAD] != Kind.AIR
    if loaded:
        return "there is nothing to lift"
    return _needs("lift", *CARRIED)(grid, car)


def _nothing_to_drop(grid: Grid, car: int) -> str:
    if grid.cars[car, CarField.LOAD] == Kind.AIR:
        return "there is nothing to drop"
    if grid.cars[car, CarField.SLOPE]:
        return "nothing stands on a slope"
    return ""


def _move(action: Action) -> ActionSpec:
    words = action.name.replace("_", " ").lower()
    direction = MOVE_DIRECTION.get(action)
    if direction is None:
        return ActionSpec("MOVE", words, "")
    return ActionSpec("MOVE", words, "move", direction=direction, ahead=(0, 1, 2, 3))


ACTIONS: Final[dict[Action, ActionSpec]] = {
    Action.LIFT: ActionSpec("LIFT", "lift", "lift", _nothing_to_lift, over=True),
    Action.DROP: ActionSpec("DROP", "drop", "drop", _nothing_to_drop),
    Action.FOLD: ActionSpec("FOLD", "fold", "fold", _needs("fold", Kind.BODY), over=True, beyond=2),
    Action.UNFOLD: ActionSpec(
        "UNFOLD", "unfold", "unfold", _needs("unfold", Kind.FSLOPE), over=True, beyond=2
    ),
    Action.ROTATE_LEFT: ActionSpec("ROTATE_LEFT", "rotate left", "rotate"),
    Action.ROTATE_RIGHT: ActionSpec("ROTATE_RIGHT", "rotate right", "rotate"),
    **{action: _move(action) for action in sorted(MOVE_DIRECTION)},
    Action.STOP: ActionSpec("STOP", "stop", "stop"),
    **{action: _move(action) for action in Action if action > Action.STOP},
}
"""The table of actions, in the order of their numbers; registered ones come last."""

if list(ACTIONS) != list(Action):
    missing = next(action for action in Action if action not in ACTIONS)
    raise RuntimeError(
        f"{missing.name} has a number in craftsim/discrete/kinds.py, but no row in craftsim/discrete/actions.py"
    )


def verbs() -> tuple[str, ...]:
    """Return all verbs, in the order of the actions."""
    return tuple(dict.fromkeys(spec.verb for spec in ACTIONS.values()))


def action_names() -> list[str]:
    """Return the names of all actions."""
    return [action.name for action in ACTIONS]


def is_registered(action: int) -> bool:
    """Return whether an action is a registered one."""
    return N_ACTIONS <= action < len(ACTIONS)


def as_registered(actions: Any) -> tuple[Action, ...]:
    """Return registered actions that are given by themselves or by their names, in this order.

    Raises InputError for what is none, and for one that stands twice.
    """
    if isinstance(actions, str) or not isinstance(actions, tuple | list):
        raise InputError(
            f"actions is {actions!r}; allowed: a sequence of registered actions, or their names"
        )
    registered = {action.name: action for action in ACTIONS if is_registered(action)}
    chosen: list[Action] = []
    for name in (str(getattr(item, "name", item)) for item in actions):
        if name not in registered:
            names = ", ".join(registered)
            hint = "none is registered; import the module that does"
            if registered:
                hint = f"there are {names}"
            raise InputError(f"no registered action '{name}'; {hint}")
        if registered[name] in chosen:
            raise InputError(f"the action '{name}' stands twice; allowed: once")
        chosen.append(registered[name])
    return tuple(chosen)


def registered_reason(grid: Grid, corrections: int, car: int, action: int) -> str:
    """Return why a registered action is forbidden, in words; empty if it is legal."""
    if not corrections & DERIVED_MARKS:
        return "the published rules know no other actions than CraftEnv's"
    spec = ACTIONS[Action(action)]
    assert spec.legality is not None
    reason = spec.legality(grid, car)
    if reason is not None and not isinstance(reason, str):
        raise InputError(
            f"{spec.verb}: legal(grid, car) returned {reason!r}; it must return a text or None"
        )
    return reason or ""


def carry_out(grid: Grid, car: int, action: int) -> None:
    """Change a grid as a registered action does. Raises InputError if the result is not a valid grid."""
    spec = ACTIONS[Action(action)]
    assert spec.effect is not None
    result: object = spec.effect(grid, car)
    if result is not None:
        words = "effect(grid, car) must change the grid and return None"
        raise InputError(f"{spec.verb}: {words}, not {result!r}")
    grid.cells[..., CellField.OCCUPANT :] = (
        -1,
        0,
    )  # derived below, of a world that compiled code can look at
    try:
        check_values(grid)
    except InputError as error:
        raise InputError(f"{spec.verb}: after effect(grid, {car}) {error}") from error
    grid.derive_marks()


def act_registered(grid: Grid, corrections: int, car: int, action: int) -> bool:
    """Carry out a registered action if it is legal now; return whether it was."""
    legal = not registered_reason(grid, corrections, car, action)
    if legal:
        carry_out(grid, car, action)
    return legal


def registered_columns(
    mask: NDArray[np.bool_], grids: Grid, corrections: int, own: tuple[Action, ...]
) -> NDArray[np.bool_]:
    """Return the masks (B, n, 15) of a batch with a further column for each of some registered actions."""
    if not own:
        return mask
    columns = np.zeros((*mask.shape[:2], len(own)), np.bool_)
    for i, car, k in np.ndindex(columns.shape):
        columns[i, car, k] = not registered_reason(grids[i], corrections, car, own[k])
    return np.concatenate([mask, columns], axis=-1)


def register_action(
    name: str,
    legal: Legality,
    effect: Effect,
    *,
    duration_s: float,
    footprint: Touched | None = None,
    skill: Callable[..., Any] | None = None,
    words: str = "",
    ahead: Iterable[int] = (),
    over: bool = False,
    beyond: int | None = None,
    nothing_to_try: Legality | None = None,
) -> Action:
    """Add an action of your own to those that rules, plans, environments, the judge and the audit know; return it.

    Call it at the top level of a module: processes that craftsim starts import that module, too. Only the physical rule
    set allows registered actions, for the published one is CraftEnv's.

    Args:
        name: in capitals, as in ``PUSH``.
        legal: ``legal(grid, car)`` returns in words why the car cannot do it now, None or "" if it can.
        effect: ``effect(grid, car)`` changes the grid as a legal action does; marks are derived after it.
        duration_s: nominal duration, for schedules and the grid's clock.
        footprint: ``footprint(before, after, car)`` returns the cells (x, y, z) that the car, its load or what it moves
            sweeps; no other action that needs them runs at the same time. Unless given, the cells that change. Where
            the car stands before and after counts in any case.
        skill: what performs it: a subclass of :class:`craftsim.Skill`, or a function that sets up the task of a
            built-in law, as those of ``craftsim/skills/skill.py``; without one the action is for the grid alone.
        words: how captions call it, the name in small letters unless given.
        ahead: of what the audit varies: the directions, relative to the heading (0 forward, 1 left, 2 back, 3 right),
            in which the next cell matters.
        over: whether it matters what is above the own cell or, with ``ahead``, above the next one.
        beyond: the direction in which it matters whether a block is in the cell after the next.
        nothing_to_try: returns why the audit need not try it where it is forbidden, as ``legal`` does; what is legal
            alone is tried unless given.

    Raises InputError for a name that is taken or is none, a function of other arguments, and a duration that is none.

    Example:
        >>> import craftsim
        >>> def on_the_floor(grid, car):
        ...     return None if grid.cars[car, 2] == 1 else "the car is not on the floor"
        >>> def about(grid, car):
        ...     grid.cars[car, 3] = (grid.cars[car, 3] + 2) % 4
        >>> TURN_ABOUT = craftsim.register_action("TURN_ABOUT", on_the_floor, about, duration_s=1.8)
        >>> rules, grid = craftsim.Rules("physical"), craftsim.Grid.empty((3, 1, 1), n_cars=1)
        >>> print(rules.explain(grid, 0, TURN_ABOUT), rules.apply(grid, 0, TURN_ABOUT).cars[0].tolist())
        TURN_ABOUT is legal [0, 0, 1, 2, 0, 0, 0]
    """
    if not isinstance(name, str) or not re.fullmatch(r"[A-Z][A-Z0-9_]{0,39}", name):
        raise InputError(
            f"an action's name is made of capitals, digits and _, such as PUSH, not {name!r}"
        )
    if name in {*action_names(), *verbs()}:
        raise InputError(f"there is an action '{name}' already; give yours another name")
    skill_arguments: tuple[str, ...] = ("setup", "now", "task")
    if isinstance(skill, type):
        skill_arguments = ("setup",)
    for argument, function, arguments in (
        ("legal", legal, ("grid", "car")),
        ("effect", effect, ("grid", "car")),
        ("footprint", footprint, ("before", "after", "car")),
        ("skill", skill, skill_arguments),
        ("nothing_to_try", nothing_to_try, ("grid", "car")),
    ):
        if function is not None or argument in ("legal", "effect"):
            _check_takes(name, argument, function, arguments)
    seconds = isinstance(duration_s, int | float) and not isinstance(duration_s, bool)
    if not (seconds and 0 < duration_s < np.inf):
        raise InputError(f"{name}: duration_s is {duration_s!r}; allowed: seconds, more than 0")
    spec = ActionSpec(
        name,
        words or name.replace("_", " ").lower(),
        "",
        lambda grid, car: (nothing_to_try or legal)(grid, car) or "",
        ahead=tuple(ahead),
        over=over,
        beyond=beyond,
        legality=legal,
        effect=effect,
        footprint=_touching(footprint or _changed),
        duration_s=float(duration_s),
        skill=skill,
    )
    action = add_action(name, note_registering())
    ACTIONS[action] = spec
    return action


def _check_takes(name: str, argument: str, function: Any, arguments: tuple[str, ...]) -> None:
    """Raise InputError for anything but a function of these arguments."""
    form = f"{argument}({', '.join(arguments)})"
    if not callable(function):
        raise InputError(f"{name}: {argument} must be a function, {form}, not {function!r}")
    try:
        signature = inspect.signature(function)
    except ValueError:  # some that are not written in Python do not tell
        return
    try:
        signature.bind(*arguments)
    except TypeError as error:
        raise InputError(
            f"{name}: {argument} is called as {form}, but yours takes {signature}: {error}"
        ) from error


def _changed(before: Grid, after: Grid, car: int) -> Iterable[Cell]:
    """Return the cells whose things differ."""
    differs = (before.kind != after.kind) | (before.yaw != after.yaw)
    return [(x, y, z) for x, y, z in np.argwhere(differs).tolist()]


def _touching(touched: Touched) -> Callable[[Grid, Grid, int], Claims]:
    """Return the claims of the cells that a user's function names: swept, changed, and a moving load in each."""

    def of_cells(before: Grid, after: Grid, car: int) -> Claims:
        rows = [
            (int(x), int(y), int(z), SPACE | CHANGES | LOADS)
            for x, y, z in touched(before, after, car)
        ]
        return np.array(rows, np.int16).reshape(-1, 4)

    return of_cells


def check_complete(parts: Mapping[Action, object], noun: str, file: str) -> None:
    """Raise RuntimeError, with the action, if one that is performed has no part, or one has a part that is not.

    A part is ``noun``, such as ``skill``; the file ``file`` lists them.
    """
    for action in Action:
        spec = ACTIONS[action]
        if spec.performed and action not in parts:
            raise RuntimeError(f"{action.name} has no {noun} in {file}")
        if not spec.performed and action in parts:
            raise RuntimeError(f"{action.name} has a {noun} in {file}, but is never performed")


def footprint(before: Grid, after: Grid, car: int, action: Action) -> Claims:
    """Return the claims of a legal action, given the predicted worlds before and after it; a cell may stand twice."""
    user_footprint = ACTIONS[action].footprint
    if user_footprint is None:
        return built_in_claims(before, car, action)
    claims = user_footprint(before, after, car)
    at_start = built_in_claims(before, car, Action.STOP)
    at_end = built_in_claims(after, car, Action.STOP)
    return np.concatenate([claims, at_start, at_end])


def built_in_claims(grid: Grid, car: int, action: int) -> Claims:
    """Return the claims of a legal action of the 15 in a world; STOP needs what the car needs where it stands."""
    rows = np.empty((MOST, 4), np.int16)
    count = _write_claims(grid.cells, grid.cars, 0, NO_PATTERNS, car, int(action), rows)
    return rows[:count]
