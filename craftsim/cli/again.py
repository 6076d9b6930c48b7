"""The command line that asks for the same results again."""

from __future__ import annotations

import dataclasses
import inspect
import shlex
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, get_type_hints

import tyro

NO_MATTER: Final = {"out", "workers", "engine", "resume"}
"""Options that say where the work is done and where results go, which decide none of them."""


def command_again(command: Callable[..., int], given: Mapping[str, Any]) -> str:
    """Return the line that asks for the results of a command again: all in which it differs from the defaults.

    Args:
        command: function of the command, of its name.
        given: its arguments by name, those with default values included.
    """
    words, options = ["craftsim", command.__name__], list[str]()
    types = get_type_hints(command, include_extras=True)
    for name, parameter in inspect.signature(command).parameters.items():
        value = given[name]
        if tyro.conf.Positional in getattr(types[name], "__metadata__", ()):
            words += map(str, value if isinstance(value, tuple) else (value,))
        elif dataclasses.is_dataclass(value):
            for field in dataclasses.fields(value):
                options += _option(
                    field.name, getattr(value, field.name), getattr(parameter.default, field.name)
                )
        else:
            options += _option(name, value, parameter.default)
    return shlex.join(words + options)


def _option(name: str, value: Any, default: Any) -> Iterator[str]:
    if name in NO_MATTER or value == default:
        return
    word = name.replace("_", "-")
    if isinstance(value, bool):
        yield f"--{word}" if value else f"--no-{word}"
        return
    yield f"--{word}"
    yield from map(str, value if isinstance(value, tuple) else (value,))
