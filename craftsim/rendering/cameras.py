"""Cameras for films and pictures: fitted to the area, behind a car, close to it, around the area, or from a file.

A file is YAML, as in ``{lookat: [0.65, 0.65, 0.1], distance: 2.5, azimuth: 120, elevation: -25, fovy: 30}``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
from craftsim.errors import InputError, suggestion
from craftsim.models.cameras import Aim, box_corners, fitted, overview_aim, top
from craftsim.rendering.trajectory import Trajectory, show_at
from craftsim.storage.limits import Range
from craftsim.storage.records import record
from craftsim.storage.yaml import read_document

AREA_VIEWS: Final = ("overview", "top", "orbit")
CAR_VIEWS: Final = ("follow", "closeup")
"""Of one car, by its number, as in ``follow:0``."""

_STRIP_SHARE: Final = 0.13
_STRIP_CELLS: Final = 0.6
"""Of the strip with the coordinates around an area: its width over the area's longer side, and at most, in cells."""
_ORBIT_S: Final = 60.0  # an orbit takes the whole trajectory, and no less than this
_Metres = Annotated[float, Range(-1000.0, 1000.0)]


@dataclass(frozen=True)
class View:
    """A camera that may move with the time of a trajectory."""

    fovy_deg: float
    """Vertical field of view; MuJoCo keeps a free camera's in ``model.vis.global_.fovy``."""
    aim: Callable[[float], Aim]
    """Gives where it stands and looks at a simulated time in seconds."""
    ghost: bool = True
    """Whether it is to show the ghost of the goal, which would hide more than it shows close to a car."""

    def camera(self, time_s: float) -> mujoco.MjvCamera:
        """Return MuJoCo's free camera at a simulated time."""
        aim = self.aim(time_s)
        camera = mujoco.MjvCamera()
        camera.lookat[:] = aim.lookat
        camera.distance = aim.distance_m
        camera.azimuth = aim.azimuth_deg
        camera.elevation = aim.elevation_deg
        return camera


def make_view(text: str, trajectory: Trajectory, aspect: float) -> View:
    """Return a view of a trajectory for a picture of an aspect ratio (width over height).

    ``text`` is ``overview`` (the whole area, up to the height that anything reaches, from its front right), ``top``
    (x to the right), ``orbit`` (once around the area), ``follow:CAR`` (from behind and above), ``closeup:CAR`` (wheels
    and board), or a YAML file with the keys lookat (x, y, z in metres), distance (m), azimuth, elevation and, where it
    is not 45, fovy (degrees), as MuJoCo's free camera has them. Raises InputError for any other, or a wrong file.
    """
    if Path(text).suffix in (".yaml", ".yml"):
        return _still(read_aim(Path(text)))
    kind, _, number = text.partition(":")
    size = trajectory.story.recipe.grid.size
    cars = [str(car) for car in range(trajectory.story.recipe.grid.n_cars)]
    if text in ("overview", "top"):
        fit = {"overview": overview_aim, "top": top}[text]
        return _still(fit(size, reached_m(trajectory), aspect, label_strip_m(*size[:2])))
    if text == "orbit":
        return _orbit(trajectory, size, aspect)
    if kind in CAR_VIEWS:
        if number not in cars:
            hint = "this world has no cars; try overview"
            if cars:
                hint = f"allowed: {', '.join(cars)}"
            raise InputError(f"camera '{text[:80]}': there is no car '{number[:40]}'; {hint}")
        return _beside(trajectory, int(number), kind == "closeup")
    views = [*AREA_VIEWS, *(f"{view}:{car}" for view in CAR_VIEWS for car in cars)]
    raise InputError(
        f"unknown camera '{text[:80]}'{suggestion(text[:80], views)}; there are {', '.join(AREA_VIEWS)}, "
        "follow:CAR and closeup:CAR with the number of a car, and YAML files (name.yaml)"
    )


