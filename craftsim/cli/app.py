"""The command line application: parsing, help, configuration files and completion."""

from __future__ import annotations

import inspect
import shlex
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Final, get_args, get_type_hints

import cyclopts
from cyclopts import (
    App,
    MissingArgumentError,
    Parameter,
    UnknownOptionError,
    UnusedCliTokensError,
    ValidationError,
)
from cyclopts.argument import Argument, ArgumentCollection
from cyclopts.config import Dict
from cyclopts.token import Token

from craftsim.cli.commands import ALONE, BELOW, COMMANDS, MODULES
from craftsim.cli.text import print_error
from craftsim.errors import InputError
from craftsim.storage.limits import Range
from craftsim.validation.options import option_name, range_of
from craftsim.workers.modules import PLUG_INS, names_code, plug_ins

CONFIG: Final = "config.yaml"
"""Configuration file that every run writes into its output folder, and ``--config`` reads."""
_NO_MATTER: Final = ("out", "export", "workers", "engine", "resume", "host")
"""Options on which results do not depend."""
_NOT_FROM_A_FILE: Final[dict[str, str]] = {
    "out": "where results are written is",
    **dict.fromkeys(("export", "learn", "pddl"), "where files are written is"),
    "skills": "code is",
    "robot": "an address to call is",
    "host": "an address to wait on is",
    "key": "who may drive robots is",
    **dict.fromkeys(("workers", "engine", "resume"), "how a run is carried out is"),
}
"""Options that a configuration file cannot set, and the beginning of the sentence that says so.

Whoever wrote the file would choose what this process imports, where it writes, and with whom it talks.
"""
MOST_COLUMNS: Final = 100
"""Width of help on a wide terminal."""
COMMAND_LINE: Final[ContextVar[tuple[str, ...]]] = ContextVar("COMMAND_LINE", default=())
"""The words of the present command line."""
FOLDER: Final[ContextVar[Path | None]] = ContextVar("FOLDER", default=None)
"""The default output folder of a command that determines it itself."""


def make_app(completer: Callable[..., Any] | None = None) -> App:
    """Return the application; the module of a command is imported on use.

    With a ``completer`` of values it is one for tab completion: it has the options of ``craftsim train`` and the like
    beside the commands below them.
    """
    app = App(
        name="craftsim",
        version_flags=(),
        help_format="markdown",
        default_parameter=Parameter(
            negative_iterable=(),
            consume_multiple=1,
            show_default=_shown_default,
            completer=completer,
        ),
        result_action="return_value",
    )
    for name, text in COMMANDS.items():
        location = f"craftsim.cli.{MODULES.get(name, name)}:{name}"
        if name not in BELOW:
            app.command(location, name=name, help=text)
            continue
        parent = App(name=name, help=text)
        app.command(parent)
        for below, summary in BELOW[name].items():
            parent.command(
                f"craftsim.cli.{MODULES.get(below, below)}:{below}", name=below, help=summary
            )
        if completer is not None and name not in ALONE:
            parent.default(_function(name))
    return app


def _shown_default(value: Any) -> Any:
    """Return a default as help shows it; None, which is not shown, for one that says nothing."""
    if value in (None, (), "") or value is False:
        return None
    if isinstance(value, tuple):
        return " ".join(value)
    return value


def _function(name: str) -> Callable[..., Any]:
    function: Callable[..., Any] = getattr(
        import_module(f"craftsim.cli.{MODULES.get(name, name)}"), name
    )
    return function


def _command(app: App, words: Sequence[str]) -> tuple[App, list[str]]:
    """Return the application of the command that words begin with, and its name, of one word or two."""
    name = words[0]
    command = app[name]
    if len(words) > 1 and words[1] in BELOW.get(name, ()):
        return command[words[1]], [name, words[1]]
    if name in BELOW and name not in ALONE:
        command.default(_function(name))
    return command, [name]


