"""The command line: ``craftsim COMMAND``.

A command is one function of the command's name in ``craftsim/commands/NAME.py``; its typed parameters become
options and its integer result the exit status. It is imported only when it is called.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import sys
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Final, get_type_hints

COMMANDS: Final[dict[str, str]] = {
    "demo": "Build the paper's tasks in physics, and check every action.",
    "validate": "Run plans, actions or policies in physics, and judge each action.",
    "audit": "Try in physics what the rules allow, and what they forbid.",
    "clearance": "Compare what each action sweeps with what the rules forbid.",
    "replay": "Re-run a recorded failure bit for bit, and compare the two.",
    "train": "Let cars learn a task on the grid.",
    "conformance": "Compare the grid rules with recordings of CraftEnv.",
    "bench": "Measure how fast rules, environments and workers are.",
    "show": "Show a world as coloured text, and as a picture with --out.",
    "doctor": "Say what works on this machine, and what fixes what does not.",
}
"""One line on every command, in the order of the help text."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status: what it says, 2 for wrong input, 130 when interrupted.

    Args:
        arguments: words after ``craftsim``; those of this process if None.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if not words or words[0] in ("-h", "--help"):
        print(_overview())
        return 0 if words else 2
    if words[0] == "--version":
        import craftsim

        print(f"craftsim {craftsim.__version__}")
        return 0

    from craftsim.errors import DISK_ERRORS, CraftsimError, InputError, suggestion

    name = words[0]
    try:
        if name not in COMMANDS:
            raise InputError(
                f"no command '{name}'{suggestion(name, COMMANDS)} (commands: {', '.join(COMMANDS)})"
            )
        return _run(name, words[1:])
    except CraftsimError as error:
        print(f"craftsim: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        if error.errno not in DISK_ERRORS:
            raise
        print(f"craftsim: cannot write {error.filename or 'the results'}: {error.strerror}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as interrupt:
        print(f"craftsim: {str(interrupt) or 'interrupted'}", file=sys.stderr)
        return 130


def _run(name: str, words: list[str]) -> int:
    import tyro

    function = getattr(importlib.import_module(f"craftsim.commands.{name}"), name)
    status: int = tyro.cli(
        _with_checked_seed(_without_empty_defaults(function)),
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
    function.__annotations__ = types
    return function


def _with_checked_seed(function: Callable[..., int]) -> Callable[..., int]:
    """Refuse a seed that no random generator takes, before the command begins."""
    from craftsim.errors import InputError

    @functools.wraps(function)
    def checked(*arguments: Any, **options: Any) -> int:
        for seed in [options.get("seed", 0), *(getattr(group, "seed", 0) for group in options.values())]:
            if seed < 0:
                raise InputError(f"--seed is {seed}; allowed: 0 or more")
        return function(*arguments, **options)

    return checked


def _overview() -> str:
    width = max(map(len, COMMANDS))
    return "\n".join(
        [
            "usage: craftsim [--help] [--version] COMMAND ...",
            "",
            *(f"  {name:<{width}}  {summary}" for name, summary in COMMANDS.items()),
            "",
            "'craftsim COMMAND --help' explains a command's options.",
        ]
    )


if __name__ == "__main__":
    sys.exit(main())