@record(kw_only=True)
class _File:
    lookat: tuple[_Metres, _Metres, _Metres]
    distance: Annotated[float, Range(0.05, 1000.0)]
    azimuth: Annotated[float, Range(-360.0, 360.0)]
    elevation: Annotated[float, Range(-90.0, 90.0)]
    fovy: Annotated[float, Range(1.0, 120.0)] = 45.0


def read_aim(path: Path) -> Aim:
    """Return the camera of a YAML file with the keys of :func:`make_view`; raises InputError with the line."""
    file = read_document(path).to(_File)
    return Aim(np.array(file.lookat), file.distance, file.azimuth, file.elevation, file.fovy)


def label_strip_m(length: int, width: int) -> float:
    """Return the width in metres of the strip with the coordinates around an area of so many cells."""
    return CELL_PITCH_M * min(_STRIP_CELLS, _STRIP_SHARE * max(length, width))


def aspect_of(text: str, trajectory: Trajectory) -> float:
    """Return width over height of what a view shows, where it has a shape of its own; 4:3 of others."""
    size = trajectory.story.recipe.grid.size
    if text not in AREA_VIEWS:
        return 4 / 3
    first_aim = make_view(text, trajectory, 1.0).aim(float(trajectory.time[0]))
    width, height = np.ptp(
        first_aim.project(box_corners(size, reached_m(trajectory)), 1.0), axis=0
    ).tolist()
    return float(width / height)


def reached_m(trajectory: Trajectory) -> float:
    """Return the height in metres up to which anything reaches: machines at any time, unfolding flaps, the design."""
    tops = [goal.cell[2] * LEVEL_HEIGHT_M for goal in trajectory.story.design]
    for machine in trajectory.story.poses:
        tops.append(float(trajectory.pose(machine)[:, 2].max()) + LEVEL_HEIGHT_M)
    figures = trajectory.story.recipe.setup.machines.slope
    for slope in trajectory.physics.slopes:
        angle = np.clip(trajectory.qpos[:, slope.hinge.qpos], 0.0, math.pi)
        swung = trajectory.qpos[:, slope.base.qpos + 2] + figures.side_m * np.sin(angle)
        tops.append(float(swung.max()) + figures.hinge_z_m)
    return max(tops, default=LEVEL_HEIGHT_M)


def _still(aim: Aim) -> View:
    return View(aim.fovy_deg, lambda time_s: aim)


def _orbit(trajectory: Trajectory, size: tuple[int, ...], aspect: float) -> View:
    """Return the view that turns once around the area: fitted to the cylinder about it, which all angles see alike."""
    length = size[0] * CELL_PITCH_M
    width = size[1] * CELL_PITCH_M
    angles = np.arange(72) * (math.tau / 72)
    strip = label_strip_m(*size[:2])
    polygon = 2 * math.cos(math.pi / 72)  # about the circle
    radius = math.hypot(length + strip, width + strip) / polygon
    rim = np.column_stack(
        [length / 2 + radius * np.cos(angles), width / 2 + radius * np.sin(angles)]
    )
    points = []
    for x, y in rim:
        for z in (0.0, reached_m(trajectory)):
            points.append((x, y, z))
    first = overview_aim(size, 0.0, aspect)
    ring = fitted(points, first.azimuth_deg, first.elevation_deg, first.fovy_deg, aspect)
    # It looks at the axis of the cylinder, so that it can turn about it.
    view_axis = -ring.axes[:2, 2]
    forward = float(
        ((length / 2, width / 2) - ring.lookat[:2]) @ view_axis / (view_axis @ view_axis)
    )
    lookat = ring.lookat - forward * ring.axes[:, 2]
    start = float(trajectory.time[0])
    turn_s = max(trajectory.duration_s, _ORBIT_S)

    def aim(time_s: float) -> Aim:
        azimuth = first.azimuth_deg + 360.0 * (time_s - start) / turn_s
        return Aim(lookat, ring.distance_m + forward, azimuth, ring.elevation_deg, ring.fovy_deg)

    return View(ring.fovy_deg, aim)


