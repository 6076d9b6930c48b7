"""The command line: ``craftsim COMMAND``.

A command is one function of the command's name in ``craftsim/commands/NAME.py``; its typed parameters become
options and its integer result the exit status. It is imported only when it is called.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from typing import Final

COMMANDS: Final[dict[str, str]] = {
    "demo": "Build the paper's tasks in physics, and check every action.",
    "trials": "Try every action in every situation where it is legal, in physics.",
    "replay": "Do again what a replay bundle shows, and compare it with what was recorded.",
    "tasks": "Build the paper's tasks again and again, all cars at work at once.",
    "episodes": "Run long random episodes with many cars, to see whether anything drifts.",
    "train": "Let cars learn a task on the grid, with TorchRL.",
    "audit": "Try the rules in physics: which allow what does not work, which forbid what would?",
    "validate": "Run plans, actions or policies in physics, and check each action.",
    "doctor": "Say what works on this machine, and the command that mends what does not.",
    "show": "Show a blueprint as coloured text, and as a picture with --out.",
    "conformance": "Compare the rules with recordings of CraftEnv.",
    "bench": "Measure how fast the rules and the environments run.",
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

    from craftsim.discrete.errors import DISK_ERRORS, CraftsimError, InputError, suggestion

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
    status: int = tyro.cli(function, args=words, prog=f"craftsim {name}")
    return status


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
