"""The bare situations: each action with nothing around but what it needs, and the way its solids take."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import trimesh

from craftsim.discrete.geometry import CELL_PITCH_M, DIRECTIONS, LEVEL_HEIGHT_M
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import MOVE_DIRECTION, Action
from craftsim.mjcf.parameters import Machines
from craftsim.validation.contexts.context import BACK, FORWARD, LEFT
from craftsim.validation.neighbourhoods.bodies import Convex, Solids
from craftsim.validation.neighbourhoods.scenery import MIDDLE, CarRow, Scenery, Thing
from craftsim.validation.neighbourhoods.solids import Pose, figure_of, pose_of
from craftsim.validation.neighbourhoods.surface import poses_along

LEVEL: Final = 2
"""Level of the acting car, or of the foot of its ramp: above it and below it there is room for neighbours."""
_STEP_RAD: Final = math.radians(3)
"""A chord of this angle lies 0.08 mm inside the arc of a turning load's corner, 0.1 mm inside the flap lip's."""
_STEP_M: Final = 0.01
"""On a ramp."""
_LOADS: Final = (Kind.AIR, Kind.BLOCK, Kind.FSLOPE)
_MOVES: Final = {FORWARD: Action.MOVE_RIGHT, LEFT: Action.MOVE_FORWARD, BACK: Action.MOVE_LEFT}
"""For a car that heads +x; a move to the right is the mirror image of one to the left."""


@dataclass(frozen=True)
class Situation:
    """One action of a car at column (0, 0) that heads +x, with all that the action needs and nothing else."""

    name: str
    action: Action
    scenery: Scenery
    symmetric: bool = True
    """Whether it is its own mirror image."""

    @property
    def car(self) -> CarRow:
        """The row of the acting car."""
        return self.scenery.cars[0]


def situations() -> Iterator[Situation]:
    """Yield the bare situations; left out are mirror images, and flags, which have a block's shape."""
    for load in _LOADS:
        yield from _flat(load)
        yield from _on_ramps(load)
    for kind in (Kind.BLOCK, Kind.FSLOPE):
        own = (kind, (0, 0, LEVEL), BACK)
        under = Scenery((own,), (_car(LEVEL),))
        yield Situation(f"LIFT/load={_NAMES[kind]}", Action.LIFT, under)
        yield Situation(f"DROP/load={_NAMES[kind]}", Action.DROP, Scenery((), (_car(LEVEL, kind),)))
    floor = _floor(-1)
    for kind, action in ((Kind.FSLOPE, Action.UNFOLD), (Kind.BODY, Action.FOLD)):
        slope = (kind, (0, 0, LEVEL), BACK)
        yield Situation(action.name, action, Scenery((slope, *floor), (_car(LEVEL),)))


_NAMES: Final = {Kind.AIR: "none", Kind.BLOCK: "block", Kind.FSLOPE: "slope"}


def _car(level: int, load: Kind = Kind.AIR, half: int = 0) -> CarRow:
    return 0, 0, level, FORWARD, load, BACK if load == Kind.FSLOPE else 0, half


def _floor(*columns: int) -> tuple[Thing, ...]:
    return tuple((Kind.BLOCK, (x, 0, LEVEL - 1), 0) for x in columns)


def _flat(load: Kind) -> Iterator[Situation]:
    turn = Situation(
        f"ROTATE_LEFT/load={_NAMES[load]}", Action.ROTATE_LEFT, Scenery((), (_car(LEVEL, load),)), False
    )
    yield turn
    for way, (dx, dy), name in (
        (FORWARD, (1, 0), "forward"),
        (LEFT, (0, 1), "left"),
        (BACK, (-1, 0), "back"),
    ):
        floor = (Kind.BLOCK, (dx, dy, LEVEL - 1), 0)
        scenery = Scenery((floor,), (_car(LEVEL, load),))
        yield Situation(f"MOVE-{name}/load={_NAMES[load]}", _MOVES[way], scenery, way != LEFT)


def _on_ramps(load: Kind) -> Iterator[Situation]:
    """Yield the three moves up a ramp and the three down; the ramp begins at the car's column plus ``foot``."""
    for stage, name in enumerate(("onto-foot", "up", "off-top")):
        foot = 1 - stage
        ramp = (
            (Kind.BODY, (foot + 1, 0, LEVEL), BACK),
            (Kind.BLOCK, (foot + 2, 0, LEVEL), 0),
            *_floor(foot - 1),
        )
        car = _car(LEVEL + (stage == 2), load, stage)
        yield Situation(f"MOVE-{name}/load={_NAMES[load]}", Action.MOVE_RIGHT, Scenery(ramp, (car,)))
    for stage, name in enumerate(("onto-top", "down", "off-foot")):
        body = 1 - stage
        ramp = (
            (Kind.BODY, (body, 0, LEVEL), FORWARD),
            (Kind.BLOCK, (body - 1, 0, LEVEL), 0),
            *_floor(body + 2),
        )
        car = _car(LEVEL + (stage < 2), load, (0, 2, 1)[stage])
        yield Situation(f"MOVE-{name}/load={_NAMES[load]}", Action.MOVE_RIGHT, Scenery(ramp, (car,)))


