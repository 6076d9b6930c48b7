"""Swept volumes of actions, made of the convex solids that collide in physics, and distances between them.

The solids come from the same compiled models as physics; python-fcl measures distances.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any, Final, NamedTuple

import fcl
import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from craftsim.audit.situation import BACK, Situation
from craftsim.discrete.geometry import CELL_PITCH_M, DIRECTIONS, LEVEL_HEIGHT_M
from craftsim.discrete.grid import CarField, Grid, Kind, Piece, grid_of
from craftsim.discrete.kinds import MOVE_DIRECTION, Action
from craftsim.mjcf.machines import Machines
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.models.composition import PlacedPart, machine_spec, placements
from craftsim.workers.interrupts import defer_interrupts

with defer_interrupts():
    import trimesh

_Pose = NDArray[np.float64]
"""(4, 4): a homogeneous transform, metres."""

_TOUCHING_M: Final = 1e-7
"""Solids that are closer count as touching."""
_DEEP_M: Final = 0.02
"""For deeper overlaps the deepest pair is not searched."""
_GRAIN_M: Final = 0.0005
"""Distance between points of the surface; the error of the axles' height is 0.01 mm."""
_STEP_RAD: Final = math.radians(3)
"""A chord of this angle lies 0.08 mm inside the arc of a turning load's corner, 0.1 mm inside the flap lip's."""
_STEP_M: Final = 0.01


class Solid(NamedTuple):
    """A convex solid of a part."""

    name: str
    points: NDArray[np.float64]
    """(n, 3) corners in the part's frame, its joint at zero; curved faces have corners on them."""
    jointed: bool
    """Whether the part's joint moves it, as a car's board or a slope's flap."""


class CollisionShape(NamedTuple):
    """The solids of a part, and its joint."""

    solids: tuple[Solid, ...]
    hinge: bool = False
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    anchor: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def joint(self, position: float) -> _Pose:
        """Return the transform of the jointed solids at a position in metres or radians."""
        if self.hinge:
            turn: _Pose = trimesh.transformations.rotation_matrix(position, self.axis, self.anchor)
            return turn
        slide: _Pose = trimesh.transformations.translation_matrix(position * np.array(self.axis))
        return slide

    def posed(self, pose: _Pose, joint: float) -> list[NDArray[np.float64]]:
        """Return the corners of each solid in the world, given the part's pose and joint position."""
        moved = pose @ self.joint(joint)
        corners = []
        for solid in self.solids:
            if solid.jointed:
                corners.append(trimesh.transform_points(solid.points, moved))
            else:
                corners.append(trimesh.transform_points(solid.points, pose))
        return corners


def _pose_of(placement: PlacedPart) -> _Pose:
    """Return the pose of a part as a transform."""
    pose: _Pose = trimesh.transformations.quaternion_matrix(placement.quaternion)
    pose[:3, 3] = placement.position
    return pose


@lru_cache(maxsize=64)
def shape_of(kind: str, machines: Machines) -> CollisionShape:
    """Return the solids of a part: smartcar, block, flag, slope or wall.

    A wheel is the cylinder round its rollers. Visual geometry is left out, and a car is the first of the machines'.
    """
    model = machine_spec(kind, machines, visual=False).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    root = model.body(kind).id
    base = np.linalg.inv(_transform(data.xpos[root], data.xmat[root]))
    joints = [j for j in range(model.njnt) if model.joint(j).name in ("board", "hinge")]
    solids = []
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        touches = model.geom_contype[geom] or model.geom_conaffinity[geom]
        if not (body and touches) or model.body(body).name.startswith("roller_"):
            continue
        pose = base @ _transform(data.geom_xpos[geom], data.geom_xmat[geom])
        points = trimesh.transform_points(_mesh(model, geom).vertices, pose)
        jointed = any(model.jnt_bodyid[j] == body for j in joints)
        solids.append(Solid(model.geom(geom).name, points, jointed))
    if not joints:
        return CollisionShape(tuple(solids))
    hinge = model.jnt_type[joints[0]] == mujoco.mjtJoint.mjJNT_HINGE
    axis = base[:3, :3] @ data.xaxis[joints[0]]
    anchor = trimesh.transform_points(data.xanchor[joints], base)[0]
    return CollisionShape(tuple(solids), bool(hinge), tuple(axis), tuple(anchor))


