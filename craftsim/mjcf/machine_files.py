"""Machines' parameters from YAML files that a person writes.

A file has the sections ``smartcar``, ``block``, ``slope`` and ``contact``, each with any of the parameters of its
record in :mod:`craftsim.mjcf.parameters`, and a list ``cars`` of parameters by which single cars differ from
``smartcar``, one entry for each car. A section ``gains`` is left to :func:`craftsim.skills.gains.load_gains`, so that
one file can hold both. Example::

    smartcar: {chassis_mass_kg: 1.1, wheel_torque_nm: 3.0}
    cars: [{}, {wheel_mass_kg: 2.5}]
    slope: {hinge_speed_rad_s: 1.0}
"""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import Field

from craftsim.errors import InputError
from craftsim.mjcf.parameters import (
    BlockParameters,
    ContactParameters,
    Machines,
    SlopeParameters,
    SmartcarParameters,
)
from craftsim.storage.records import record
from craftsim.storage.yaml import read_document


@record(kw_only=True)
class _File:
    smartcar: SmartcarParameters = SmartcarParameters()
    block: BlockParameters = BlockParameters()
    slope: SlopeParameters = SlopeParameters()
    contact: ContactParameters = ContactParameters()
    cars: Annotated[tuple[SmartcarParameters, ...], Field(min_length=1)] | None = None
    gains: Any = None


MACHINE_SECTIONS: Final = tuple(one.name for one in fields(_File) if one.name != "gains")
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
    document = read_document(Path(path))
    smartcar, cars = document.plain.get("smartcar", {}), document.plain.get("cars")
    if isinstance(smartcar, dict) and isinstance(cars, list):
        own = [smartcar | one if isinstance(one, dict) else one for one in cars]
        document = replace(document, plain=document.plain | {"cars": own})
    file = document.to(_File)
    try:
        return Machines(file.cars or (file.smartcar,), file.block, file.slope, file.contact)
    except InputError as error:
        document.fail((), str(error))
