"""Some damaged files of every format, and some hostile things that commands take; ``fuzz.py`` tries many more."""

import json
import re
from contextlib import suppress

import numpy as np
import pytest

from craftsim.cli import main
from craftsim.cli.app import _command, make_app
from craftsim.cli.commands import ALONE, BELOW, COMMANDS
from fuzzing.commands import SLOTS, some_cases
from fuzzing.damage import change
from fuzzing.formats import FORMATS
from fuzzing.fuzz import attack

EVERY = [[name] for name in COMMANDS if name not in ALONE]
EVERY += [[name, below] for name, others in BELOW.items() for below in others]
SAMPLED = 6
"""Every so many slots."""
ODD = ("-1", str(2**99), "nan", "-inf", "1e400", "9" * 9000, "", "x", "1__0", "\udce9", "\x1b[0m")


@pytest.mark.parametrize("name", FORMATS)
def test_a_damaged_file_is_read_or_refused_with_our_own_error(name):
    outcome = attack(name, 0, FORMATS[name].cases, seed=1)
    assert outcome.failures == []
    # Some files survive: damage that is always seen at once would test little.
    assert 0 < outcome.refused < outcome.cases


def test_damage_does_not_depend_on_earlier_damage():
    def repeatable() -> str:
        return json.dumps([_changed([number]) for number in range(60)], default=str)

    first = repeatable()
    for number in range(400):
        _changed([number, 1])
    assert repeatable() == first


def _changed(seed: list[int]) -> list:
    document, rng = [{"a": [1, {"b": 2}]}, [3]], np.random.default_rng(seed)
    for _ in range(8):
        with suppress(TypeError, ValueError, OverflowError):
            change(document, rng)
    return document


def test_a_hostile_thing_ends_a_command_with_a_status_and_no_traceback(tmp_path):
    for number, case in enumerate(some_cases(SAMPLED)):
        (tmp_path / str(number)).mkdir()
        assert case.run(tmp_path / str(number)) == ""


@pytest.mark.parametrize(
    "words", ["show strip --seed", "bench rules --worlds", "validate strip --timeout"]
)
def test_a_number_that_a_command_does_not_take_is_refused_however_it_is_written(words, capfd):
    for odd in ODD:
        try:
            status = main([*words.split(), odd])
        except SystemExit as error:  # a word that is no number at all
            status = error.code
        assert status == 2, odd


def _paths(words) -> set[str]:
    """Return the options of a command that are paths, those in its groups of options included."""
    app = make_app()
    found, name = _command(app, words)
    with app.app_stack(name):
        takes = found.assemble_argument_collection()
    return {one.names[0] for one in takes if "Path" in str(one.hint) and one.index is None}


def test_every_path_that_a_command_takes_is_attacked():
    for words in EVERY:
        attacked = [slot for slot in SLOTS if slot.split()[: len(words)] == words]
        options = {option for slot in attacked for option in re.findall(r"(--[\w-]+) @", slot)}
        assert attacked, words
        assert _paths(words) - options == set(), words
