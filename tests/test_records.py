"""Records: what their annotations do not allow is refused, however one is made, and all mistakes are told together."""

import pickle
from dataclasses import replace
from typing import Annotated, NamedTuple

import pytest

from craftsim.errors import InputError
from craftsim.storage.limits import JSON_VALUES, Range
from craftsim.storage.records import Listed, from_json, record, to_json


class Place(NamedTuple):
    x: int
    y: int = 0


@record()
class Wheel:
    radius_m: Annotated[float, Range(0, 0.2, above=True)]
    teeth: Annotated[int, Range(3)] = 8

    def __post_init__(self) -> None:
        if self.teeth * self.radius_m > 1:
            raise ValueError("teeth do not fit")

    @property
    def width_m(self) -> float:
        return 0.5 * self.radius_m


@record(kw_only=True)
class Car:
    wheels: Listed[Wheel]
    place: Place = Place(1)


def told(make):
    with pytest.raises(InputError) as caught:
        make()
    return str(caught.value).splitlines()


def test_one_made_in_python_is_held_to_its_annotations():
    assert Wheel(0.1).teeth == 8
    assert told(lambda: Wheel(0.0, True)) == [
        "Wheel.radius_m: 0.0 is out of range, allowed: above 0 and at most 0.2",
        "Wheel.teeth: must be an integer of at least 3, not 'True'",
    ]
    assert told(lambda: replace(Wheel(0.1), teeth=2)) == [
        "Wheel.teeth: 2 is out of range, allowed: at least 3"
    ]
    assert told(lambda: Wheel(0.2, 9)) == ["Wheel: teeth do not fit"]
    assert told(lambda: Wheel(float("nan"))) == [
        "Wheel.radius_m: must be a finite number above 0 and at most 0.2, not 'nan'"
    ]


def test_what_is_written_is_read_again_and_copies_are_equal():
    car = Car(wheels=(Wheel(0.1), Wheel(0.05, 9)), place=Place(2, 3))
    assert from_json(Car, to_json(car), "car.json") == car == pickle.loads(pickle.dumps(car))


def test_mistakes_in_json_are_told_with_their_keys():
    for text, lines in (
        ('{"wheels": [{"radius_m": 0.2, "teeth": 9}]}', ["key 'wheels[0]': teeth do not fit"]),
        ('{"wheels": [], "place": {"y": 1}}', ["key 'place': needs 'x'; required: x"]),
        (
            '{"wheels": [{"radius_m": 0.1, "width_m": 1}], "plac": 0}',
            [
                "key 'wheels[0].width_m': is not given but follows from other parameters; change those",
                "unknown key 'plac'; did you mean 'place'?; allowed: wheels, place",
            ],
        ),
        (
            '{"wheels": {"\\u001b[31m": 1}}',
            ["key 'wheels': must be a list of entries, not a mapping"],
        ),
        ('{"wheels": [{"\\u001b[31m": 1, "radius_m": 0.1}]}', None),
        ("[]", ["key 'document': must be a mapping with keys wheels, place, not a list"]),
        (
            f'{{"wheels": [{"0," * (JSON_VALUES + 1)}0]}}',
            [f"holds more than the {JSON_VALUES} values that are allowed"],
        ),
    ):
        found = told(lambda text=text: from_json(Car, text.encode(), "car.json"))
        if lines is None:  # What would steer a terminal is not repeated.
            assert found == [
                "car.json: key 'wheels[0]': unknown key '\\x1b[31m'; allowed: radius_m, teeth"
            ]
        else:
            assert found == [f"car.json: {line}" for line in lines]


def test_a_long_list_is_read_up_to_its_first_mistake():
    text = '{"wheels": [' + ",".join(['{"radius_m": -1}'] * 10_000) + "]}"
    assert told(lambda: from_json(Car, text.encode(), "car.json")) == [
        "car.json: key 'wheels[0].radius_m': -1 is out of range, allowed: above 0 and at most 0.2"
    ]