_HEADING_S: Final = 1.2
"""Standard deviation of the low-pass of a heading: a car turns by a right angle in less than a second, too fast for a
camera."""
_LOOKS: Final = 40  # samples at which it is tried from where a car is seen


def _beside(trajectory: Trajectory, car: int, closeup: bool) -> View:
    """Return the view of a camera that goes behind a car, or close to its wheels and board.

    It looks at a point before the car's origin and over it. Its ``sides`` are turns of its direction from the car's
    heading, 0 looking the way the car does, and elevations, in degrees: it is where the car is least hidden. The car's
    place is smoothed by a Gaussian with a standard deviation of ``place_s``.
    """
    distance_m = 1.25
    fovy_deg = 45.0
    ahead_m = 0.25
    height_m = 0.10
    place_s = 0.4
    sides = [(0.0, -32.0), (0.0, -48.0)]
    if closeup:
        distance_m = 0.85
        fovy_deg = 30.0
        ahead_m = 0.0
        height_m = 0.06
        place_s = 0.15
        sides = []
        for elevation in (-20.0, -35.0):
            for turn in (116.0, -116.0, 64.0, -64.0):
                sides.append((turn, elevation))
    poses = trajectory.pose(f"car {car}")
    times = trajectory.time
    period_s = 1.0
    if len(times) > 1:
        period_s = float(np.median(np.diff(times)))
    w, x, y, z = poses[:, 3:].T
    headings = np.arctan2(2 * (x * y + w * z), w * w + x * x - y * y - z * z)
    heading = _smooth(np.unwrap(headings), _HEADING_S / period_s)
    offset = ahead_m * np.column_stack([np.cos(heading), np.sin(heading)])
    looked_at = _smooth(poses[:, :3], place_s / period_s)
    looked_at += np.column_stack([offset, np.full(len(times), height_m)])

    def aim(side: tuple[float, float], time_s: float) -> Aim:
        lookat = np.array([np.interp(time_s, times, looked_at[:, axis]) for axis in range(3)])
        azimuth = math.degrees(float(np.interp(time_s, times, heading))) + side[0]
        return Aim(lookat, distance_m, azimuth, side[1], fovy_deg)

    aims = [partial(aim, side) for side in sides]
    return View(fovy_deg, _least_hidden(trajectory, car, aims), not closeup)


def _least_hidden(
    trajectory: Trajectory, car: int, aims: Sequence[Callable[[float], Aim]]
) -> Callable[[float], Aim]:
    """Return the first of the aims from which nothing hides a car most often."""
    model = trajectory.model
    root = trajectory.physics.cars[car].base.body
    data = mujoco.MjData(model)
    n_visible = [0] * len(aims)
    groups = np.array([0, 0, 1, 0, 0, 0], np.uint8)
    hit = np.zeros(1, np.int32)
    for sample in np.linspace(0, len(trajectory) - 1, _LOOKS).astype(int):
        show_at(model, data, trajectory.qpos[sample])
        for number, aim in enumerate(aims):
            candidate = aim(float(trajectory.time[sample]))
            ray = candidate.lookat - candidate.position
            mujoco.mj_ray(model, data, candidate.position, ray, groups, 1, -1, hit)
            n_visible[number] += (
                hit[0] >= 0 and int(model.body_rootid[model.geom_bodyid[hit[0]]]) == root
            )
    return aims[int(np.argmax(n_visible))]


def _smooth(samples: NDArray[np.float64], sigma: float) -> NDArray[np.float64]:
    from scipy.ndimage import gaussian_filter1d  # a quarter of a second that only films take

    smooth: NDArray[np.float64] = gaussian_filter1d(samples, sigma, axis=0, mode="nearest")
    return smooth
