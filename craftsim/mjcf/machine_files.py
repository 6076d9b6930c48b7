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

from dataclasses import fields
from pathlib import Path
from typing import Any, Final

from craftsim.errors import InputError
from craftsim.mjcf.parameters import (
    BlockParameters,
    ContactParameters,
    Machines,
    SlopeParameters,
    SmartcarParameters,
    check_parameter,
)
from craftsim.storage.yaml import Loc, Mistake, described, key_words, read_document, unknown_words

_KINDS: Final[dict[str, type]] = {
    "smartcar": SmartcarParameters,
    "block": BlockParameters,
    "slope": SlopeParameters,
    "contact": ContactParameters,
}
MACHINE_SECTIONS: Final = (*_KINDS, "cars")
"""The keys of a file that hold machines' parameters."""


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
    known = [*MACHINE_SECTIONS, "gains"]
    unknown = [name for name in document.plain if name not in known]
    if document.instead:
        document.mapping(known)
    mistakes: list[Mistake] = []
    sections: dict[str, dict[str, Any]] = {name: {} for name in _KINDS}
    cars: list[dict[str, Any]] = [{}]
    for name, found in document.plain.items():
        if name in _KINDS:
            sections[name] = _figures(found, _KINDS[name], (name,), mistakes)
        elif name == "cars" and isinstance(found, list) and found:
            cars = [_figures(own, SmartcarParameters, (name, i), mistakes) for i, own in enumerate(found)]
        elif name == "cars":
            wanted = (
                "have an entry for each car"
                if found == []
                else f"be a list of entries, not {described(found)}"
            )
            mistakes.append(((name,), f"{key_words((name,))}: must {wanted}"))
        elif name in unknown:
            mistakes.append(((name,), unknown_words(name, known, allowed=name == unknown[0])))
    document.refuse(mistakes)
    base = sections.pop("smartcar")
    try:
        others = {name: _KINDS[name](**figures) for name, figures in sections.items()}
        return Machines(cars=tuple(SmartcarParameters(**base | own) for own in cars), **others)
    except InputError as error:
        raise InputError(f"{path}: {str(error).replace('SmartcarParameters.', 'smartcar.')}") from error


def _figures(section: object, kind: type, loc: Loc, mistakes: list[Mistake]) -> dict[str, Any]:
    """Return the parameters of a record that a section gives; note what is wrong with the others."""
    declared, found, unknown = {f.name: f for f in fields(kind)}, dict[str, Any](), list[str]()
    if not isinstance(section, dict):
        wanted = f"a mapping with keys {', '.join(declared)}"
        mistakes.append((loc, f"{key_words(loc)}: must be {wanted}, not {described(section)}"))
        return found
    for name, value in section.items():
        at = (*loc, name)
        if isinstance(getattr(kind, name, None), property):
            text = "is not given but follows from other parameters; change those"
            mistakes.append((at, f"{key_words(at)}: {text}"))
        elif name not in declared:
            # What is allowed is said once.
            mistakes.append((at, unknown_words(name, declared, allowed=not unknown)))
            unknown.append(name)
        else:
            if isinstance(value, int | float):
                whole = isinstance(declared[name].default, int) and float(value).is_integer()
                value = int(value) if whole else float(value)
            try:
                check_parameter(key_words(at) + ":", value, declared[name])
            except InputError as error:
                mistakes.append((at, str(error)))
            found[name] = value
    return found
