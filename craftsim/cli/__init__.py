"""The command line: ``craftsim COMMAND``.

A command is one function of the command's name, in the module of its name or that of ``commands.MODULES``; its typed
parameters become options and its integer result the exit status. It is imported only when it is called.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from craftsim.cli.commands import COMMANDS, overview
from craftsim.cli.text import (
    discard_output,
    output_closed,
    print_error,
    print_safe,
    replace_unencodable,
)
from craftsim.compiled.progress import report_compiling
from craftsim.errors import (
    DISK_ERRORS,
    CraftsimError,
    InputError,
    is_interrupt,
    refusal,
    shortage,
    suggestion,
)
from craftsim.storage.extras import check_mujoco
from craftsim.storage.paths import check_working_folder, is_folder
from craftsim.workers.interrupts import interruptible, note_answered
from craftsim.workers.modules import import_user_module, safe_path

PLUGINS: Final = "--plugins"
"""Option before the command: user modules to import first, separated by commas."""
COMPLETION: Final = "completion"
"""Command that prints a completion script."""
COMPLETE_WORDS: Final = "__complete"
"""First word of the command line by which such a script asks for values."""
INTERRUPTED: Final = 130
"""Exit status of an interrupted command."""
BROKEN_PIPE: Final = 141
"""Exit status of a process ended by SIGPIPE."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command, by default that of this process; return its exit status: its own, 2 for invalid input, 130 if
    interrupted by Ctrl-C, SIGTERM or SIGHUP, 141 if stdout is closed."""
    replace_unencodable()
    report_compiling()
    try:
        try:
            with interruptible(), safe_path():
                return _run_safely(list(sys.argv[1:] if arguments is None else arguments))
        finally:
            if sys.stdout is not None:
                sys.stdout.flush()
    except KeyboardInterrupt:
        # One that comes while another is answered.
        print_error("interrupted")
        note_answered()
        return INTERRUPTED
    except BrokenPipeError:
        if not output_closed():
            raise
        discard_output()
        return BROKEN_PIPE
    except (OSError, MemoryError, ImportError, AttributeError, RuntimeError, ValueError) as error:
        reason = shortage(error) or refusal(error)
        if reason:
            print_error(reason)
            return 2
        if not isinstance(error, OSError) or error.errno not in DISK_ERRORS:
            raise
        discard_output()
        print_error(f"cannot write {error.filename or 'the results'}: {error.strerror or error}")
        return 2


def _run_safely(words: list[str]) -> int:
    """Run a command line; return its exit status, also for invalid input and an interrupt."""
    try:
        if words[:1] == [PLUGINS]:
            words = _import_plugins(words)
        if not words or words[0] in ("-h", "--help"):
            print_safe(overview())
            if words:
                return 0
            return 2
        if words[0] == "--version":
            import craftsim

            print_safe(f"craftsim {craftsim.__version__}")
            return 0
        if words[0] in (COMPLETION, COMPLETE_WORDS):
            return _complete(words)
        check_working_folder()
        return _run(words)
    except CraftsimError as error:
        print_error(error)
        return 2
    except (KeyboardInterrupt, ImportError) as error:
        if not is_interrupt(error):
            raise
        message = "interrupted"
        if isinstance(error, KeyboardInterrupt) and str(error):
            message = str(error)
        print_error(message)
        note_answered()
        return INTERRUPTED


def _complete(words: list[str]) -> int:
    from craftsim.cli.completion import print_values, script_of

    if words[0] == COMPLETE_WORDS:
        print_values(words[1:])
    else:
        print_safe(script_of(words[1:]))
    return 0


def _import_plugins(words: list[str]) -> list[str]:
    if len(words) < 3:
        raise InputError(
            f"{PLUGINS} needs modules and then a command: craftsim {PLUGINS} MODULE,... COMMAND"
        )
    for module in words[1].split(","):
        try:
            import_user_module(module)
        except CraftsimError:
            raise
        except (Exception, SystemExit) as error:
            raise InputError(
                f"{PLUGINS}: the module '{module}' cannot be imported: {type(error).__name__}: {error}"
            ) from error
    return words[2:]


def _run(words: list[str]) -> int:
    from craftsim.cli.app import COMMAND_LINE, FOLDER, bind, print_help, write_config

    if words[0] not in COMMANDS:
        commands = ", ".join(COMMANDS)
        raise InputError(
            f"no command '{words[0]}'{suggestion(words[0], COMMANDS)} (commands: {commands})"
        )
    if {"-h", "--help"} & {*words}:
        print_help(words)
        return 0
    function, bound = bind(words)
    if words[0] != "doctor":
        check_mujoco()
    _check_baseline(bound.arguments)
    COMMAND_LINE.set(tuple(words))
    FOLDER.set(None)
    try:
        status: int = function(*bound.args, **bound.kwargs)
    except (KeyboardInterrupt, ImportError) as error:
        if not is_interrupt(error) or (isinstance(error, KeyboardInterrupt) and str(error)):
            raise
        bound.apply_defaults()
        raise KeyboardInterrupt(_interrupted(bound.arguments)) from None
    write_config(words, function, bound, FOLDER.get())
    return status


def _check_baseline(arguments: Mapping[str, Any]) -> None:
    """Raise InputError for a baseline that is not there, before anything is compiled."""
    from craftsim.experiments.records import holds_run
    from craftsim.validation.options import Trials

    for value in arguments.values():
        if not isinstance(value, Trials) or value.baseline is None:
            continue
        baseline = Path(value.baseline)
        if not is_folder(baseline):
            raise InputError(
                f"{baseline} holds no run, for it is no folder; --baseline takes the folder of an earlier run"
            )
        if not holds_run(baseline):
            raise InputError(
                f"{baseline} holds no run; --baseline takes the folder of an earlier run"
            )


def _interrupted(arguments: Mapping[str, Any]) -> str:
    """Return the message of an interrupt about the run in the command's folder; empty for a command without one."""
    from craftsim.cli.app import FOLDER
    from craftsim.validation.options import Work

    out = arguments.get("out") or FOLDER.get()
    for value in arguments.values():
        if isinstance(value, Work) and out is not None:
            from craftsim.experiments.session import interrupted_text

            return interrupted_text(out, value.resume)
    return ""
