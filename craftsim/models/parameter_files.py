"""Machines' figures from YAML files that a person writes: bounded in size, and each mistake named by file and line.

A file has the sections ``smartcar``, ``block``, ``slope`` and ``contact``, each with any of the figures of its
dataclass in :mod:`craftsim.models.parameters`, and a list ``cars`` of figures by which single cars differ from
``smartcar``, one entry for each car. A section ``gains`` is left to :func:`craftsim.skills.gains.load_gains`, so that
one file can hold both. Example::

    smartcar: {chassis_mass_kg: 1.1, wheel_torque_nm: 3.0}
    cars: [{}, {wheel_mass_kg: 2.5}]
    slope: {hinge_speed_rad_s: 1.0}
"""

from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

from craftsim.errors import InputError
from craftsim.models.figures import check_figure
from craftsim.models.parameters import (
    BlockParameters,
    ContactParameters,
    Machines,
    SlopeParameters,
    SmartcarParameters,
)
from craftsim.storage.yaml import Document, Loc, described, read_document

_KINDS: Final[dict[str, type]] = {
    "smartcar": SmartcarParameters,
    "block": BlockParameters,
    "slope": SlopeParameters,
    "contact": ContactParameters,
}
MACHINE_SECTIONS: Final = (*_KINDS, "cars")
"""The keys of a file that hold machines' figures."""


def read_keys(path: Path, known: list[str]) -> Document:
    """Return a YAML file of figures; raise InputError for one that cannot be read, or has other top-level keys."""
    document = read_document(path)
    document.mapping(known)
    return document


def numbers(document: Document, section: str, known: list[str], *loc: str | int) -> dict[str, float]:
    """Return the numbers of a section at a place; raise InputError for what is no known key or no number."""
    given = document.mapping(known, *loc)
    return {key: number(document, value, f"{section}.{key}", (*loc, key)) for key, value in given.items()}


def number(document: Document, value: object, name: str, loc: Loc) -> float:
    """Return a value as a number; raise InputError for what is none."""
    if not isinstance(value, int | float):
        document.fail(loc, f"{name} must be a number, not {described(value)}")
    if not math.isfinite(value):
        document.fail(loc, f"{name} must be a finite number, not {value}")
    return float(value)


def load_machines(path: Path | str) -> Machines:
    """Return the machines of a YAML file: the nominal figures, overridden by those that the file gives.

    Raises InputError, naming the file, line and figure, for an unknown figure, one that cannot be changed, one out of
    range, and figures that do not fit together.

    Example:
        >>> import craftsim
        >>> _ = (folder / "heavy.yaml").write_text("smartcar: {chassis_mass_kg: 2.0}")
        >>> craftsim.load_machines(folder / "heavy.yaml").car(0).chassis_mass_kg
        2.0
    """
    path = Path(path)
    document = read_keys(path, [*MACHINE_SECTIONS, "gains"])
    figures = {
        name: _figures(document, name, kind, name) if name in document.plain else {}
        for name, kind in _KINDS.items()
    }
    base = figures.pop("smartcar")
    cars = [base | own for own in _cars(document)] or [base]
    try:
        made = {name: _KINDS[name](**values) for name, values in figures.items()}
        return Machines(cars=tuple(_KINDS["smartcar"](**values) for values in cars), **made)
    except InputError as error:
        message = str(error).replace("SmartcarParameters.", "smartcar.")
        raise InputError(f"{path}: {message}") from error


def _cars(document: Document) -> list[dict[str, float]]:
    if "cars" not in document.plain:
        return []
    cars = document.plain["cars"]
    if not isinstance(cars, list) or not cars:
        document.fail(("cars",), f"'cars' must be a list with figures of each car, not {described(cars)}")
    return [_figures(document, f"cars[{i}]", SmartcarParameters, "cars", i) for i in range(len(cars))]


def _figures(document: Document, section: str, kind: type, *loc: str | int) -> dict[str, float]:
    """Return the figures that a section gives, each checked by itself."""
    for *place, key in document.lines:
        if place == [*loc] and isinstance(getattr(kind, str(key), None), property):
            text = f"{section}.{key} is not given but follows from other figures; change those"
            document.fail((*loc, key), text)
    known: dict[str, Any] = {f.name: f for f in fields(kind)}
    figures = {}
    for key, value in numbers(document, section, list(known), *loc).items():
        figure = int(value) if isinstance(known[key].default, int) and value == int(value) else value
        try:
            check_figure(f"{section}.{key}", figure, known[key])
        except InputError as error:
            document.fail((*loc, key), str(error))
        figures[key] = figure
    return figures
