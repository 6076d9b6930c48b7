"""Trajectories as recordings of Rerun: world, poses, contacts and verdicts on one timeline; needs the extra ``rerun``.

Under ``world`` is what is seen, under ``design`` what is to be built, under ``cars`` the pose that each car believed to
have and its path, under ``contact`` the forces, and under ``actions`` what was begun and what the judge said.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M, cell_position
from craftsim.rendering.trajectory import SeenWorld, Trajectory
from craftsim.rendering.viewer.scene import floor_mesh, shapes_of
from craftsim.storage.extras import need
from craftsim.storage.writing import whole

if TYPE_CHECKING:
    import trimesh
    from rerun import RecordingStream, TimeColumn

_TIMELINE: Final = "simulated"
_GHOST: Final = (64, 168, 96, 60)
_W_LAST: Final = (1, 2, 3, 0)
"""The order of a quaternion's parts in Rerun, of those in MuJoCo, whose w is first."""


def need_rerun() -> None:
    """Raise InputError with the command that installs what is missing."""
    need("rerun", "files for Rerun need", "rerun")


def write_rerun(path: Path, trajectory: Trajectory) -> Path:
    """Write a trajectory as a recording of Rerun, whole or not at all; return its path.

    Its timeline is the simulated time in seconds. Raises InputError, with the command that installs it, where Rerun's
    SDK is not installed.
    """
    need_rerun()
    import rerun as rr
    from rerun import blueprint as rrb

    views = rrb.Horizontal(
        rrb.Spatial3DView(origin="/", contents=["world/**", "design/**", "cars/**"]),
        rrb.Vertical(rrb.TextLogView(origin="actions"), rrb.TimeSeriesView(origin="contact")),
        column_shares=(2, 1),
    )
    recording = rr.RecordingStream("craftsim")
    with whole(path) as partial:
        recording.save(partial, default_blueprint=rrb.Blueprint(views))
        recording.send_recording_name(trajectory.story.title)
        _log_world(recording, trajectory)
        _log_design(recording, trajectory)
        _log_cars(recording, trajectory)
        _log_contacts(recording, trajectory)
        _log_actions(recording, trajectory)
        recording.disconnect()
    return path


def _times(times_s: NDArray[np.float64] | list[float]) -> TimeColumn:
    import rerun as rr

    return rr.TimeColumn(_TIMELINE, duration=np.asarray(times_s, float))


def _mesh(mesh: trimesh.Trimesh, **look: Any) -> Any:
    import rerun as rr

    return rr.Mesh3D(
        vertex_positions=mesh.vertices,
        triangle_indices=mesh.faces,
        vertex_normals=mesh.vertex_normals,
        **look,
    )


def _log_world(recording: RecordingStream, trajectory: Trajectory) -> None:
    """Log the floor, the mesh of each body, and where each body is in each sample."""
    import rerun as rr

    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    area = floor_mesh(trajectory.story.recipe.grid.size)
    look: Any = area.visual
    picture = np.asarray(look.material.baseColorTexture.convert("RGB"))
    # Rerun counts the rows of a picture from its top, trimesh from its bottom.
    corners = np.column_stack([look.uv[:, 0], 1 - look.uv[:, 1]])
    floor = _mesh(area, vertex_texcoords=corners, albedo_texture=picture)
    recording.log("world/floor", floor, static=True)
    world = SeenWorld(trajectory.physics)
    shapes = shapes_of(world.model)
    entities = {}
    for body, mesh in shapes.items():
        entities[body] = f"world/{world.model.body(body).name}"
        look = mesh.visual
        solid = _mesh(mesh, vertex_colors=look.vertex_colors)
        recording.log(entities[body], solid, static=True)
    bodies = list(entities)
    positions = np.empty((len(trajectory), len(bodies), 3))
    quaternions = np.empty((len(trajectory), len(bodies), 4))
    for sample, qpos in enumerate(trajectory.qpos):
        data = world.at(qpos)
        positions[sample] = data.xpos[bodies]
        quaternions[sample] = data.xquat[bodies][:, _W_LAST]
    times = _times(trajectory.time)
    for number, entity in enumerate(entities.values()):
        poses = rr.Transform3D.columns(
            translation=positions[:, number], quaternion=quaternions[:, number]
        )
        recording.send_columns(entity, [times], poses)


def _log_design(recording: RecordingStream, trajectory: Trajectory) -> None:
    """Log what is to be built as a translucent box in each of its cells."""
    import rerun as rr

    if not trajectory.wanted:
        return
    half_size = np.array([CELL_PITCH_M, CELL_PITCH_M, LEVEL_HEIGHT_M]) / 2
    floors = np.array([cell_position(*piece.cell) for piece in trajectory.wanted])
    labels = [piece.kind.name.lower() for piece in trajectory.wanted]
    boxes = rr.Boxes3D(
        centers=floors + np.array([0, 0, half_size[2]]),
        half_sizes=[half_size] * len(floors),
        colors=[_GHOST] * len(floors),
        labels=labels,
        show_labels=False,
    )
    recording.log("design", boxes, static=True)


def _log_cars(recording: RecordingStream, trajectory: Trajectory) -> None:
    """Log where each car believed to be and where it should have been, as points above the floor of its own level."""
    import rerun as rr

    for car in range(trajectory.measured.shape[1]):
        heights = trajectory.pose(f"car {car}")[:, 2]
        for name, poses in (("measured", trajectory.measured), ("path", trajectory.path)):
            points = np.column_stack([poses[:, car, :2], heights])
            known = np.isfinite(points).all(axis=1)
            times = _times(trajectory.time[known])
            columns = rr.Points3D.columns(positions=points[known])
            recording.send_columns(f"cars/car_{car}/{name}", [times], columns)


def _log_contacts(recording: RecordingStream, trajectory: Trajectory) -> None:
    """Log the largest net force in newtons between two machines, where contacts were looked at."""
    import rerun as rr

    known = np.isfinite(trajectory.contact)
    forces = rr.Scalars.columns(scalars=trajectory.contact[known])
    recording.send_columns("contact/force_n", [_times(trajectory.time[known])], forces)


def _log_actions(recording: RecordingStream, trajectory: Trajectory) -> None:
    """Log each action where it begins, and what the judge says of it where it ends."""
    import rerun as rr

    times_s = []
    texts = []
    levels = []
    for attempt in trajectory.story.attempts:
        action = f"car {attempt.car} {attempt.action}"
        verdict = f"{action}: {attempt.result}"
        if attempt.reason:
            verdict += f": {attempt.reason}"
        level = rr.TextLogLevel.ERROR
        if attempt.agrees:
            level = rr.TextLogLevel.INFO
        times_s += [attempt.start_s, attempt.start_s + attempt.duration_s]
        texts += [action, verdict]
        levels += [rr.TextLogLevel.DEBUG, level]
    if not times_s:
        return
    columns = rr.TextLog.columns(text=texts, level=levels)
    recording.send_columns("actions", [_times(times_s)], columns)
