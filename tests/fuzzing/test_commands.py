"""Some hostile things in the place of what commands take; ``make fuzz ARGS=--commands`` tries them all."""

import re

import pytest

from craftsim.cli.app import _command, make_app
from craftsim.cli.commands import ALONE, BELOW, COMMANDS
from fuzzing.commands import SLOTS, forms, some_cases

EVERY = [[name] for name in COMMANDS if name not in ALONE]
EVERY += [[name, below] for name, others in BELOW.items() for below in others]
SAMPLED = 4
"""Every so many slots."""


def test_a_hostile_thing_ends_a_command_with_a_status_and_no_traceback(tmp_path):
    for number, case in enumerate(some_cases(SAMPLED)):
        (tmp_path / str(number)).mkdir()
        assert case.run(tmp_path / str(number)) == ""


def _paths(words) -> set[str]:
    """Return the options of a command that are paths, those in its groups of options included."""
    app = make_app()
    found, name = _command(app, words)
    with app.app_stack(name):
        takes = found.assemble_argument_collection()
    return {one.names[0] for one in takes if "Path" in str(one.hint) and one.index is None}


@pytest.mark.parametrize("words", EVERY, ids=" ".join)
def test_every_path_that_a_command_takes_is_attacked(words):
    attacked = [slot for slot in SLOTS if slot.split()[: len(words)] == words]
    assert attacked
    options = {option for slot in attacked for option in re.findall(r"(--[\w-]+) @", slot)}
    assert _paths(words) - options == set()


def test_forms_have_names_of_their_own():
    assert len(set(forms())) == len(forms())
