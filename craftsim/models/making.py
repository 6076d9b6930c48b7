"""Machines as they are made: each a little off its drawing, drawn from a seed, in place.

What the skills know of a machine stays nominal. Masses, and what is only to be seen, stay as they are.
"""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.mjcf.reduced import WholeCar
from craftsim.models.imperfection import Making
from craftsim.models.parts import WHEELS, Car
from craftsim.models.world import Site

_FEET = ("foot_fl", "foot_fr", "foot_rl", "foot_rr")
_POCKET = ("frame_front", "frame_back", "frame_left", "frame_right")
_PADS = ("pad_left", "pad_right", "pad_back", "pad_front")


def make(site: Site, making: Making, rng: np.random.Generator) -> None:
    """Draw all machines of a Site whose model is as it was compiled; equal generators give equal machines."""
    model = site.model
    for car in site.cars:
        _make_car(model, car, making, rng)
    for table in (*site.blocks, *site.flags):
        prefix = _prefix(model, table.body)
        feet, pocket = _geoms(model, prefix, _FEET), _geoms(model, prefix, _POCKET)
        model.geom_pos[feet, 2] -= making.foot_m * rng.uniform(-1, 1, len(feet))
        model.geom_pos[pocket] += _off(making, rng)
    for slope in site.slopes:
        model.geom_pos[_geoms(model, _prefix(model, slope.base.body), _PADS)] += _off(making, rng)


def _make_car(model: mujoco.MjModel, car: Car, making: Making, rng: np.random.Generator) -> None:
    prefix = _prefix(model, car.base.body)
    larger = making.wheel_radius_m * rng.uniform(-1, 1, len(WHEELS))
    moved = making.wheel_place_m * rng.uniform(-1, 1, (len(WHEELS), 2))
    (board,) = model.jnt_bodyid[model.dof_jntid[[car.board.dof]]]
    model.body_pos[board, 2] += making.board_m * rng.uniform(-1, 1)
    model.body_pos[board, :2] += making.board_place_m * rng.uniform(-1, 1, 2)
    if len(car.wheel_dofs):
        for wheel, more, by in zip(_wheel_bodies(model, car), larger, moved, strict=True):
            model.body_pos[wheel, :2] += by
            # Rollers stand further out on their hub.
            rollers = np.flatnonzero(model.body_parentid == wheel)
            out = np.linalg.norm(model.body_pos[rollers], axis=1, keepdims=True)
            model.body_pos[rollers] *= 1 + more / out
        return
    wheels = _geoms(model, prefix, WHEELS)
    model.geom_size[wheels, 0] += larger
    model.geom_pos[wheels, :2] += moved
    # A wheel's speed is (vx - y vy - z l omega) / R, l being its distance from the middle, forward plus sideways.
    nominal, radius = WholeCar.of(car.parameters), car.parameters.wheel_radius_m
    middle = np.sign(model.geom_pos[wheels, :2])
    lever = car.parameters.turn_radius_m + (middle * moved).sum(axis=1)
    scale = np.ones((len(WHEELS), 6)) * (radius / (radius + larger))[:, None]
    scale[:, 5] *= lever / car.parameters.turn_radius_m
    motors = [model.actuator(prefix + wheel.replace("wheel", "gear")).id for wheel in WHEELS]
    for wheel_motors in (car.wheel_actuators, motors):
        model.actuator_gear[wheel_motors] = np.array(nominal.gears) * scale


def _wheel_bodies(model: mujoco.MjModel, car: Car) -> Iterator[int]:
    return (int(model.dof_bodyid[dof]) for dof in car.wheel_dofs)


def _off(making: Making, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return (3,) metres: by how much a pocket or pads are off, forward, sideways and up."""
    return np.array([making.pocket_m, making.pocket_m, making.underside_m]) * rng.uniform(-1, 1, 3)


def _prefix(model: mujoco.MjModel, body: int) -> str:
    return str(model.body(body).name.rpartition("/")[0] + "/")


def _geoms(model: mujoco.MjModel, prefix: str, names: tuple[str, ...]) -> list[int]:
    return [model.geom(prefix + name).id for name in names]
