"""What the options of several commands are called in the help, and how it groups them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from cyclopts import Group, Parameter

from craftsim.errors import InputError, suggestion

RESULTS: Final = Group("Results", sort_key=20)

Dir = Annotated[Path, Parameter(metavar="DIR", group=RESULTS)]
OptionalDir = Annotated[Path | None, Parameter(metavar="DIR", group=RESULTS)]
File = Annotated[Path | None, Parameter(metavar="FILE")]
Name = Annotated[str | None, Parameter(metavar="NAME")]
Settings = Annotated[tuple[str, ...], Parameter(metavar="NAME=VALUE")]
Actions = Annotated[tuple[str, ...], Parameter(metavar="ACTION")]
Films = Annotated[Literal["none", "failures", "all"], Parameter(group=RESULTS)]
Shown = Annotated[bool, Parameter(group=RESULTS)]


def check_actions(actions: Iterable[str]) -> None:
    """Raise InputError for a word that is no action; own ones that are registered are some."""
    from craftsim.discrete.actions import verbs

    for action in actions:
        if action not in verbs():
            known = ", ".join(verbs())
            raise InputError(
                f"--actions: no action '{action}'{suggestion(action, verbs())} (actions: {known})"
            )


def settings_of(words: Iterable[str]) -> dict[str, Any]:
    """Return the values that words such as ``width=128`` set, by name; several are divided by commas.

    Raises InputError for a word without "=", and for a name that is set twice.
    """
    from craftsim.storage.yaml import parse_document

    found = dict[str, Any]()
    for word in words:
        name, equals, value = word.partition("=")
        if not equals or not name or name in found:
            raise InputError(f"--set is '{word}'; allowed: NAME=VALUE, each name once")
        found[name] = parse_document(f"value: {value}\n", Path("--set")).plain["value"]
    return found
