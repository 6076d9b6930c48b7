"""A file of machines with every parameter, its unit, meaning and origin as comments: a template to edit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import Field, fields
from typing import Any, Final

from craftsim.mjcf.machines import NOMINAL, PARTS, TOTAL, Machines

UNITS: Final = {
    "_nms_rad": "Nm s/rad",
    "_nm_rad": "Nm/rad",
    "_rad_s": "rad/s",
    "_kgm2": "kg m^2",
    "_ns_m": "N s/m",
    "_n_m": "N/m",
    "_m_s": "m/s",
    "_rad": "rad",
    "_kg": "kg",
    "_nm": "Nm",
    "_n": "N",
    "_m": "m",
    "_s": "s",
}
"""Units by the end of a parameter's name; longer ends first."""
_SECTIONS: Final = ("smartcar", "block", "slope", "contact")


def unit_of(name: str) -> str:
    """Return the unit that the name of a parameter ends in; empty for a number without one.

    Example:
        >>> unit_of("wheel_gain_nms_rad"), unit_of("wheel_torque_nm"), unit_of("roller_friction")
        ('Nm s/rad', 'Nm', '')
    """
    for end, unit in UNITS.items():
        if name.endswith(end):
            return unit
    return ""


def machines_text(
    machines: Machines = NOMINAL,
    remarks: Iterable[str] = (),
    origins: Mapping[str, str] | None = None,
) -> str:
    """Return a file of machines, all cars like the first, as :func:`craftsim.mjcf.machines.load_machines` reads it.

    Fixed parameters, and masses that follow from the whole, are comments. ``remarks`` are the first lines, as comments;
    ``origins`` says where parameters of the car are from that are not nominal, by name.
    """
    of_car = origins or {}
    lines = [f"# {remark}".rstrip() for remark in remarks]
    for section in _SECTIONS:
        parameters: Any = getattr(machines, section, machines.car(0))
        fixed = []
        lines += ["", f"{section}:"]
        is_nominal_car = section == "smartcar" and _nominal_shares(parameters)
        if is_nominal_car:
            total_kg = f"{parameters.mass_kg:.10g}"
            lines.append(
                f"  {TOTAL}: {total_kg}  # kg; the whole car; parts that are named keep their mass, the others share it"
            )
        for parameter in fields(parameters):
            value = getattr(parameters, parameter.name)
            origin = ""
            if section == "smartcar":
                origin = of_car.get(parameter.name, "")
            line = f"{parameter.name}: {value!r}  # {_comment(parameter, value, origin)}"
            if parameter.metadata["fixed"]:
                fixed.append(f"  # {line}")
            elif is_nominal_car and parameter.name in (*PARTS, "roller_mass_kg"):
                lines.append(f"  # {line}")
            else:
                lines.append(f"  {line}")
        if fixed:
            lines += ["  # Fixed:", *fixed]
    return "\n".join(lines).lstrip("\n") + "\n"


def _nominal_shares(car: Any) -> bool:
    """Return whether the parts of a car have the masses of the nominal one, which share a whole mass."""
    nominal = NOMINAL.cars[0]
    names = (*PARTS, "roller_mass_kg")
    return all(getattr(car, name) == getattr(nominal, name) for name in names)


def _comment(parameter: Field[Any], value: Any, origin: str) -> str:
    """Return unit, meaning and origin of a parameter."""
    metadata = parameter.metadata
    words = [unit_of(parameter.name), metadata["means"]]
    if origin or value != parameter.default:
        words += [origin, f"nominal {parameter.default!r}"]
    else:
        origin = metadata["origin"]
        if metadata["note"]:
            origin = f"{origin}: {metadata['note']}"
        words.append(origin)
    if metadata["fixed"]:
        words.append(f"fixed: {metadata['fixed']}")
    return "; ".join(word for word in words if word)
