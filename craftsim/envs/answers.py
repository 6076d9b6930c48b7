"""Actions as words: what a language model answers, read and written."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

from craftsim.discrete.actions import ACTIONS, action_names
from craftsim.discrete.kinds import Action
from craftsim.errors import InputError, suggestion

MARK: Final = "ANSWER:"
"""What stands before the last one of these is thought aloud, and not read."""
FORM: Final = "car_0: lift; car_1: move forward"
"""An answer, for messages and instructions."""
MAX_ANSWER: Final = 100_000
"""Characters of an answer."""

_SHOWN: Final = 60
_PART: Final = re.compile(r"(?:car[ _]?)?([0-9]{1,4})\s*:\s*(.+)", re.IGNORECASE)


def words_of(action: int) -> str:
    """Return what an action is called in answers, ``move forward`` for instance."""
    return Action(action).name.lower().replace("_", " ")


def offered() -> tuple[str, ...]:
    """Return the actions that can be legal, in words."""
    return tuple(words_of(action) for action, spec in ACTIONS.items() if spec.performed or spec.legality)


def answer_text(actions: Mapping[str, Any]) -> str:
    """Return the answer that says these actions, numbers by agent; :func:`read_answer` reads it.

    Example:
        >>> answer_text({"car_0": 0, "car_1": 6})
        'car_0: lift; car_1: move forward'
    """
    return "; ".join(f"{agent}: {words_of(action)}" for agent, action in actions.items())


def read_answer(text: str, n_cars: int) -> list[Action]:
    """Return the action of each car that an answer names; a car that it does not name stops.

    An answer has ``car: action`` for some cars, divided by semicolons or lines; only what follows the last ``ANSWER:``,
    if there is one, is read. Case does not matter, nor whether words are joined by blanks or underscores.

    Raises InputError for a text without an action, an unknown car or action, and a car that is named twice.

    Example:
        >>> [action.name for action in read_answer("Clear the way first. ANSWER: car_1: MOVE_LEFT", 2)]
        ['STOP', 'MOVE_LEFT']
    """
    if not isinstance(text, str):
        raise InputError(f"an answer is a text such as '{FORM}', not a {type(text).__name__}")
    if len(text) > MAX_ANSWER:
        raise InputError(f"the answer has {len(text)} characters; allowed: {MAX_ANSWER}")
    parts = [part.strip(" \t.`*") for part in re.split(r"[;\n]", text.rpartition(MARK)[2])]
    found: dict[int, Action] = {}
    for part in filter(None, parts):
        match = _PART.fullmatch(part)
        if match is None:
            raise InputError(f"'{part[:_SHOWN]}' is no 'car: action'; an answer is such as '{FORM}'")
        car = int(match[1])
        if car >= n_cars:
            raise InputError(f"there is no car_{car}; the cars are {_cars(n_cars)}")
        if car in found:
            raise InputError(f"car_{car} is named twice; in a tick each car does one action")
        found[car] = _action(match[2])
    if not found:
        raise InputError(f"the answer names no action; it should be such as '{FORM}'")
    return [found.get(car, Action.STOP) for car in range(n_cars)]


def _action(words: str) -> Action:
    name = re.sub(r"[\s_]+", "_", words.strip()).upper()
    if name not in action_names():
        hint = suggestion(words[:_SHOWN].lower(), offered())
        raise InputError(f"unknown action '{words[:_SHOWN]}'{hint}; there are {', '.join(offered())}")
    return Action[name]


def _cars(n_cars: int) -> str:
    return ", ".join(f"car_{car}" for car in range(n_cars))