def sweep(situation: Situation, machines: Machines) -> Solids:
    """Return the volume that the moving solids of a situation sweep: convex hulls of consecutive poses.

    What does not move is left out: a car that folds, the base of its slope.
    """
    pieces = []
    for track in _tracks(situation, machines):
        figure = figure_of(track.kind, machines)
        corners = [figure.posed(p, j) for p, j in zip(track.poses, track.joints, strict=True)]
        for number, solid in enumerate(figure.solids):
            path = [points[number] for points in corners]
            if all(np.allclose(points, path[0]) for points in path):
                continue
            name = f"{track.kind} {solid.name}"
            pieces += [Convex(name, np.vstack(pair)) for pair in pairwise(path)]
    return Solids(pieces)


@dataclass(frozen=True)
class _Track:
    """A part on its way: its pose and the position of its joint at each sample."""

    kind: str
    poses: list[Pose]
    joints: list[float]


def _tracks(situation: Situation, machines: Machines) -> list[_Track]:
    parts = situation.scenery.parts(machines)
    if situation.action in (Action.FOLD, Action.UNFOLD):
        slope = next(part for part in parts if part.kind == "slope")
        angles = np.linspace(0.0, machines.slope.hinge_range_rad, 1 + math.ceil(math.pi / _STEP_RAD))
        return [_Track("slope", [pose_of(slope)] * len(angles), angles.tolist())]
    if situation.action in (Action.LIFT, Action.DROP):
        return _lifted(situation, machines)
    start = pose_of(parts[0])
    poses = _way(situation, start, machines)
    tracks = [_Track("smartcar", poses, [parts[0].joint] * len(poses))]
    if situation.car[4] != Kind.AIR:
        seat = np.linalg.inv(start) @ pose_of(parts[1])
        tracks.append(_Track(parts[1].kind, [pose @ seat for pose in poses], [parts[1].joint] * len(poses)))
    return tracks


def _lifted(situation: Situation, machines: Machines) -> list[_Track]:
    """Return the board and the load on their way up; down it is the same."""
    kind = situation.car[4] or situation.scenery.things[0][0]
    up = Scenery((), (_car(LEVEL, kind),)).parts(machines)
    down = Scenery(((kind, (0, 0, LEVEL), BACK),), ()).parts(machines)[0]
    return [
        _Track("smartcar", [pose_of(up[0])] * 2, [0.0, up[0].joint]),
        _Track(down.kind, [pose_of(down), pose_of(up[1])], [down.joint] * 2),
    ]


def _way(situation: Situation, start: Pose, machines: Machines) -> list[Pose]:
    """Return the poses of a car that moves or turns."""
    if situation.action == Action.ROTATE_LEFT:
        steps = math.ceil(math.pi / 2 / _STEP_RAD)
        angles = np.linspace(0.0, math.pi / 2, 1 + steps)
        return [start @ trimesh.transformations.rotation_matrix(a, (0, 0, 1)) for a in angles]
    body = next((thing for thing in situation.scenery.things if thing[0] == Kind.BODY), None)
    if body is None:
        dx, dy = DIRECTIONS[MOVE_DIRECTION[situation.action]] * CELL_PITCH_M
        return [start, trimesh.transformations.translation_matrix((dx, dy, 0.0)) @ start]
    _, (column, _, _), yaw = body
    centre = (column + MIDDLE + (0.0 if yaw == BACK else 1.0)) * CELL_PITCH_M
    low, high = (level * LEVEL_HEIGHT_M for level in (LEVEL - 1, LEVEL))
    heights = (low, high) if yaw == BACK else (high, low)
    stations = (MIDDLE + 0.5 + np.linspace(0.0, 1.0, 1 + math.ceil(CELL_PITCH_M / _STEP_M))) * CELL_PITCH_M
    poses = poses_along((centre - CELL_PITCH_M, centre + CELL_PITCH_M), heights, stations, machines.car(0))
    for pose in poses:
        pose[1, 3] = start[1, 3]
    return poses
