"""Some hostile things in the place of what commands take; ``make fuzz ARGS=--commands`` tries them all."""

import dataclasses
import importlib
import re
from typing import get_args, get_type_hints

import pytest

from craftsim import cli
from fuzzing.commands import SLOTS, forms, some_cases

SAMPLED = 4
"""Every so many slots."""


@pytest.mark.parametrize("case", some_cases(SAMPLED), ids=str)
def test_a_hostile_thing_ends_a_command_with_a_status_and_no_traceback(case, tmp_path):
    assert case.run(tmp_path) == ""


def _paths(command) -> set[str]:
    """Return the options of a command that are paths, those in its groups of options included."""
    found = set()
    for name, hint in get_type_hints(command, include_extras=True).items():
        groups = [hint, *get_args(hint)]
        for group in groups:
            found |= _paths(group) if isinstance(group, type) and dataclasses.is_dataclass(group) else set()
        if name != "return" and "Path" in str(hint) and "Positional" not in str(hint):
            found.add(f"--{name.replace('_', '-')}")
    return found


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_every_path_that_a_command_takes_is_attacked(name):
    command = getattr(importlib.import_module(f"craftsim.cli.{name}"), name)
    attacked = [slot for slot in SLOTS if slot.split()[0] == name]
    assert attacked
    words = {option for slot in attacked for option in re.findall(r"(--[\w-]+) @", slot)}
    assert _paths(command) - words == set()


def test_forms_have_names_of_their_own():
    assert len(set(forms())) == len(forms())
