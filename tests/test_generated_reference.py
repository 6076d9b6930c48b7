"""References that are built with the site hold what the package holds, and say it in tables that can be read."""

import dataclasses

from generated import TABLES

from craftsim.discrete.reasons import REASONS
from craftsim.models.sensing import SensorNoise
from craftsim.skills.gains import SECTIONS
from craftsim.storage import limits


def _rows(name: str) -> list[list[str]]:
    return [line.strip("| ").split(" | ") for line in TABLES[name]().splitlines() if line.startswith("| ")]


def test_a_table_has_rows_of_one_width():
    for name in [name for name in TABLES if name != "commands"]:
        for part in TABLES[name]().split("\n\n"):
            widths = {
                line.replace("\\|", "").count("|") for line in part.splitlines() if line.startswith("|")
            }
            assert len(widths) <= 1


def test_every_limit_is_in_the_reference():
    named = {row[0] for row in _rows("limits")}
    numbers = {
        name for name, value in vars(limits).items() if name.isupper() and isinstance(value, int | float)
    }
    assert named - {"constant", "---"} == {f"`{name}`" for name in numbers - {"KIB", "MIB"}}


def test_every_gain_and_every_kind_of_noise_is_in_the_reference():
    gains = {row[0] for row in _rows("gains")}
    assert {f"`{field.name}`" for kind in SECTIONS.values() for field in dataclasses.fields(kind)} <= gains
    assert {f"`{field.name}`" for field in dataclasses.fields(SensorNoise)} <= {
        row[0] for row in _rows("noise")
    }


def test_every_reason_is_in_the_reference_without_fields():
    rows = _rows("reasons")
    assert len(rows) == len(REASONS) + 2
    assert not any("{" in cell for row in rows for cell in row)
