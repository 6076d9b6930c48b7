"""Machines come from a file that a person writes; what is wrong with one is said by file, line and figure."""

import re
from pathlib import Path

import pytest

from craftsim.errors import InputError
from craftsim.mjcf.parameters import (
    NOMINAL,
    BlockParameters,
    SlopeParameters,
    SmartcarParameters,
    load_machines,
)


def _file(folder: Path, text: str) -> Path:
    path = folder / "own.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_overrides_the_figures_that_it_gives(tmp_path):
    text = """
    smartcar: {chassis_mass_kg: 1.1, wheel_torque_nm: 3}
    block: {deck_mass_kg: 0.6}
    slope: {hinge_speed_rad_s: 1.0}
    contact: {ground_friction: 0.5}
    gains: {drive: {max_speed: 0.5}}
    """
    machines = load_machines(str(_file(tmp_path, text)))
    assert machines.cars == (SmartcarParameters(chassis_mass_kg=1.1, wheel_torque_nm=3.0),)
    assert machines.block == BlockParameters(deck_mass_kg=0.6)
    assert machines.slope == SlopeParameters(hinge_speed_rad_s=1.0)
    assert machines.contact.ground_friction == 0.5
    assert load_machines(_file(tmp_path, text)).digest == machines.digest != NOMINAL.digest


def test_the_example_of_the_documentation_is_such_a_file(tmp_path):
    docs = Path(__file__).parents[2] / "docs" / "reference" / "parameters.md"
    (text,) = re.findall(r"```yaml\n(.*?)```", docs.read_text(encoding="utf-8"), re.DOTALL)
    machines = load_machines(_file(tmp_path, text))
    assert machines.car(1).chassis_mass_kg == 2.0
    assert machines.slope.hinge_speed_rad_s == 1.0


def test_single_cars_differ_from_the_others(tmp_path):
    text = "smartcar: {chassis_mass_kg: 1.1}\ncars: [{}, {wheel_torque_nm: 3.0, chassis_mass_kg: 1.2}]\n"
    machines = load_machines(_file(tmp_path, text))
    assert machines.car(0) == SmartcarParameters(chassis_mass_kg=1.1)
    assert machines.car(1) == SmartcarParameters(chassis_mass_kg=1.2, wheel_torque_nm=3.0)


def test_a_wrong_file_is_refused_by_file_line_and_figure(tmp_path):
    for text, message in (
        ("smartcat: {}", ":1: unknown key 'smartcat'; did you mean 'smartcar'?"),
        ("\nsmartcar: {wheel_mas_kg: 1}", ":2: unknown key 'wheel_mas_kg'; did you mean 'wheel_mass_kg'?"),
        (
            "smartcar: {wheel_mass_kg: -1}",
            ":1: key 'smartcar.wheel_mass_kg': -1 is out of range, allowed: above 0",
        ),
        (
            "smartcar: {mass_kg: 11}",
            ":1: key 'smartcar.mass_kg': is not given but follows from other parameters",
        ),
        (
            "smartcar: {boss_side_m: 0.1}",
            ":1: key 'smartcar.boss_side_m': cannot be changed from 0.11: the pockets",
        ),
        (
            "smartcar: {wheel_radius_m: 0.04}",
            ":1: key 'smartcar': wheel_radius_m is 0.04: the chassis would ground",
        ),
        ("cars: [{}, {board_travel_m: 0.02}]", ": Machines: board_travel_m is 0.02; from 0.0309 to 0.0509"),
    ):
        path = _file(tmp_path, text)
        with pytest.raises(InputError) as caught:
            load_machines(path)
        assert str(caught.value).startswith(f"{path}{message}")


def test_all_mistakes_are_named_together(tmp_path):
    path = _file(
        tmp_path, "block: {side_m: 0.4}\nslope: {skin: 1, friction: -1}\ncars: [{}, {boss_height_m: 1}]\n"
    )
    with pytest.raises(InputError) as caught:
        load_machines(path)
    lines = [line.removeprefix(f"{path}:").partition(":")[0] for line in str(caught.value).splitlines()]
    assert lines == ["1", "2", "2", "3"]
