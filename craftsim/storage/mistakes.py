"""The first of the mistakes that a schema finds, in one line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from pydantic import ValidationError

_SHOWN: Final = 60
"""Characters of what a message quotes from a file."""


def first_mistake(error: ValidationError) -> str:
    """Return the key, what is allowed and what was found; lists should fail fast, or all is described before."""
    first = error.errors(include_url=False)[0]
    place = ".".join(str(part)[:_SHOWN] for part in first["loc"])
    if not place:
        return first["msg"]
    return f"key '{place}': {first['msg']}" + (
        "" if first["type"] == "missing" else f", not {_shown(first['input'])}"
    )


def _shown(value: object) -> str:
    if isinstance(value, dict | list | tuple):
        return "a mapping" if isinstance(value, dict) else "a list"
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}..."
