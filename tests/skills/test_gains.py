"""Gains come from a file that a tuner can write; what is wrong with one is said by file and key."""

import ast
import inspect
import re
import textwrap
from dataclasses import asdict, fields, replace
from pathlib import Path

import pytest
import yaml

from craftsim.errors import InputError
from craftsim.skills.gains import PRESETS, SECTIONS, careful, load_gains


def _file(folder: Path, text: str) -> Path:
    path = folder / "own.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_partial_file_overrides_its_keys_alone(tmp_path):
    nominal = load_gains()
    own = load_gains(_file(tmp_path, "drive: {position_gain: 7.5}\nhinge: {gain: 2}\n"))
    assert own.drive == replace(nominal.drive, position_gain=7.5)
    assert own.board == nominal.board
    assert own.hinge == replace(nominal.hinge, gain=2)


def test_equal_gains_are_equal_wherever_they_came_from_and_what_is_written_can_be_read_again(
    tmp_path,
):
    nominal = load_gains()
    same = load_gains(_file(tmp_path, "drive: {position_gain: 10.0}\n"))
    assert (same, hash(same), same.digest) == (nominal, hash(nominal), nominal.digest)
    own = replace(nominal, drive=replace(nominal.drive, integral_gain=0.123456789012345))
    assert own.digest != nominal.digest
    assert load_gains(_file(tmp_path, yaml.safe_dump(asdict(own)))) == own


def test_gains_may_stand_beside_the_figures_of_machines(tmp_path):
    path = _file(
        tmp_path, "slope: {hinge_speed_rad_s: 1.0}\ngains:\n  drive: {position_gain: 7.5}\n"
    )
    assert load_gains(path).drive.position_gain == 7.5
    assert load_gains(path).source == str(path)
    assert load_gains(_file(tmp_path, "slope: {hinge_speed_rad_s: 1.0}")) == load_gains()


def test_every_gain_says_what_it_is_and_has_a_nominal_value():
    for name, kind in SECTIONS.items():
        tree = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
        assert [f.name for f in fields(kind)] == list(asdict(getattr(load_gains(), name)))
        assert ast.get_docstring(tree), name


def test_a_wrong_file_is_refused_by_file_and_key(tmp_path):
    for text, message in (
        ("driv: {}", "unknown key 'driv'; did you mean 'drive'?"),
        ("drive: {position_gian: 1}", "unknown key 'position_gian'; did you mean 'position_gain'?"),
        ("board: {gain: 0}", "key 'board.gain': 0 is out of range, allowed: above 0"),
        ("hinge: {gain: .nan}", "key 'hinge.gain': must be a number above 0, not '.nan'"),
        ("hinge:", "key 'hinge': must be a mapping with keys gain, acceleration"),
        ("drive: {gain: 1}\ngains: {}", "gains stand both at the top and under 'gains'"),
        (
            "gains: {hinge: {gain: -1}}",
            "key 'gains.hinge.gain': -1 is out of range, allowed: above 0",
        ),
    ):
        path = _file(tmp_path, text)
        with pytest.raises(InputError) as caught:
            load_gains(path)
        assert re.match(rf"{re.escape(str(path))}:\d+: {re.escape(message)}", str(caught.value))


def test_robust_is_the_default_as_fast_as_fast_unless_it_drives_carefully():
    fast, robust = load_gains("fast"), load_gains("robust")
    assert robust == load_gains()
    limits = [f.name for f in fields(robust.uneven) if hasattr(robust.drive, f.name)]
    for name in limits:
        assert getattr(robust.drive, name) == getattr(fast.drive, name), name
        assert getattr(careful(robust).drive, name) < getattr(fast.drive, name), name
    kept = {name: getattr(robust.drive, name) for name in limits}
    assert replace(careful(robust).drive, **kept) == robust.drive
    assert fast.uneven.tilt > fast.hold.level, "it never feels that"
    assert [load_gains(name).source for name in PRESETS] == list(PRESETS)


def test_an_unknown_preset_is_refused_with_the_known_ones():
    with pytest.raises(
        InputError, match=r"unknown gains 'fsat'; did you mean 'fast'\?; there are robust, fast"
    ):
        load_gains("fsat")
