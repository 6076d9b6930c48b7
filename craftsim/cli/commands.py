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
    "Check the rules": {
        "audit": "Try every action in every situation; audit margins, clearance.",
        "conformance": "Compare the grid rules with recordings of CraftEnv.",
    },
    "Worlds and plans": {
        "plan": "Find a plan for a building: order, cars and every move.",
        "design": "Write a design and its start: library, picture, mesh, random.",
        "show": "Show a world as coloured text; draw, film or export it.",
    },
    "See": {
        "render": "Make films, pictures and figures of what happened in physics.",
        "view": "Watch a recorded run or a running one in the browser.",
    },
    "Learn and tune": {
        "train": "Train a policy; train study: tasks, algorithms and seeds.",
        "tune": "Tune the gains of skills by objectives, on held-out seeds.",
        "robot": "Serve simulated robots; excite and identify a car.",
    },
    "This machine": {
        "doctor": "Say what works on this machine, and what fixes what does not.",
        "bench": "Measure how fast rules, environments and physics are.",
    },
}
COMMANDS: Final[dict[str, str]] = {
    name: text for heading in HEADINGS.values() for name, text in heading.items()
}
"""One line on every command, in the order of the help text."""
BELOW: Final[dict[str, dict[str, str]]] = {
    "audit": {
        "margins": "Search by how much imperfections may grow until actions fail.",
        "clearance": "Compare what each action sweeps with what the rules forbid.",
    },
    "train": {"study": "Train over tasks, algorithms and seeds; with intervals."},
    "robot": {
        "serve": "Simulate robots on a network, for skills elsewhere to drive.",
        "excite": "Drive a car so that its log tells much about it.",
        "identify": "Fit a car's parameters, delays and biases to its log.",
    },
}
"""Commands below a command."""
ALONE: Final = ("robot",)
"""Commands that do nothing without one below them."""
MODULES: Final = {
    "compare": "replay",
    "margins": "audit",
    "clearance": "audit",
    "conformance": "audit",
    "plan": "show",
    "design": "show",
    "view": "render",
    "study": "train",
    "serve": "robot",
    "excite": "tune",
    "identify": "tune",
    "doctor": "bench",
}
"""Where a command stands, if not in the module of its name."""


def overview() -> str:
    """Return what ``craftsim --help`` says: each heading's commands with one line on each."""
    lines = [
        "usage: craftsim COMMAND [OPTIONS]",
        "",
        "Small robots that build: on a grid, and in contact physics.",
    ]
    for heading, commands in HEADINGS.items():
        lines += ["", heading, *(f"  {name:<12}{text}" for name, text in commands.items())]
    below_them = ", ".join(f"{name} {one}" for name, others in BELOW.items() for one in others)
    return "\n".join(
        [
            *lines,
            *("", *textwrap.wrap(f"Commands below a command: {below_them}.", 79)),
            *("", "craftsim COMMAND --help           explains a command"),
            "craftsim COMMAND --config FILE    repeats a run: each writes its config.yaml",
            "craftsim --plugins MODULE,... ... imports modules first that register something",
            "craftsim completion bash|zsh|fish prints what completes words at the tab key",
            "craftsim --version                says which craftsim this is",
        ]
    )
