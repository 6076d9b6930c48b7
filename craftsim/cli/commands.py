"""The commands, under their headings."""

from __future__ import annotations

import textwrap
from typing import Final

HEADINGS: Final[dict[str, dict[str, str]]] = {
    "Run": {
        "demo": "Build the paper's tasks in physics, check every action, film it.",
        "validate": "Run plans, policies or random play; judge every action.",
        "compare": "Compare two runs: two settings, two drives, simulation and lab.",
        "replay": "Re-run a recorded failure bit for bit; find its smallest world.",
    },
    "Check rules and physics": {
        "audit": "Try every action in every situation; margins, clearance.",
        "conformance": "Compare the grid rules with recordings of CraftEnv.",
        "reality": "Compare contacts and drives with recordings of real motion.",
    },
    "Worlds and plans": {
        "plan": "Find a plan for a building: order, cars and every move.",
        "design": "Write a design and its start: library, picture, mesh, random.",
        "show": "Show a world as coloured text; draw, film or export it.",
    },
    "Visualize": {
        "render": "Make films, pictures and figures of runs.",
        "view": "Show a recorded or live run in the browser.",
    },
    "Learn and tune": {
        "train": "Train a policy; train study: many tasks, algorithms and seeds.",
        "machine": "Write a file of your own machine; check what it can do.",
        "tune": "Tune the gains of skills, checked on held-out seeds.",
        "robot": "Serve simulated robots; excite and identify a car.",
    },
    "Computer": {
        "doctor": "Check physics, rendering and packages on this computer.",
        "bench": "Benchmark rules, environments and physics.",
    },
}
COMMANDS: Final[dict[str, str]] = {
    name: text for heading in HEADINGS.values() for name, text in heading.items()
}
"""One line for each command, in the order of the help."""
BELOW: Final[dict[str, dict[str, str]]] = {
    "audit": {
        "margins": "Search the largest imperfections at which actions work.",
        "clearance": "Compare swept volumes with what the rules forbid.",
    },
    "train": {"study": "Train over tasks, algorithms and seeds, with intervals."},
    "machine": {
        "new": "Write a file with every parameter, to be edited.",
        "check": "Compare a machine with what tasks need, before physics.",
    },
    "robot": {
        "serve": "Serve simulated robots on a network.",
        "excite": "Drive an excitation trajectory and log it.",
        "identify": "Fit a car's parameters, delays and biases to its log.",
    },
}
"""Subcommands."""
ALONE: Final = ("machine", "robot")
"""Commands that need a subcommand."""
MODULES: Final = {
    **dict.fromkeys(("new", "check"), "machine"),
    **dict.fromkeys(("margins", "clearance", "conformance"), "audit"),
    **dict.fromkeys(("plan", "design"), "show"),
    **dict.fromkeys(("serve", "excite", "identify"), "tune"),
    "compare": "replay",
    "view": "render",
    "study": "train",
    "doctor": "bench",
}
"""The module of a command, if it does not have its name."""


def overview() -> str:
    """Return the text of ``craftsim --help``."""
    lines = [
        "usage: craftsim COMMAND [OPTIONS]",
        "",
        "Cooperative construction with smartcars, on a grid and in contact physics.",
    ]
    for heading, commands in HEADINGS.items():
        lines += ["", heading]
        lines += [f"  {name:<12}{text}" for name, text in commands.items()]
    subcommands: list[str] = []
    for name, summaries in BELOW.items():
        subcommands += [f"{name} {subcommand}" for subcommand in summaries]
    lines.append("")
    lines += textwrap.wrap(f"Subcommands: {', '.join(subcommands)}.", 79)
    lines += [
        "",
        "craftsim COMMAND --help           shows the help of a command",
        "craftsim COMMAND --config FILE    repeats a run from its config.yaml",
        "craftsim --plugins MODULE,... ... imports user modules first",
        "craftsim completion bash|zsh|fish prints a script for tab completion",
        "craftsim --version                prints the version",
    ]
    return "\n".join(lines)