def _transform(position: NDArray[np.float64], rotation: NDArray[np.float64]) -> _Pose:
    pose = np.eye(4)
    pose[:3, :3] = rotation.reshape(3, 3)
    pose[:3, 3] = position
    return pose


def _mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    """Return a collision geometry as a convex mesh in its own frame."""
    size = model.geom_size[geom]
    match mujoco.mjtGeom(model.geom_type[geom]):
        case mujoco.mjtGeom.mjGEOM_BOX:
            return trimesh.creation.box(2 * size)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            return trimesh.creation.cylinder(size[0], 2 * size[1], sections=64)
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return trimesh.creation.icosphere(subdivisions=1, radius=size[0])
        case mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[geom]
            start = model.mesh_vertadr[mesh]
            return trimesh.convex.convex_hull(
                model.mesh_vert[start : start + model.mesh_vertnum[mesh]].astype(float)
            )
    raise NotImplementedError(f"no solid for {model.geom(geom).name}: add its type here")


class Clearance(NamedTuple):
    """Distance of two sets of solids, and the closest pair."""

    distance_m: float
    """Negative for an overlap: that of the deepest pair, or of one that overlaps by more than 20 mm."""
    mine: str
    theirs: str


class Convex:
    """One convex solid in the world."""

    def __init__(self, name: str, points: NDArray[np.float64]) -> None:
        """Make the convex hull of (n, 3) points."""
        self.name = name
        self.points = points

    @cached_property
    def _hull(self) -> ConvexHull:
        return ConvexHull(self.points)

    @cached_property
    def corners(self) -> NDArray[np.float64]:
        """(m, 3): corners of the hull."""
        return np.ascontiguousarray(self.points[self._hull.vertices])

    @cached_property
    def shape(self) -> Any:
        """The hull for python-fcl."""
        number = np.zeros(len(self.points), int)
        number[self._hull.vertices] = np.arange(len(self.corners))
        faces = np.insert(number[self._hull.simplices], 0, 3, axis=1)
        return fcl.Convex(self.corners, len(faces), faces.ravel())


class Solids:
    """A set of convex solids."""

    def __init__(self, pieces: Sequence[Convex]) -> None:
        """Make a set of at least one piece."""
        self.pieces = tuple(pieces)
        self.boxes = np.array([(p.points.min(axis=0), p.points.max(axis=0)) for p in self.pieces])
        self.box = np.array([self.boxes[:, 0].min(axis=0), self.boxes[:, 1].max(axis=0)])

    def clearance(
        self, other_solids: Solids, within_m: float, shift: NDArray[np.float64] | None = None
    ) -> Clearance | None:
        """Return the distance of another set, moved by ``shift``; None if above ``within_m``, which may be negative."""
        if shift is None:
            shift = np.zeros(3)
        if _bounds(self.box[None], other_solids.box[None] + shift)[0, 0] > within_m:
            return None
        bounds = _bounds(self.boxes, other_solids.boxes + shift)
        closest: Clearance | None = None
        for flat in np.argsort(bounds, axis=None, kind="stable"):
            i, j = np.unravel_index(flat, bounds.shape)
            if closest is None:
                limit = within_m
            else:
                limit = closest.distance_m - _TOUCHING_M
            if bounds[i, j] > limit or (closest is not None and closest.distance_m < -_DEEP_M):
                break
            distance = _distance(self.pieces[i], other_solids.pieces[j], shift)
            if distance <= limit:
                closest = Clearance(distance, self.pieces[i].name, other_solids.pieces[j].name)
        return closest


