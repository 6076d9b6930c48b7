"""Tab completion: the script of a shell, and the values that it asks for at each tab."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from cyclopts import App

from craftsim.checking.presets import RANDOMIZATIONS
from craftsim.cli import COMPLETE_WORDS, COMPLETION
from craftsim.cli.app import make_app
from craftsim.errors import InputError

if TYPE_CHECKING:
    from cyclopts.completion import CompletionContext

_SHELLS: Final = ("bash", "zsh", "fish")
_FILES: Final = ("FILE", "DIR", "RUN", "BUNDLE", "LOG", "WORLD", "TASK", "MODULE")
"""Words in the name of a value that may be a path."""
_MOST_PATHS: Final = 1_000
"""Paths of one folder that are offered at most."""


def script_of(words: Sequence[str]) -> str:
    """Return the completion script of a shell. Raises InputError for another one."""
    if len(words) != 1 or words[0] not in _SHELLS:
        raise InputError(
            f"'craftsim {COMPLETION}' needs a shell: {', '.join(_SHELLS)}; for bash: "
            f'eval "$(craftsim {COMPLETION} bash)" in ~/.bashrc'
        )
    return str(_app().generate_completion(shell=words[0]))  # type: ignore[arg-type]


def print_values(words: Sequence[str]) -> None:
    """Print the values that fit the last of some words, one a line, for the script of a shell."""
    _app()([COMPLETE_WORDS, *words])


def _app() -> App:
    return make_app(completer=_values)


def _values(context: CompletionContext) -> Iterable[str]:
    """Return what fits the word that is being completed: names, and paths where the value may be a file."""
    argument = context.argument
    yield from argument.get_choices() or ()
    yield from _names(context)
    name = str(argument.field_info.name)
    if any(word in (argument.parameter.metavar or "") for word in _FILES) or name in (
        "start",
        "task",
    ):
        yield from _paths(context.incomplete)


def _paths(prefix: str) -> list[str]:
    """Return the paths with a prefix; folders end with a slash."""
    folder, slash, start = prefix.rpartition("/")
    paths: list[str] = []
    try:
        for path in Path(folder + slash).iterdir():
            if not path.name.startswith(start) or (path.name.startswith(".") and not start):
                continue
            name = folder + slash + path.name
            if path.is_dir():
                name += "/"
            paths.append(name)
            if len(paths) == _MOST_PATHS:
                break
    except OSError:
        return []
    return sorted(paths)


def _tasks() -> list[str]:
    from craftsim.discrete.files.shipped import shipped_names
    from craftsim.tasks import TASK_NAMES, VARIED_NAMES

    return sorted({*TASK_NAMES, *VARIED_NAMES, *shipped_names("blueprints")})


def _worlds() -> list[str]:
    return [*_tasks(), "random"]


def _policies() -> list[str]:
    from craftsim.learning.policy_files import SHIPPED_POLICIES

    return [
        "planner",
        "random",
        "play",
        *sorted(path.stem for path in SHIPPED_POLICIES.glob("*.safetensors")),
    ]


def _presets() -> list[str]:
    return [*RANDOMIZATIONS]


def _assumed() -> list[str]:
    return [*RANDOMIZATIONS, "noise"]


def _gains() -> list[str]:
    from craftsim.skills.gains import PRESETS

    return [*PRESETS]


def _designs() -> list[str]:
    from craftsim.designs.library import BUILDINGS

    return [*BUILDINGS, "random"]


def _studies() -> list[str]:
    from craftsim.learning.study import SHIPPED_STUDIES

    return sorted(path.stem for path in SHIPPED_STUDIES.glob("*.yaml"))


def _actions() -> list[str]:
    from craftsim.discrete.actions import ACTIONS

    return [action.name for action, spec in ACTIONS.items() if spec.performed]


def _auto() -> list[str]:
    return ["auto"]


_NAMES: Final[dict[str, Callable[[], Iterable[str]]]] = {
    "task": _tasks,
    "start": _tasks,
    "worlds": _worlds,
    "policy": _policies,
    "randomize": _presets,
    "assume": _assumed,
    "gains": _gains,
    "stages": _tasks,
    "building": _designs,
    "study": _studies,
}
"""By the name of an argument in all commands that have it, what it may be called."""
_NAMES_BY_VALUE: Final[dict[str, Callable[[], Iterable[str]]]] = {
    "ACTION": _actions,
    "FILE|auto": _auto,
    "RUN|FILE|TASK": _tasks,
}
"""The same by the name of its value in help texts."""


def _names(context: CompletionContext) -> Iterable[str]:
    argument = context.argument
    name = str(argument.field_info.name)
    metavar = argument.parameter.metavar or ""
    names = _NAMES.get(name) or _NAMES_BY_VALUE.get(metavar)
    if names is None:
        return ()
    return names()
