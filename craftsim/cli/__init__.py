"""The command line: ``craftsim COMMAND``.

A command is one function of the command's name in ``craftsim/cli/NAME.py``; its typed parameters become
options and its integer result the exit status. It is imported only when it is called.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import inspect
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, Any, Final, get_args, get_type_hints

from craftsim.cli.text import complain, drop_output, reader_is_gone, say, show_what_can_be_shown
from craftsim.compiling import tell
from craftsim.errors import DISK_ERRORS, CraftsimError, InputError, suggestion
from craftsim.modules import import_own, safe_path
from craftsim.storage.limits import Range
from craftsim.storage.paths import check_working_folder

PLUGINS: Final = "--plugins"
"""Comes before the command, with modules of one's own to import first, divided by commas."""
BROKEN_PIPE: Final = 141
"""What a shell says of a process that SIGPIPE ended."""

COMMANDS: Final[dict[str, str]] = {
    "demo": "Build the paper's tasks in physics, and check every action.",
    "validate": "Run plans, actions or policies in physics, and judge each action.",
    "plan": "Find a plan for a building: order, cars and every move.",
    "build": "Plan, build in physics, and plan again where it went wrong.",
    "audit": "Try in physics what the rules allow, and what they forbid.",
    "tune": "Tune the gains of skills by objectives, judged on seeds held out.",
    "margins": "Search by how much imperfections may grow until actions fail.",
    "compare": "Compare a simulation with reality, or two runs of the same plans.",
    "clearance": "Compare what each action sweeps with what the rules forbid.",
    "replay": "Re-run a recorded failure bit for bit, and compare the two.",
    "render": "Make films and pictures of what happened in physics.",
    "plot": "Draw paths, errors, torques and forces of recorded runs.",
    "view": "Watch a recorded run or a running one in the browser.",
    "excite": "Drive a car so that its log tells much about it.",
    "identify": "Fit a car's figures, delays and biases to its log.",
    "robot": "Simulate robots on a network, for skills elsewhere to drive.",
    "train": "Let cars learn a task on the grid.",
    "study": "Train over tasks, algorithms and seeds; with intervals.",
    "evaluate": "Play trained policies, from held-out starts too.",
    "export": "Write episodes of a plan or a policy as a Minari dataset.",
    "conformance": "Compare the grid rules with recordings of CraftEnv.",
    "bench": "Measure how fast rules, environments and workers are.",
    "design": "Write a design and its start: library, picture, mesh, random.",
    "show": "Show a world as coloured text, and as a picture with --out.",
    "doctor": "Say what works on this machine, and what fixes what does not.",
}
"""One line on every command, in the order of the help text."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status: what it says, 2 for wrong input, 130 when interrupted.

    It is 141, as if ended by SIGPIPE, where what reads the output has gone.

    Args:
        arguments: words after ``craftsim``; those of this process if None.
    """
    show_what_can_be_shown()
    tell()
    try:
        try:
            with safe_path():
                return _answer(list(sys.argv[1:] if arguments is None else arguments))
        finally:
            if sys.stdout is not None:
                sys.stdout.flush()
    except BrokenPipeError:
        if not reader_is_gone():
            raise
        drop_output()
        return BROKEN_PIPE
    except OSError as error:
        if error.errno not in DISK_ERRORS:
            raise
        drop_output()
        complain(f"cannot write {error.filename or 'the results'}: {error.strerror or error}")
        return 2


def _answer(words: list[str]) -> int:
    if not words or words[0] in ("-h", "--help"):
        print(_overview())
        return 0 if words else 2
    if words[0] == "--version":
        import craftsim

        say(f"craftsim {craftsim.__version__}")
        return 0
    try:
        if words[0] == PLUGINS:
            words = _import_plugins(words)
        name = words[0]
        if name not in COMMANDS:
            raise InputError(
                f"no command '{name}'{suggestion(name, COMMANDS)} (commands: {', '.join(COMMANDS)})"
            )
        check_working_folder()
        return _run(name, words[1:])
    except CraftsimError as error:
        complain(error)
        return 2
    except KeyboardInterrupt as interrupt:
        complain(str(interrupt) or "interrupted")
        return 130
    except ImportError as error:
        # Of a Ctrl-C during its import an extension module such as MuJoCo's makes an error of its own.
        if not any(isinstance(cause, KeyboardInterrupt) for cause in _causes(error)):
            raise
        complain("interrupted")
        return 130


def _import_plugins(words: list[str]) -> list[str]:
    """Import the modules that register something, and return the words of the command."""
    if len(words) < 3:
        raise InputError(f"{PLUGINS} needs modules and then a command: craftsim {PLUGINS} MODULE,... COMMAND")
    for module in words[1].split(","):
        try:
            import_own(module)
        except CraftsimError:
            raise
        except (Exception, SystemExit) as error:
            raise InputError(
                f"{PLUGINS}: the module '{module}' cannot be imported: {type(error).__name__}: {error}"
            ) from error
    return words[2:]


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def _run(name: str, words: list[str]) -> int:
    import tyro

    function = getattr(importlib.import_module(f"craftsim.cli.{name}"), name)
    status: int = tyro.cli(
        _with_checked_numbers(_without_empty_defaults(function)),
        args=words,
        prog=f"craftsim {name}",
        config=(tyro.conf.DisallowNone,),
    )
    return status


def _without_empty_defaults(function: Callable[..., int]) -> Callable[..., int]:
    """Mark what need not be given such that the help does not say "(default: None)"."""
    import tyro

    types = get_type_hints(function, include_extras=True)
    unsaid = tyro.conf.arg(help_behavior_hint="")
    for name, parameter in inspect.signature(function).parameters.items():
        if parameter.default in (None, ()):
            types[name] = Annotated[types[name], unsaid]
    # Of the command itself, which tyro looks at, whatever it is decorated with.
    inspect.unwrap(function).__annotations__ = types
    return function


def _with_checked_numbers(function: Callable[..., int]) -> Callable[..., int]:
    """Refuse a number outside of the range in its annotation before the command begins."""

    @functools.wraps(function)
    def checked(*arguments: Any, **options: Any) -> int:
        given = inspect.signature(function).bind(*arguments, **options).arguments
        for group in (given, *filter(dataclasses.is_dataclass, given.values())):
            for name, allowed in ranges_of(function if group is given else type(group)).items():
                value = given.get(name) if group is given else getattr(group, name)
                for number in value if isinstance(value, tuple) else (value,):
                    if number is not None:
                        allowed.check(f"--{name.replace('_', '-')}", number)
        return function(*arguments, **options)

    return checked


def ranges_of(options: Callable[..., Any]) -> dict[str, Range]:
    """Return, by name, what the numbers of a function, or of a class of options, may be."""
    types = get_type_hints(options, include_extras=True)
    return {name: found for name, one in types.items() if (found := _range(one)) is not None}


def _range(annotation: Any) -> Range | None:
    """Return the range within an annotation, such as ``Annotated[int, SEED] | None``."""
    if isinstance(annotation, Range):
        return annotation
    return next(filter(None, map(_range, get_args(annotation))), None)


def _overview() -> str:
    width = max(map(len, COMMANDS))
    return "\n".join(
        [
            "usage: craftsim [--help] [--version] [--plugins MODULE,...] COMMAND ...",
            "",
            *(f"  {name:<{width}}  {summary}" for name, summary in COMMANDS.items()),
            "",
            "'craftsim COMMAND --help' explains a command's options.",
            "--plugins imports modules of your own first, which register actions or tasks.",
        ]
    )