def print_help(words: Sequence[str]) -> None:
    """Print the help of the command with this name."""
    from craftsim.reports.terminal import Terminal

    app = make_app()
    command, name = _command(app, words)
    if command.default_command is not None:
        command.help = inspect.getdoc(command.default_command)
    console = Terminal()
    console.width = min(MOST_COLUMNS, console.width)
    app.help_print(name, console=console)


def bind(words: Sequence[str]) -> tuple[Callable[..., Any], inspect.BoundArguments]:
    """Return the function of a command line and its arguments, from the words and from a configuration file.

    Raises:
        InputError: the words or the file are invalid.
    """
    words, file = _without_config(list(words))
    app = make_app()
    _command(app, words)
    if file is not None:
        app.config = _FileOptions(file, _configured(file, words))
    try:
        function, bound, _ = app.parse_args(words, exit_on_error=False, print_error=False)
    except cyclopts.CycloptsError as error:
        raise InputError(_message(error)) from None
    return function, bound


def _message(error: cyclopts.CycloptsError) -> str:
    """Return an error of cyclopts as one sentence, with what is allowed."""
    argument = error.argument
    command = " ".join(error.command_chain or ())
    if isinstance(error, ValidationError) and argument is not None:
        allowed = range_of(argument.parameter)
        if allowed is not None:
            token = _token_outside(argument, allowed)
            return f"{token.keyword or argument.name} is {token.value}; allowed: {allowed}"
    if isinstance(error, UnusedCliTokensError):
        return (
            f"'{shlex.join(error.unused_tokens or ())}' is too much: see craftsim {command} --help"
        )
    if isinstance(error, MissingArgumentError) and argument is not None and argument.required:
        return f"{argument.name.lstrip('-').upper()} is missing: see craftsim {command} --help"
    text = " ".join(str(error).split())
    if isinstance(error, UnknownOptionError) and "Did you mean" not in text:
        names: list[str] = []
        for argument in error.argument_collection:
            names += [name for name in argument.names if name.startswith("--")]
        text += f" Allowed: {', '.join(dict.fromkeys(names))}."
    return text


def _token_outside(argument: Argument, allowed: Range) -> Token:
    """Return the first word of an argument that is no number in a range."""
    for token in argument.tokens:
        try:
            number = float(token.value)
        except ValueError:
            return token
        if number not in allowed:
            return token
    return argument.tokens[0]


class _FileOptions:
    """The options of a configuration file, for those that the command line does not give."""

    def __init__(self, file: Path, options: dict[str, Any]) -> None:
        self.file = file
        self.options = options

    def __call__(self, app: App, commands: tuple[str, ...], arguments: ArgumentCollection) -> None:
        """Add the file's values. Raises InputError for an option that a file cannot set and for the name of code."""
        on_command_line = {argument.name for argument in arguments if argument.tokens}
        for name in self.options:
            # Cyclopts passes over keys that are names of commands, without a word.
            if name in app:
                raise InputError(f'{self.file}: Unknown option: "{name}"')
        below_commands = self.options
        for command in reversed(commands):
            below_commands = {command: below_commands}
        Dict(below_commands, source=str(self.file))(app, commands, arguments)
        names_of_packages: set[str] = set()
        for kind in PLUG_INS:
            names_of_packages |= plug_ins(kind).keys()
        for argument in arguments:
            if argument.tokens and argument.name not in on_command_line:
                self._check(argument, names_of_packages)

    def _check(self, argument: Argument, names_of_packages: Collection[str]) -> None:
        name = argument.name.removeprefix("--")
        values = [token.value for token in argument.tokens]
        reason = _NOT_FROM_A_FILE.get(name)
        if reason is None and any(
            names_code(value) or value in names_of_packages for value in values
        ):
            reason = "code is"
        if reason is None:
            return
        words = [value for value in values if value]
        if argument.hint is bool:
            words = [argument.name]
        elif argument.index is None:
            words = [argument.name, *words]
        trusting_command = shlex.join(words)
        raise InputError(
            f"{self.file}: {name} is {', '.join(values)}: {reason} given on the command line alone, never by a "
            f"file; leave it out there, or if you trust it add: {trusting_command}"
        )


