"""MJCF of a part, rendered from the machines' figures.

Numbers that are figures are written as they are; masses, inertias and corner points that follow from them are written
to six decimals (a milligram, 1e-6 kg m^2, a micrometre), so that the files can be read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.mjcf import shapes
from craftsim.mjcf.parameters import ContactParameters, Machines, SmartcarParameters
from craftsim.mjcf.reduced import WholeCar
from craftsim.models.config import SimulationConfig

PARTS: Final = ("ground", "smartcar", "block", "flag", "wall", "slope")
_SCENERY: Final = '  <include file="ground.xml"/>\n'
_SEAT: Final = SmartcarParameters()
"""Board and boss of every car, for which blocks and slopes are made: these figures cannot be changed."""


def _number(value: float | Iterable[float]) -> str:
    if isinstance(value, int | float):
        text = f"{value:.10g}"
        return "0" if text == "-0" else text
    return " ".join(map(_number, value))


def _rounded(value: float | Iterable[float]) -> str:
    return _number(round(value, 6) if isinstance(value, int | float) else [round(v, 6) for v in value])


def _points(points: Iterable[tuple[float, float, float]]) -> str:
    return "  ".join(map(_rounded, points))


@lru_cache(maxsize=1)
def _environment() -> Environment:
    folder = Path(__file__).parent / "templates"
    environment = Environment(
        loader=FileSystemLoader(folder),
        undefined=StrictUndefined,
        autoescape=False,
        keep_trailing_newline=True,
    )
    environment.filters |= {
        "n": _number,
        "m": _rounded,
        "points": _points,
        "sin": math.sin,
        "cos": math.cos,
        "degrees": math.degrees,
        "both": lambda limit: f"{_number(-limit)} {_number(limit)}",
    }
    return environment


def render(
    part: str,
    machines: Machines,
    car: SmartcarParameters | None = None,
    alone: bool = True,
    mesh: Callable[[str], str] = "meshes/{}.obj".format,
) -> str:
    """Return the MJCF of a part: smartcar, block, flag, wall, slope or ground.

    Args:
        part: which part.
        machines: the figures.
        car: the figures of a smartcar, where they are not those of car 0.
        alone: with the floor, to be opened in the viewer; a part that is attached to a world comes without.
        mesh: gives the file name of a mesh.
    """
    context: dict[str, Any] = {
        "kind": part,
        "contact": machines.contact,
        "car": car or machines.cars[0],
        "block": machines.block,
        "slope": machines.slope,
        "scenery": _SCENERY if alone else "",
        "mesh": mesh,
        "tau": math.tau,
        "drive": machines.drive,
        "config": SimulationConfig(),
        "pitch_m": CELL_PITCH_M,
        **_surfaces(machines.contact),
        **_shapes(part, machines, car or machines.cars[0]),
    }
    templates = {"block": "table", "flag": "table", "wall": "table"}
    return _environment().get_template(f"{templates.get(part, part)}.xml").render(context)


def _surfaces(contact: ContactParameters) -> dict[str, Any]:
    soft = _number((contact.time_constant_s, contact.damping_ratio))

    def friction(sliding: float) -> str:
        return _number((sliding, contact.torsional_friction_m, contact.rolling_friction_m))

    def solimp(stiffness: float) -> str:
        # A contact of impedance d is as stiff as d / (1 - d).
        low, high = (
            round(stiffness * d / (1 - d + stiffness * d), 4)
            for d in (contact.impedance_min, contact.impedance_max)
        )
        return _number((low, high, contact.impedance_depth_m))

    joint = contact.joint_impedance, contact.joint_impedance, contact.joint_impedance_width
    hard = f'solref="{soft}" solimp="{solimp(1)}"'
    twist, roll = contact.torsional_friction_m, contact.rolling_friction_m
    return {
        "friction": friction,
        "surface": lambda sliding: f'friction="{friction(sliding)}" {hard}',
        # A pair has its own surface, and friction along each axis.
        "pair_surface": lambda sliding: f'friction="{_number((sliding, sliding, twist, roll, roll))}" {hard}',
        "solid": lambda box: (
            f'pos="{_number(box.centre)}" size="{_number(box.half)}" mass="{_rounded(box.mass)}"'
        ),
        "foot_solimp": solimp(contact.foot_stiffness_ratio),
        "dry": f'solreffriction="{soft}" solimpfriction="{_number(joint)}"',
    }


def _shapes(part: str, machines: Machines, car: SmartcarParameters) -> dict[str, Any]:
    match part:
        case "ground":
            return {}
        case "smartcar":
            return {
                "hull": shapes.hull(car),
                "boss": shapes.boss(car),
                "chassis_inertia": shapes.chassis_inertia(car),
                "hub_inertia": shapes.hub_inertia(car),
                "whole": WholeCar.of(car),
            }
        case "slope":
            return {
                "shape": shapes.slope(machines.slope, _SEAT),
                "worm": shapes.worm_offset(machines.slope),
            }
    return {"table": shapes.table(machines.block, _SEAT)}