def _distance(a: Convex, b: Convex, shift: NDArray[np.float64]) -> float:
    """Return the signed distance of two convex solids, the second one moved.

    FCL's own depths end the process where faces touch, so the depth is that of the origin in the hull of all
    differences between corners.
    """
    moved = fcl.CollisionObject(b.shape, fcl.Transform(shift))
    apart = float(
        fcl.distance(
            fcl.CollisionObject(a.shape), moved, fcl.DistanceRequest(), fcl.DistanceResult()
        )
    )
    if apart > _TOUCHING_M:
        return apart
    differences = (a.corners[:, None] - (b.corners + shift)[None]).reshape(-1, 3)
    return float(ConvexHull(differences).equations[:, 3].max())


def _bounds(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n, m) lower bounds of the signed distances of solids in these boxes."""
    apart = np.maximum(a[:, None, 0] - b[None, :, 1], b[None, :, 0] - a[:, None, 1])
    outside = np.linalg.norm(np.maximum(apart, 0.0), axis=2)
    return np.where(outside > 0.0, outside, apart.max(axis=2))


def convexes_of(placement: PlacedPart, machines: Machines) -> list[Convex]:
    """Return the solids of a placed part."""
    shape = shape_of(placement.kind, machines)
    points = shape.posed(_pose_of(placement), placement.joint)
    convexes = []
    for solid, corners in zip(shape.solids, points, strict=True):
        convexes.append(Convex(f"{placement.kind} {solid.name}", corners))
    return convexes


def sweep(situation: Situation, machines: Machines) -> Solids:
    """Return the swept volume of a bare situation: convex hulls of the moving solids at consecutive poses."""
    pieces = []
    for kind, poses, joints in _tracks(situation, machines):
        shape = shape_of(kind, machines)
        corners = [shape.posed(p, j) for p, j in zip(poses, joints, strict=True)]
        for number, solid in enumerate(shape.solids):
            path = [points[number] for points in corners]
            if not all(np.allclose(points, path[0]) for points in path):
                pieces += [
                    Convex(f"{kind} {solid.name}", np.vstack(pair)) for pair in pairwise(path)
                ]
    return Solids(pieces)


_Track = tuple[str, list[_Pose], list[float]]
"""Path of a part: its kind, and its pose and joint position at each sample."""


def _tracks(situation: Situation, machines: Machines) -> list[_Track]:
    grid = situation.grid
    (action,) = situation.acts
    parts = placements(grid, machines)
    if action in (Action.FOLD, Action.UNFOLD):
        slope = next(placement for placement in parts if placement.kind == "slope")
        angles = np.linspace(
            0.0, machines.slope.hinge_range_rad, 1 + math.ceil(math.pi / _STEP_RAD)
        )
        return [("slope", [_pose_of(slope)] * len(angles), angles.tolist())]
    if action in (Action.LIFT, Action.DROP):
        return _lifted(grid, machines)
    start = _pose_of(parts[0])
    poses = _path(grid, action, start, machines)
    tracks = [("smartcar", poses, [parts[0].joint] * len(poses))]
    if grid.cars[0, CarField.LOAD] != Kind.AIR:
        seat = np.linalg.inv(start) @ _pose_of(parts[1])
        tracks.append(
            (parts[1].kind, [pose @ seat for pose in poses], [parts[1].joint] * len(poses))
        )
    return tracks


def _lifted(grid: Grid, machines: Machines) -> list[_Track]:
    """Return the paths of board and load upwards; downwards they are the same."""
    car, *_ = cars = grid.cars.tolist()
    kind = Kind(car[CarField.LOAD] or grid.kind[tuple(car[: CarField.YAW])])
    yaw = 0
    if kind == Kind.FSLOPE:
        yaw = (car[CarField.YAW] + 2) % 4
    car[CarField.LOAD] = kind
    car[CarField.LOAD_YAW] = yaw
    above = placements(grid_of([], cars, grid.size), machines)
    x, y, z = car[: CarField.YAW]
    below, *_ = placements(grid_of([Piece(kind, (x, y, z), yaw)], [], grid.size), machines)
    return [
        ("smartcar", [_pose_of(above[0])] * 2, [0.0, above[0].joint]),
        (below.kind, [_pose_of(below), _pose_of(above[1])], [below.joint] * 2),
    ]


def _path(grid: Grid, action: Action, start: _Pose, machines: Machines) -> list[_Pose]:
    """Return the poses of a car that moves or turns."""
    if action == Action.ROTATE_LEFT:
        steps = math.ceil(math.pi / 2 / _STEP_RAD)
        angles = np.linspace(0.0, math.pi / 2, 1 + steps)
        return [start @ trimesh.transformations.rotation_matrix(a, (0, 0, 1)) for a in angles]
    body = next(grid.pieces(Kind.BODY), None)
    if body is None:
        dx, dy = DIRECTIONS[MOVE_DIRECTION[action]] * CELL_PITCH_M
        return [start, trimesh.transformations.translation_matrix((dx, dy, 0.0)) @ start]
    x, _, level = body.cell
    low = (level - 1) * LEVEL_HEIGHT_M
    high = ((level + 1) - 1) * LEVEL_HEIGHT_M
    if body.yaw == BACK:
        centre = x * CELL_PITCH_M
        heights = (low, high)
    else:
        centre = (x + 1) * CELL_PITCH_M
        heights = (high, low)
    fractions = np.linspace(0.0, 1.0, 1 + math.ceil(CELL_PITCH_M / _STEP_M))
    stations = (int(grid.cars[0, CarField.X]) + 0.5 + fractions) * CELL_PITCH_M
    poses = poses_along(
        (centre - CELL_PITCH_M, centre + CELL_PITCH_M), heights, stations, machines.car(0)
    )
    for pose in poses:
        pose[1, 3] = start[1, 3]
    return poses


def poses_along(
    ramp: tuple[float, float],
    heights: tuple[float, float],
    stations: NDArray[np.float64],
    car: SmartcarParameters,
) -> list[_Pose]:
    """Return the poses of a car with heading +x at these stations.

    Args:
        ramp: x of the begin and end of the incline, metres.
        heights: heights of the surface before and after it.
        stations: (n,) x of its frame, which is below the middle between the axles, metres.
        car: its wheel geometry.
    """
    reach = car.wheel_x_m + car.wheel_radius_m + CELL_PITCH_M
    xs = np.arange(stations.min() - reach, stations.max() + reach, _GRAIN_M)
    surface = np.interp(xs, ramp, heights)
    offsets = np.arange(-car.wheel_radius_m, car.wheel_radius_m + _GRAIN_M / 2, _GRAIN_M)
    rim = np.sqrt(np.maximum(car.wheel_radius_m**2 - offsets**2, 0.0))
    axle = np.max(
        [np.interp(xs + offset, xs, surface) + up for offset, up in zip(offsets, rim, strict=True)],
        axis=0,
    )
    return [_pose(x, xs, axle, car) for x in stations]


def _pose(
    x: float, xs: NDArray[np.float64], axle: NDArray[np.float64], car: SmartcarParameters
) -> _Pose:
    """Return the pose with the frame at x and both axles at their heights."""
    pitch = 0.0
    for _ in range(20):
        half = car.wheel_x_m * math.cos(pitch)
        middle = x - car.wheel_radius_m * math.sin(pitch)
        rear, front = np.interp([middle - half, middle + half], xs, axle)
        pitch = math.asin((front - rear) / (2 * car.wheel_x_m))
    up = np.array([-math.sin(pitch), 0.0, math.cos(pitch)])
    pose = np.eye(4)
    pose[:3, 0] = (math.cos(pitch), 0.0, math.sin(pitch))
    pose[:3, 2] = up
    pose[:3, 3] = np.array([middle, 0.0, (rear + front) / 2]) - car.wheel_radius_m * up
    return pose
