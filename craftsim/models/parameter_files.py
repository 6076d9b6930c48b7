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
import re
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

from craftsim.discrete.files.documents import (
    Mapping,
    Node,
    Scalar,
    Sequence,
    Source,
    describe,
    parse_keys,
    read_text,
)
from craftsim.errors import InputError
from craftsim.models.figures import check_figure
from craftsim.models.parameters import (
    BlockParameters,
    ContactParameters,
    Machines,
    SlopeParameters,
    SmartcarParameters,
)

_KINDS: Final[dict[str, type]] = {
    "smartcar": SmartcarParameters,
    "block": BlockParameters,
    "slope": SlopeParameters,
    "contact": ContactParameters,
}
MACHINE_SECTIONS: Final = (*_KINDS, "cars")
"""The keys of a file that hold machines' figures."""
_NUMBER: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


def read_keys(path: Path, known: list[str]) -> tuple[Source, Mapping]:
    """Return the top-level keys of a YAML file of figures; raise InputError for a file that cannot be read."""
    return parse_keys(path, read_text(path), known)


def numbers(source: Source, node: Node, section: str, known: list[str]) -> dict[str, tuple[float, int]]:
    """Return a section's numbers, each with its line; raise InputError for what is no known key or no number."""
    given = source.mapping(node, section, known)
    found = {}
    for key, value in given.items.items():
        found[key] = number(source, value, f"{section}.{key}", given.key_lines[key])
    return found


def number(source: Source, node: Node, name: str, line: int) -> tuple[float, int]:
    """Return a number and its line; raise InputError for what is none."""
    if not isinstance(node, Scalar) or node.quoted or not _NUMBER.fullmatch(node.text):
        source.fail(line, f"{name} must be a number, not {describe(node)}")
    found = float(node.text)
    if not math.isfinite(found):
        source.fail(line, f"{name} must be a finite number, not {node.text}")
    return found, line


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
    source, given = read_keys(path, [*MACHINE_SECTIONS, "gains"])
    figures = {
        name: _figures(source, given.items[name], name, kind) if name in given.items else {}
        for name, kind in _KINDS.items()
    }
    base = figures.pop("smartcar")
    cars = [base | own for own in _cars(source, given.items.get("cars"))] or [base]
    try:
        made = {name: _KINDS[name](**values) for name, values in figures.items()}
        return Machines(cars=tuple(_KINDS["smartcar"](**values) for values in cars), **made)
    except InputError as error:
        message = str(error).replace("SmartcarParameters.", "smartcar.")
        raise InputError(f"{path}: {message}") from error


def _cars(source: Source, node: Node | None) -> list[dict[str, float]]:
    if node is None:
        return []
    if not isinstance(node, Sequence) or not node.items:
        source.fail(node.line, f"'cars' must be a list with figures of each car, not {describe(node)}")
    return [_figures(source, item, f"cars[{i}]", SmartcarParameters) for i, item in enumerate(node.items)]


def _figures(source: Source, node: Node, section: str, kind: type) -> dict[str, float]:
    """Return the figures that a section gives, each checked by itself."""
    if isinstance(node, Mapping):
        for key, line in node.key_lines.items():
            if isinstance(getattr(kind, key, None), property):
                source.fail(
                    line, f"{section}.{key} is not given but follows from other figures; change those"
                )
    known: dict[str, Any] = {f.name: f for f in fields(kind)}
    figures = {}
    for key, (value, line) in numbers(source, node, section, list(known)).items():
        figure = int(value) if isinstance(known[key].default, int) and value == int(value) else value
        try:
            check_figure(f"{section}.{key}", figure, known[key])
        except InputError as error:
            source.fail(line, str(error))
        figures[key] = figure
    return figures