def _without_config(words: list[str]) -> tuple[list[str], Path | None]:
    """Return a command line without ``--config FILE`` or ``--config=FILE``, and the file if there is one."""
    for place, word in enumerate(words):
        before = words[:place]
        after = words[place + 1 :]
        if word == "--":
            break
        if word.startswith("--config="):
            return before + after, Path(word.removeprefix("--config="))
        if word == "--config":
            if not after:
                raise InputError("--config needs a file, such as the config.yaml of a run")
            return before + after[1:], Path(after[0])
    return words, None


def _configured(file: Path, words: Sequence[str]) -> dict[str, Any]:
    """Return the options in a configuration file, by name. Raises InputError for one of another command."""
    from craftsim.storage.yaml import read_document

    document = read_document(file).plain
    options = document.get("options", {})
    command = document.get("command", words[0])
    has_other_keys = not document.keys() <= {"command", "versions", "options"}
    if has_other_keys or not isinstance(options, dict) or not isinstance(command, str):
        raise InputError(
            f"{file}: allowed are 'command', 'versions' and 'options', a mapping from names to values"
        )
    if command.split() != list(words[: len(command.split())]):
        raise InputError(f"{file}: is for 'craftsim {command}', not for 'craftsim {words[0]}'")
    _compare_versions(file, document.get("versions"))
    return {name: value for name, value in options.items() if value not in (None, [])}


def _compare_versions(file: Path, versions_of_file: object) -> None:
    """Print a warning for each package of which a configuration file names another version than that here."""
    from craftsim.reports.json_file import versions

    if not isinstance(versions_of_file, dict):
        return
    installed = versions()
    for name, version in versions_of_file.items():
        if str(version) != installed.get(name):
            print_error(
                f"{file} is of {name} {version}; here is {installed.get(name, 'none')}: results may differ"
            )


def write_config(
    words: Sequence[str],
    function: Callable[..., Any],
    bound: inspect.BoundArguments,
    folder: Path | None,
) -> None:
    """Write the configuration of a command, for ``--config``, into its output folder, or the default one ``folder``."""
    bound.apply_defaults()
    out = bound.arguments.get("out") or folder
    if out is None or not (out / "report.json").is_file():
        return
    import yaml

    from craftsim.reports.json_file import json_value, versions
    from craftsim.storage.writing import write_whole

    command = words[0]
    if len(words) > 1 and words[1] in BELOW.get(command, ()):
        command = f"{command} {words[1]}"
    options = {}
    for name, value in _options(inspect.unwrap(function), bound.arguments):
        if name not in _NO_MATTER:
            options[name] = json_value(value)
    document = {"command": command, "versions": versions(), "options": options}
    write_whole(out / CONFIG, yaml.safe_dump(document, sort_keys=False))


def _options(owner: Any, values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the options of a function or class by their names on the command line, including groups."""
    hints = get_type_hints(owner, include_extras=True)
    for name, value in values.items():
        if is_dataclass(value):
            yield from _options(type(value), vars(value))
            continue
        parameter = Parameter()
        for annotation in get_args(hints[name]):
            if isinstance(annotation, Parameter) and annotation.name:
                parameter = annotation
        yield option_name(parameter, name), value


def command_again() -> str:
    """Return the command line that repeats the results, without options on which they do not depend."""
    words = ["craftsim"]
    is_left_out = False
    for word in COMMAND_LINE.get():
        option = None
        if word.startswith("--"):
            option = word.partition("=")[0].removeprefix("--").removeprefix("no-")
            is_left_out = option in _NO_MATTER
        if not is_left_out:
            words.append(word)
        # The values of an option go with it; a flag, and an option with "=", has none after it.
        if option == "resume" or "=" in word:
            is_left_out = False
    return shlex.join(words)
