"""A trajectory as a file for the player of web pages, which needs neither Python nor a server of its own.

The file is JSON, packed with gzip: shapes, the tree of bodies, the positions of every sample, what was tried, and the
world as MJCF. Numbers are integers in units that it names; those of a sample are differences from the sample before,
which pack well. ``craftsim/reports/template/player/recording.js`` reads it.
"""

from __future__ import annotations

import gzip
import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
from craftsim.models.cameras import overview_aim
from craftsim.models.composition import world_spec
from craftsim.models.exporting import mjcf_text
from craftsim.rendering.trajectory import Trajectory
from craftsim.rendering.viewer.scene import shapes_of
from craftsim.storage.writing import write_whole

_FORMAT: Final = 1
"""Raised whenever something in the file changes its meaning or goes away."""
PLAYER_SUFFIX: Final = ".json.gz"
_UNITS: Final = {"time_s": 1e-6, "points_m": 1e-4, "normals": 1e-2}
"""Seconds; metres; parts of a unit vector."""
_POSITION_UNIT: Final = 1e-5
"""Metres, radians or parts of a unit quaternion, of whatever does not spin freely."""
_SPIN_UNIT: Final = 1e-3
"""Radians of wheels and rollers."""
_MOST_SAMPLES: Final = 6000
"""Of a longer run each second, third or further sample is taken: two minutes have all."""
_ASPECT: Final = 16 / 9
_JOINTS: Final = {
    mujoco.mjtJoint.mjJNT_FREE: "free",
    mujoco.mjtJoint.mjJNT_HINGE: "hinge",
    mujoco.mjtJoint.mjJNT_SLIDE: "slide",
}


def write_player_file(path: Path, trajectory: Trajectory) -> Path:
    """Write a trajectory as a file for the player, whole or not at all; equal ones give equal files. Return its path.

    Raises InputError where the file cannot be written, and as :attr:`Trajectory.physics`.
    """
    text = json.dumps(_document(trajectory), separators=(",", ":"))
    return write_whole(path, gzip.compress(text.encode(), mtime=0))


def _document(trajectory: Trajectory) -> dict[str, Any]:
    story = trajectory.story
    grid = story.recipe.grid
    setup = story.recipe.setup
    model = trajectory.model
    bodies, shapes = _bodies(model)
    stride = math.ceil(len(trajectory) / _MOST_SAMPLES)
    units = _position_units(model)
    columns = []
    for column, unit in zip(trajectory.qpos[::stride].T, units, strict=True):
        columns.append({"unit": unit, "steps": _differences(_integers(column, unit))})
    world = world_spec(grid, setup.simulation, setup.machines, story.recipe.goals, visual=False)
    return {
        "format": _FORMAT,
        "units": _UNITS,
        "title": story.title,
        "cells": grid.size,
        "cell_m": [CELL_PITCH_M, CELL_PITCH_M, LEVEL_HEIGHT_M],
        "camera": _camera(trajectory),
        "bodies": bodies,
        "shapes": shapes,
        "time_s": _differences(_integers(trajectory.time[::stride], _UNITS["time_s"])),
        "qpos": columns,
        "attempts": [_attempt(attempt) for attempt in story.attempts],
        "design": [asdict(goal) for goal in story.design],
        "cars": [
            {"radius_m": car.wheel_radius_m, "lever_m": car.turn_radius_m}
            for car in map(setup.machines.car, range(grid.n_cars))
        ],
        "drive": setup.machines.drive,
        "world": mjcf_text(world),
    }


def _position_units(model: mujoco.MjModel) -> list[float]:
    """Return the unit of each of MuJoCo's positions."""
    units = [_POSITION_UNIT] * model.nq
    for joint in range(model.njnt):
        is_hinge = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        if is_hinge and not model.jnt_limited[joint]:
            units[model.jnt_qposadr[joint]] = _SPIN_UNIT
    return units


def _integers(values: ArrayLike, unit: float) -> NDArray[np.int64]:
    rounded: NDArray[np.int64] = np.rint(np.asarray(values, float) / unit).astype(np.int64)
    return rounded


def _differences(column: NDArray[np.int64]) -> list[int]:
    """Return the first of a column and the differences that follow, without the zeros at its end."""
    differences = np.diff(column, prepend=0)
    changes = np.flatnonzero(differences)
    n_kept = 1
    if len(changes):
        n_kept = int(changes[-1]) + 1
    kept: list[int] = differences[:n_kept].tolist()
    return kept


def _attempt(attempt: Any) -> dict[str, Any]:
    return {
        "car": attempt.car,
        "action": attempt.action,
        "result": attempt.result,
        "agrees": attempt.agrees,
        "reason": attempt.reason,
        "start_s": round(attempt.start_s, 3),
        "end_s": round(attempt.start_s + attempt.duration_s, 3),
    }


def _camera(trajectory: Trajectory) -> dict[str, Any]:
    """Return where the overview looks from: a target, and angles and distance from there."""
    size = trajectory.story.recipe.grid.size
    highest_m = max(
        float(trajectory.pose(machine)[:, 2].max()) for machine in trajectory.story.poses
    )
    aim = overview_aim(size, max(highest_m, 2 * LEVEL_HEIGHT_M), _ASPECT)
    return {
        "target": np.round(aim.lookat, 4).tolist(),
        "distance_m": round(aim.distance_m, 4),
        "azimuth_deg": round(aim.azimuth_deg, 3),
        "elevation_deg": round(aim.elevation_deg, 3),
        "fovy_deg": aim.fovy_deg,
    }


def _bodies(model: mujoco.MjModel) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the bodies of a model, with the numbers of their shapes, and the shapes that differ."""
    shapes: dict[str, int] = {}
    meshes = shapes_of(model)
    bodies = []
    for body in range(model.nbody):
        entry: dict[str, Any] = {
            "name": model.body(body).name,
            "parent": int(model.body_parentid[body]),
            "pos": np.round(model.body_pos[body], 6).tolist(),
            "quat": np.round(model.body_quat[body], 8).tolist(),
        }
        if model.body_jntnum[body]:
            entry["joint"] = _joint(model, int(model.body_jntadr[body]))
        if body in meshes:
            text = json.dumps(_shape(meshes[body]))
            entry["shape"] = shapes.setdefault(text, len(shapes))
        bodies.append(entry)
    return bodies, [json.loads(text) for text in shapes]


def _joint(model: mujoco.MjModel, joint: int) -> dict[str, Any]:
    return {
        "kind": _JOINTS[mujoco.mjtJoint(model.jnt_type[joint])],
        "column": int(model.jnt_qposadr[joint]),
        "pos": np.round(model.jnt_pos[joint], 6).tolist(),
        "axis": np.round(model.jnt_axis[joint], 8).tolist(),
    }


def _shape(mesh: Any) -> dict[str, Any]:
    """Return a mesh as points that are shared, with a colour for each triangle."""
    points = _integers(mesh.vertices, _UNITS["points_m"])
    normals = _integers(mesh.vertex_normals, _UNITS["normals"])
    corners, places = np.unique(np.hstack([points, normals]), axis=0, return_inverse=True)
    colours = mesh.visual.vertex_colors[mesh.faces[:, 0]]
    palette, numbers = np.unique(colours, axis=0, return_inverse=True)
    return {
        "points_m": corners[:, :3].ravel().tolist(),
        "normals": corners[:, 3:].ravel().tolist(),
        "faces": places.ravel()[mesh.faces].ravel().tolist(),
        "palette": palette.tolist(),
        "colours": numbers.ravel().tolist(),
    }
