"""YAML files held to a type: what is read, what is written, and what mistakes say."""

from pathlib import Path
from typing import Annotated, Any, Literal

import pytest

from craftsim.errors import InputError
from craftsim.storage.limits import Range
from craftsim.storage.records import record
from craftsim.storage.yaml import dump, parse_document


@record(kw_only=True)
class Wheel:
    radius_m: Annotated[float, Range(0.01, 0.2)]
    side: Literal["left", "right"] = "left"


@record(kw_only=True)
class Machine:
    wheels: tuple[Wheel, ...]
    cars: Annotated[int, Range(0, 4)] = 0
    name: str | None = None
    other: Any = None


def machine(text):
    return parse_document(text, Path("m.yaml")).to(Machine)


def test_a_document_becomes_its_type_and_documents_are_merged():
    read = machine(
        "wheels: [{radius_m: 0.1, side: right}, {radius_m: .05}]\n---\ncars: 3\nname: '3'\n"
    )
    assert read == Machine(
        wheels=(Wheel(radius_m=0.1, side="right"), Wheel(radius_m=0.05)), cars=3, name="3"
    )
    plain = parse_document("a: 1\nb: 1e3\nc: ~\nd: '1'\ne: 007\nf: {g: [x]}", Path("a")).plain
    assert plain == {"a": 1, "b": 1000.0, "c": None, "d": "1", "e": "007", "f": {"g": ["x"]}}


def test_a_single_mistake_is_one_line_with_file_line_key_and_what_is_allowed():
    for text, message in (
        ("wheels: []\ncars: 5", "m.yaml:2: key 'cars': 5 is out of range, allowed: 0 to 4"),
        (
            "wheels: []\ncars: 1.0",
            "m.yaml:2: key 'cars': must be an integer from 0 to 4, not '1.0'",
        ),
        (
            "wheels:\n  - radius_m: 1e300",
            "m.yaml:2: key 'wheels[0].radius_m': 1e+300 is out of range, allowed: 0.01 to 0.2",
        ),
        ("wheels: {}", "m.yaml:1: key 'wheels': must be a list of entries, not a mapping"),
        (
            "wheels: [7]",
            "m.yaml:1: key 'wheels[0]': must be a mapping with keys radius_m, side, not '7'",
        ),
        (
            "wheels: [{radius_m: 0.1, side: lefft}]",
            "m.yaml:1: key 'wheels[0].side': unknown value 'lefft'; did you mean 'left'?; allowed: left, right",
        ),
        (
            "wheels: [{radius_m: 0.1, side: []}]",
            "m.yaml:1: key 'wheels[0].side': must be one of left, right, not a list",
        ),
        ("wheels: []\nname: 3", "m.yaml:2: key 'name': must be a text, not '3'"),
        (
            "wheel: []",
            "m.yaml:1: unknown key 'wheel'; did you mean 'wheels'?; allowed: wheels, cars, name, other",
        ),
        ("cars: 1", "m.yaml: key 'wheels' is missing; required: wheels"),
        ("wheels: []\nwheels: []", "m.yaml:2: key 'wheels': given twice, first in line 1"),
        ("[a]: 1", "m.yaml:1: a key must be a word, not a list"),
    ):
        with pytest.raises(InputError) as caught:
            machine(text)
        assert str(caught.value) == message


def test_of_many_mistakes_the_first_five_are_told_in_the_order_of_the_file():
    with pytest.raises(InputError) as caught:
        machine("wheels:\n" + "  - {side: left}\n" * 9 + "cars: -1\n")
    lines = str(caught.value).splitlines()
    assert lines[0] == "m.yaml:2: key 'wheels[0]': needs 'radius_m'; required: radius_m"
    assert [line.split(": ")[0] for line in lines] == [
        *(f"m.yaml:{i}" for i in range(2, 7)),
        "m.yaml",
    ]
    assert lines[-1] == "m.yaml: and more"


def test_what_is_allowed_in_a_mapping_is_told_once():
    with pytest.raises(InputError) as caught:
        machine("wheels: []\ncar: 1\nnam: x\n")
    assert str(caught.value).splitlines() == [
        "m.yaml:2: unknown key 'car'; did you mean 'cars'?; allowed: wheels, cars, name, other",
        "m.yaml:3: unknown key 'nam'; did you mean 'name'?",
    ]


def test_what_is_written_is_read_again():
    plain = {
        "n": 2,
        "list": [{"id": 0, "x": 1}, {"id": 1, "x": 2}],
        "more": {"top": [{"x": 3}]},
        "none": {},
    }
    text = dump(plain)
    assert text.startswith("n: 2\nlist:\n  - {id: 0, x: 1}\n")
    assert parse_document(text, Path("a")).plain == plain
