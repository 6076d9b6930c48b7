"""The command line on a report's page asks for the same again."""

import functools
import importlib
import shlex
from dataclasses import fields, is_dataclass
from inspect import signature

import pytest
import tyro

from craftsim.cli.again import NO_MATTER, command_again

PHYSICS = (
    "--skills mine:SKILLS --noise n.yaml --assume mild --gains g.yaml --parameters p.yaml --drive reduced --seed 7 "
    "--trials 3 --workers 2 "
    "--engine ray --against old --resume --record --shrink --out elsewhere"
)
EVERYTHING = {
    "validate": "'a world.yaml' strip --plan a.plan --actions b.txt --policy play random --order concurrent "
    "--rules published --randomize strong --cars 3 --blocks 4 --max-steps 20 --timeout 12.5 --video all "
    + PHYSICS,
    "audit": "--actions MOVE LIFT --contexts '*room=tight' --only legal --quick --rules physical --randomize none "
    "--video " + PHYSICS,
}
"""All options of each command that says on its page how it was asked, none at its default."""


def _function(command):
    return getattr(importlib.import_module(f"craftsim.cli.{command}"), command)


def _asked(function, words):
    """Return the arguments with which the command line calls a command."""
    given = {}

    @functools.wraps(function)
    def note(**arguments):
        given.update(arguments)

    tyro.cli(note, args=words, config=(tyro.conf.DisallowNone,))
    return given


def _flat(given):
    """Return all options by name, those of groups included."""
    flat = {}
    for name, value in given.items():
        if is_dataclass(value):
            flat |= {field.name: getattr(value, field.name) for field in fields(value)}
        else:
            flat[name] = value
    return flat


@pytest.mark.parametrize("command", EVERYTHING)
def test_a_command_line_asks_for_the_same_again_whatever_was_asked(command):
    function = _function(command)
    asked = _asked(function, shlex.split(EVERYTHING[command]))
    usual = _flat({name: parameter.default for name, parameter in signature(function).parameters.items()})
    assert [name for name, value in _flat(asked).items() if value == usual[name]] == [], (
        "an option is not tried"
    )
    program, name, *words = shlex.split(command_again(function, asked))
    assert (program, name) == ("craftsim", command)
    assert _flat(_asked(function, words)) == _flat(asked) | {name: usual[name] for name in NO_MATTER}


@pytest.mark.parametrize("command", EVERYTHING)
def test_a_command_line_leaves_out_what_was_not_asked(command):
    function = _function(command)
    assert command_again(function, _asked(function, [])) == f"craftsim {command}"
