"""Gains come from a file that a tuner can write; what is wrong with one is said by file and key."""

from dataclasses import asdict, replace
from pathlib import Path

import pytest
import yaml

from craftsim.discrete.errors import InputError
from craftsim.skills.gains import load_gains


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


def test_an_empty_file_gives_the_nominal_gains(tmp_path):
    assert load_gains(_file(tmp_path, "# nothing yet\n")) == load_gains()


def test_gains_know_their_file(tmp_path):
    path = _file(tmp_path, "board: {gain: 3}\n")
    assert load_gains(path).source == str(path)
    assert load_gains().source == "nominal"


def test_equal_gains_are_equal_and_hash_alike_wherever_they_came_from(tmp_path):
    path = _file(tmp_path, "drive: {position_gain: 10.0}\n")
    assert load_gains(path) == load_gains()
    assert hash(load_gains(path)) == hash(load_gains())


def test_what_is_written_from_gains_can_be_read_again(tmp_path):
    gains = replace(load_gains(), drive=replace(load_gains().drive, integral_gain=0.123456789012345))
    sections = {name: values for name, values in asdict(gains).items() if name != "source"}
    assert load_gains(_file(tmp_path, yaml.safe_dump(sections))) == gains


def test_a_dump_of_the_whole_dataclass_can_be_read_again(tmp_path):
    assert load_gains(_file(tmp_path, yaml.safe_dump(asdict(load_gains())))) == load_gains()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("driv: {}", "unknown section 'driv'; did you mean 'drive'?"),
        ("drive: {position_gian: 1}", "unknown gain drive.position_gian; did you mean 'position_gain'?"),
        ("board: {gain: 0}", "board.gain must be a positive number, not 0"),
        ("board: {gain: -2.5}", "board.gain must be a positive number, not -2.5"),
        ("hinge: {gain: .nan}", "hinge.gain must be a positive number, not nan"),
        ("hinge: {gain: .inf}", "hinge.gain must be a positive number, not inf"),
        ("hinge: {gain: fast}", "hinge.gain must be a positive number, not 'fast'"),
        ("hinge: {gain: true}", "hinge.gain must be a positive number, not True"),
        ("hinge: {gain: }", "hinge.gain must be a positive number, not None"),
        ("hinge: [1, 2]", "hinge must hold the keys gain, acceleration"),
        ("hinge:", "hinge must hold the keys gain, acceleration"),
        ("- 1", "expected the sections drive, board, hinge"),
        ("drive: {gain: 1", "not YAML"),
        ("drive: {1: 2}", "unknown gain drive.1"),
        ("drive: {max_speed: 2020-13-01}", "not YAML"),
    ],
)
def test_a_wrong_file_is_refused_by_file_and_key(tmp_path, text, message):
    path = _file(tmp_path, text)
    with pytest.raises(InputError) as caught:
        load_gains(path)
    assert str(caught.value).startswith(f"{path}: {message}")


def test_bytes_that_are_no_text_are_refused(tmp_path):
    path = tmp_path / "own.yaml"
    path.write_bytes(b"drive: \xff\xfe")
    with pytest.raises(InputError, match=r"own\.yaml: not YAML"):
        load_gains(path)


def test_a_missing_file_is_refused_by_name(tmp_path):
    path = tmp_path / "none.yaml"
    with pytest.raises(InputError, match="cannot be read") as caught:
        load_gains(path)
    assert str(path) in str(caught.value)
