"""Machines' parameters from YAML files that a person writes: bounded in size, mistakes named by file and line.

A file has the sections ``smartcar``, ``block``, ``slope`` and ``contact``, each with any of the parameters of its
record in :mod:`craftsim.mjcf.parameters`, and a list ``cars`` of parameters by which single cars differ from
``smartcar``, one entry for each car. A section ``gains`` is left to :func:`craftsim.skills.gains.load_gains`, so that
one file can hold both. Example::

    smartcar: {chassis_mass_kg: 1.1, wheel_torque_nm: 3.0}
    cars: [{}, {wheel_mass_kg: 2.5}]
    slope: {hinge_speed_rad_s: 1.0}
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, make_dataclass
from pathlib import Path
from types import GenericAlias
from typing import Annotated, Any, Final

from craftsim.errors import InputError
from craftsim.mjcf.parameters import (
    BlockParameters,
    ContactParameters,
    Machines,
    SlopeParameters,
    SmartcarParameters,
    check_parameter,
)
from craftsim.storage.yaml import Document, Mistake, key_words, read_document

_KINDS: Final[dict[str, type]] = {
    "smartcar": SmartcarParameters,
    "block": BlockParameters,
    "slope": SlopeParameters,
    "contact": ContactParameters,
}
MACHINE_SECTIONS: Final = (*_KINDS, "cars")
"""The keys of a file that hold machines' parameters."""


@dataclass(frozen=True)
class _Declared:
    """A number in a file, held to what a record declares of a parameter."""

    field: Any

    def __get_pydantic_core_schema__(self, kind: type, handler: Any) -> Any:
        from pydantic_core import PydanticCustomError, core_schema

        whole = isinstance(self.field.default, int)

        def check(value: Any) -> Any:
            if isinstance(value, int | float):
                value = int(value) if whole and value == int(value) else float(value)
            try:
                check_parameter("", value, self.field)
            except InputError as error:
                raise PydanticCustomError("parameter", "{text}", {"text": str(error).strip()}) from error
            return value

        return core_schema.no_info_plain_validator_function(check)


def _section(kind: type) -> type:
    """Return the format of a section: any of the parameters of a record."""
    return make_dataclass(kind.__name__, [(f.name, Annotated[Any, _Declared(f)], None) for f in fields(kind)])


_SECTIONS: Final = {name: _section(kind) for name, kind in _KINDS.items()}
_FILE: Final = make_dataclass(
    "MachineFile",
    [
        *((name, section, field(default_factory=section)) for name, section in _SECTIONS.items()),
        ("cars", GenericAlias(tuple, (_SECTIONS["smartcar"], ...)), ()),
        ("gains", Any, None),
    ],
)
"""The format of a file."""


def load_machines(path: Path | str) -> Machines:
    """Return the machines of a YAML file: the nominal parameters, overridden by those that the file gives.

    Raises InputError, naming the file, line and parameter, for an unknown parameter, one that cannot be changed, one
    out of range, and parameters that do not fit together.

    Example:
        >>> import craftsim
        >>> _ = (folder / "heavy.yaml").write_text("smartcar: {chassis_mass_kg: 2.0}")
        >>> craftsim.load_machines(folder / "heavy.yaml").car(0).chassis_mass_kg
        2.0
    """
    path = Path(path)
    document = read_document(path)
    document.refuse(_following(document))
    file: Any = document.to(_FILE)
    if "cars" in document.plain and not file.cars:
        document.fail(("cars",), f"{key_words(('cars',))}: must have an entry for each car")
    given = {name: _given(getattr(file, name)) for name in _KINDS}
    base = given.pop("smartcar")
    try:
        cars = tuple(SmartcarParameters(**base | _given(own)) for own in file.cars or [None])
        return Machines(cars=cars, **{name: _KINDS[name](**values) for name, values in given.items()})
    except InputError as error:
        raise InputError(f"{path}: {str(error).replace('SmartcarParameters.', 'smartcar.')}") from error


def _given(section: Any) -> dict[str, Any]:
    return {name: value for name, value in vars(section).items() if value is not None} if section else {}


def _following(document: Document) -> Iterator[Mistake]:
    """Yield what a file gives although it follows from parameters."""
    for loc in filter(None, document.lines):
        section = "smartcar" if loc[:1] == ("cars",) else str(loc[0])
        if isinstance(getattr(_KINDS.get(section), str(loc[-1]), None), property):
            yield loc, f"{key_words(loc)}: is not given but follows from other parameters; change those"
