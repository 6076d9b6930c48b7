"""Help as plain text: options under headings, with values, ranges and defaults."""

from __future__ import annotations

import inspect
import shutil
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from craftsim.options import range_of

if TYPE_CHECKING:
    from cyclopts import App
    from cyclopts.argument import Argument

_INDENT: Final = 26  # column of the explanations
_ORDER: Final = ("Arguments", "Options", "Rollouts", "Physics", "Trials", "Results")  # the headings
REFERRED: Final = ("Rollouts", "Physics", "Trials")
"""Groups of options explained by the help of validate; other commands list them with their defaults."""


def command_help(app: App, found: Iterable[Argument], words: Sequence[str], below: Mapping[str, str]) -> str:
    """Return the help of a command: of its application, its arguments, its name, and one line for each subcommand."""
    width = min(100, shutil.get_terminal_size().columns)
    function = app.default_command
    arguments = [one for one in found if one.show]
    usage = ["usage: craftsim", *words]
    usage += [
        value_name(one) if one.required else f"[{value_name(one)}]" for one in arguments if is_positional(one)
    ]
    usage.append("[OPTIONS]" if function is not None else "COMMAND")
    lines = _wrapped(" ".join(usage), width, "", "    ")
    text = (inspect.getdoc(function) if function is not None else app.help) or ""
    for paragraph in text.partition("\nArgs:")[0].strip().split("\n\n"):
        lines += ["", *_wrapped(paragraph, width)]
    if below:
        lines += ["", "Commands", *(f"  {name:<12}{text}" for name, text in below.items())]
    headings: dict[str, list[Argument]] = {}
    for one in arguments:
        headings.setdefault(_heading(one), []).append(one)
    for heading, its in sorted(headings.items(), key=lambda item: _ORDER.index(item[0])):
        lines += ["", heading]
        if heading in REFERRED and words != ["validate"]:
            briefs = (f"{_names(one)[0]}{f' [{_default(one)}]' if _default(one) else ''}" for one in its)
            lines += _wrapped(f"{', '.join(briefs)}: see 'craftsim validate --help'", width, "  ", "  ")
            continue
        for one in its:
            lines += _option(one, width)
    return "\n".join(lines)


def _wrapped(text: str, width: int, first: str = "", others: str = "") -> list[str]:
    text = " ".join(text.split())
    return textwrap.wrap(text, width, initial_indent=first, subsequent_indent=others, break_on_hyphens=False)


def _option(one: Argument, width: int) -> Iterator[str]:
    name = (
        value_name(one)
        if is_positional(one)
        else " ".join(filter(None, [", ".join(_names(one)), value_name(one)]))
    )
    said = " ".join((one.parameter.help or "").split()).rstrip(".")
    default = _default(one)
    notes = [f"[{allowed}]"] if (allowed := range_of(one.parameter)) else []
    notes += [f"[default {default}]"] if default else []
    text = " ".join([f"{said[:1].lower()}{said[1:]}" if said[1:2].islower() else said, *notes])
    explained = _wrapped(text, width, " " * _INDENT, " " * _INDENT)
    if len(name) + 4 > _INDENT:
        yield f"  {name}"
        yield from explained
    else:
        yield f"  {name:<{_INDENT - 2}}{explained[0].strip()}"
        yield from explained[1:]


def is_positional(one: Argument) -> bool:
    """Return whether an argument is given by its place, without a name."""
    return one.index is not None


def _names(one: Argument) -> list[str]:
    """Return the names of an option; those with "no-" only if the default is, or may be, on."""
    on = one.field_info.default is True or one.hint == bool | None
    off = {name for name in one.negatives if not on}
    return [name for name in one.names if name.startswith("--") and name not in off]


def value_name(one: Argument) -> str:
    """Return what an argument or option takes, as its help shows it."""
    several = " ..." if "tuple" in str(one.hint) and "..." not in (one.parameter.metavar or "") else ""
    if one.parameter.metavar:
        return f"{one.parameter.metavar}{several}"
    if choices := one.get_choices():
        return f"{{{','.join(choices)}}}{several}"
    if "bool" in f"{one.hint} {one.field_info.annotation}":
        return ""
    return (one.names[0].strip("-").upper().rstrip("S") if is_positional(one) else "TEXT") + several


def _default(one: Argument) -> str:
    default = one.field_info.default
    if default in (None, (), "", inspect.Parameter.empty) or default is False:
        return ""
    if default is True:
        return "yes"
    if isinstance(default, float):
        return f"{default:g}"
    return " ".join(map(str, default)) if isinstance(default, tuple) else str(default)


def _heading(one: Argument) -> str:
    if is_positional(one):
        return "Arguments"
    groups: Any = one.parameter.group
    named = [group.name for group in groups or () if not isinstance(group, str)]
    return "Options" if not named or named[0] in ("Parameters", "Arguments") else named[0]
