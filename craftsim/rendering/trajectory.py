"""Trajectories: what moved in a run, sample by sample, and what was asked for and found; recorded, written and read.

Films, plots and the viewer are made from them. A trajectory file is a NumPy archive without pickles;
docs/reference/reports.md describes its arrays.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal, Self, get_args

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import SAME_TIME_S, Attempt
from craftsim.checking.judge import Judge
from craftsim.checking.recipe import Recipe, check_recipe
from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import Cell, Kind, Piece
from craftsim.errors import InputError
from craftsim.models.measuring import READING
from craftsim.models.world import PhysicsWorld
from craftsim.rendering.ranges import MOMENT_S
from craftsim.reports.json_file import versions
from craftsim.storage import limits
from craftsim.storage.paths import is_file, is_folder
from craftsim.storage.reading import NamedArrays, read_arrays
from craftsim.storage.records import Listed, from_json, to_json
from craftsim.storage.writing import write_whole
from craftsim.workers.copying import Copyable

_SCHEMA_VERSION: Final = 1
"""Raised whenever something in a trajectory file changes its meaning or goes away."""
SUFFIX: Final = ".npz"
TRAJECTORIES: Final = "trajectories"
"""The folder of a run's trajectories."""
_BUNDLE: Final = "bundle.json"
"""What tells the folder of a replay bundle; other archives lie in it, too."""
MOST_SAMPLES: Final = 180_000
"""An hour of simulated time at the usual control period; what comes later is left out of a recording."""
MOST_BYTES: Final = limits.TRAJECTORY.content_bytes // 2
"""Of all samples together, so that a reader takes them; what comes later is left out."""
_FURTHEST_M: Final = 1e4
"""Largest coordinate of a machine, several times the largest world."""
_TEXT: Final = "story"
_ARRAYS: Final = ("time", "qpos", "ctrl", "force", "measured", "path", "contact")

GoalKind = Literal["block", "fslope", "body", "foot"]
_KIND_NAMES: Final[dict[Kind, GoalKind]] = {Kind[name.upper()]: name for name in get_args(GoalKind)}


@dataclass(frozen=True)
class GoalCell:
    """A cell of a design, and what it must hold."""

    kind: GoalKind
    cell: Cell
    yaw: int
    """Yaw of a slope, -1 where any will do."""


@dataclass(frozen=True)
class TrajectoryMetadata:
    """Origin of a trajectory and the attempts in it."""

    schema_version: int
    title: str
    versions: dict[str, str]
    recipe: Recipe
    """Recipe from the start of the run; a trajectory may begin later."""
    attempts: Listed[Attempt]
    """All that was tried from its first sample on."""
    poses: dict[str, int]
    """Of each machine that moves, by its name (``car 0``, ``block 3``): the column of ``qpos`` at which its x, y, z and
    unit quaternion (w first) begin."""
    motors: tuple[str, ...]
    """Names of the columns of ``ctrl`` and ``force``."""
    design: Listed[GoalCell] = ()
    """The building that is to be put up, where there is one."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A run, sampled at its start and after every control period.

    Example:
        >>> import craftsim
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> with TemporaryDirectory() as out:
        ...     _ = craftsim.validate("strip", out=out, record=True, trials=1)
        ...     trajectory = craftsim.Trajectory.read(next(Path(out).glob("trajectories/*.npz")))
        >>> trajectory.qpos.shape[0] == len(trajectory.time)
        True
        >>> trajectory.pose("car 0").shape[1]
        7
    """

    story: TrajectoryMetadata
    time: NDArray[np.float64]
    """(n,) simulated time in seconds, increasing."""
    qpos: NDArray[np.float64]
    """(n, nq) MuJoCo's positions of everything, bit for bit."""
    ctrl: NDArray[np.float32]
    """(n, nu) commands to the motors: rad/s of wheels and hinges, m/s of boards."""
    force: NDArray[np.float32]
    """(n, nu) what the motors gave: Nm of wheels and hinges, N of boards."""
    measured: NDArray[np.float32]
    """(n, n_cars, 3) the pose that each car believed to have: x and y in metres, and heading in radians."""
    path: NDArray[np.float32]
    """(n, n_cars, 3) where it should have been on the path that it drove; nan where it did not drive."""
    contact: NDArray[np.float32]
    """(n,) the largest net force in newtons between any two machines since the sample before; nan where no contacts
    were looked at."""

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Return the trajectory in a file.

        Raises InputError, naming the file, for one that is missing, damaged, too large or contradicts itself.
        """
        arrays: dict[str, Any] = dict(read_arrays(Path(path), limits.TRAJECTORY))
        try:
            if sorted(arrays) != sorted([_TEXT, *_ARRAYS]):
                contents = ", ".join(sorted(arrays)[:12]) or "nothing"
                raise InputError(f"not a trajectory: it holds {contents}")
            text = arrays.pop(_TEXT)
            if text.dtype != np.uint8 or text.ndim != 1:
                raise InputError(f"'{_TEXT}' is no text; allowed: the bytes of a JSON document")
            data = text.tobytes()
            # Before its keys are looked at: those of another version may differ. What else is wrong, the schema says.
            with suppress(ValueError, AttributeError, RecursionError):
                version = json.loads(data).get("schema_version")
                if version != _SCHEMA_VERSION:
                    raise InputError(
                        f"schema_version is {version}; this craftsim reads version {_SCHEMA_VERSION}"
                    )
            trajectory = cls(from_json(TrajectoryMetadata, data, _TEXT), **arrays)
            trajectory._check()
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
        return trajectory

    def write(self, path: str | Path) -> Path:
        """Write the trajectory into a file, whole or not at all; return its path."""
        arrays: NamedArrays = {_TEXT: np.frombuffer(to_json(self.story), np.uint8)}
        # Column by column: what rests, and what moves a little, packs well.
        arrays |= {name: np.asfortranarray(getattr(self, name)) for name in _ARRAYS}
        archive = io.BytesIO()
        np.savez_compressed(archive, allow_pickle=False, **arrays)
        return write_whole(path, archive.getvalue())

    def __len__(self) -> int:
        return len(self.time)

    @property
    def duration_s(self) -> float:
        """Simulated time from the first sample to the last."""
        return float(self.time[-1] - self.time[0])

    def pose(self, machine: str) -> NDArray[np.float64]:
        """Return the poses (n, 7) of a machine, such as ``car 0``: x, y, z in metres and a unit quaternion, w first."""
        if machine not in self.story.poses:
            raise InputError(
                f"there is no machine '{machine}'; there are {', '.join(self.story.poses)}"
            )
        column = self.story.poses[machine]
        return self.qpos[:, column : column + 7]

    def titled(self, title: str) -> Self:
        """Return the same under another title."""
        return replace(self, story=replace(self.story, title=title))

    @property
    def wanted(self) -> tuple[Piece, ...]:
        """The design, as pictures of the grid take it."""
        return tuple(
            Piece(Kind[goal.kind.upper()], goal.cell, goal.yaw) for goal in self.story.design
        )

    def at(self, time_s: float) -> int:
        """Return the number of the last sample that is not later than a time; the first where all are.

        Times that differ by SAME_TIME_S are the same.
        """
        return max(0, int(np.searchsorted(self.time, time_s + SAME_TIME_S, side="right")) - 1)

    @cached_property
    def physics(self) -> PhysicsWorld:
        """The world as its parts are compiled: to look at its model, not to be moved. Raises InputError where this
        version of craftsim makes another world of it."""
        recipe = self.story.recipe
        setup = recipe.setup
        physics = PhysicsWorld(
            recipe.grid, setup.simulation, recipe.goals, reset=False, machines=setup.machines
        )
        was = self.story.versions.get("craftsim")
        version = versions()["craftsim"]
        same = poses_of(physics) == self.story.poses and motors_of(physics) == self.story.motors
        if not same or physics.model.nq != self.qpos.shape[1]:
            raise InputError(
                f"the trajectory '{self.story.title}' was recorded with other machines than these "
                f"(craftsim {was}, this is {version}); record it again, or read it with that version"
            )
        return physics

    @cached_property
    def model(self) -> mujoco.MjModel:
        """Of MuJoCo, in which ``qpos`` are positions: the world with what is only seen."""
        return self.physics.seen_model()

    def _check(self) -> None:
        recipe = self.story.recipe
        n = 0
        if self.time.ndim:
            n = len(self.time)
        grid = check_recipe(recipe)
        motors = (n, len(self.story.motors))
        poses = (n, grid.n_cars, 3)
        shapes = {"time": (n,), "qpos": (n, *self.qpos.shape[1:2]), "ctrl": motors, "force": motors}
        shapes |= {"measured": poses, "path": poses, "contact": (n,)}
        for name, shape in shapes.items():
            array = getattr(self, name)
            kind = np.float64 if name in ("time", "qpos") else np.float32
            if array.shape != shape or array.dtype != kind:
                raise InputError(
                    f"'{name}' is {array.dtype} of shape {array.shape}; allowed: {np.dtype(kind)} of {shape}"
                )
        if n == 0 or not np.isfinite(self.time).all() or not (np.diff(self.time) > 0).all():
            raise InputError("'time' must be one or more finite and increasing numbers")
        for moment in (self.time[0], self.time[-1]):
            MOMENT_S.check("a number of 'time'", float(moment))
        if not np.isfinite(self.qpos).all():
            raise InputError("'qpos' holds what is no number")
        if any(not 0 <= column <= self.qpos.shape[1] - 7 for column in self.story.poses.values()):
            raise InputError("story.poses points outside of 'qpos'")
        for machine, column in self.story.poses.items():
            self._check_pose(machine, self.qpos[:, column : column + 7])
        length, width, height = grid.size
        for x, y, z in (goal.cell for goal in self.story.design):
            if not (0 <= x < length and 0 <= y < width and 1 <= z <= height + 1):
                raise InputError(f"story.design has the cell {(x, y, z)}, outside of the area")
        if any(not 0 <= attempt.car < grid.n_cars for attempt in self.story.attempts):
            raise InputError(
                f"story.attempts names a car that there is not; the world has {grid.n_cars}"
            )

    def _check_pose(self, machine: str, poses: NDArray[np.float64]) -> None:
        """Raise InputError for poses (n, 7) of a machine that are far away or turned by no unit quaternion."""
        with np.errstate(over="ignore"):
            lengths = np.linalg.norm(poses[:, 3:], axis=1)
        for wrong, fault in (
            (
                np.abs(poses[:, :3]).max(axis=1) > _FURTHEST_M,
                f"is further than {_FURTHEST_M:g} m away",
            ),
            (
                np.abs(lengths - 1) > limits.UNIT_LENGTH,
                "is turned by a quaternion whose length is not 1",
            ),
        ):
            if wrong.any():
                sample = int(wrong.argmax())
                raise InputError(
                    f"'qpos': {machine} {fault} at {self.time[sample]:.4g} s (sample {sample})"
                )


class Recorder(Copyable):
    """Takes a sample of a world after every control period, and makes a trajectory of them."""

    def __init__(self) -> None:
        """Record nothing yet."""
        self._samples: list[tuple[Any, ...]] = []

    def begin(self, judge: Judge) -> None:
        """Record a world from now on; what was recorded before is dropped."""
        self._judge = judge
        self._samples = []
        data = judge.physics.data
        n_cars = len(judge.physics.cars)
        numbers = len(data.qpos) + len(data.ctrl) + 3 * n_cars + 2
        self._most = min(MOST_SAMPLES, MOST_BYTES // (8 * numbers))
        self._look(judge.physics)
        judge.executor.observers.append(self._look)

    def _look(self, physics: PhysicsWorld) -> None:
        data = physics.data
        executor = self._judge.executor
        log = self._judge.log
        # A simulation that breaks down starts its time over: what it does then is no part of the run.
        if self._samples and (
            not self._samples[-1][0] < data.time or len(self._samples) == self._most
        ):
            return
        motors = data.ctrl.astype(np.float32), data.actuator_force.astype(np.float32)
        if log is None:
            contact = np.nan
        else:
            contact = log.period_n
        readings = executor.readings().tobytes()
        self._samples.append(
            (data.time, data.qpos.copy(), *motors, readings, executor.paths(), contact)
        )

    def trajectory(
        self, title: str, recipe: Recipe, attempts: Iterable[Attempt], design: Design | None = None
    ) -> Trajectory:
        """Return what was recorded so far: what it is of, what was done from the world's start, what was tried since
        the recording began, and the building that is to be put up.
        """
        physics = self._judge.physics
        n = len(self._samples)
        time, qpos, ctrl, force, read, path, contact = zip(*self._samples, strict=True)
        readings = np.frombuffer(b"".join(read), READING).reshape(n, -1)
        if design is not None:
            targets = design.targets
        else:
            targets = ()
        cells = tuple(
            GoalCell(_KIND_NAMES[target.kind], target.cell, target.yaw) for target in targets
        )
        metadata = (
            title,
            versions(),
            recipe,
            tuple(attempts),
            poses_of(physics),
            motors_of(physics),
            cells,
        )
        return Trajectory(
            TrajectoryMetadata(_SCHEMA_VERSION, *metadata),
            np.array(time),
            np.array(qpos),
            np.array(ctrl),
            np.array(force),
            np.stack([readings[name] for name in ("x", "y", "heading")], axis=2).astype(np.float32),
            np.array(path, np.float32),
            np.array(contact, np.float32),
        )


def trajectory_files(run: Path) -> list[Path]:
    """Return the trajectory files of a run's folder, or a trajectory file, by name. Raises InputError for none."""
    if not is_folder(run):
        if not is_file(run):
            raise InputError(
                f"{run}: no such file or folder; allowed: a run's folder or a trajectory file"
            )
        return [run]
    # What begins with a dot is what a kill left of one. An audit records in the bundles of its disagreements.
    file_name = f"trajectory{SUFFIX}"
    any_of = f"[!.]*{SUFFIX}"
    if is_file(run / _BUNDLE):
        patterns = [file_name]
    else:
        patterns = [f"{TRAJECTORIES}/{any_of}", any_of, f"bundles/*/{file_name}"]
    for pattern in patterns:
        files = sorted(run.glob(pattern))
        if files:
            return files
    raise InputError(f"{run}: no trajectories in it; run it again with --record trajectory")


def poses_of(physics: PhysicsWorld) -> dict[str, int]:
    """Return where in ``qpos`` the pose of each machine that moves begins, by its name."""
    model = physics.model
    names = physics.machine_names
    joints = (int(model.body_jntadr[body]) for body in names.roots)
    moving = names.names[len(names.names) - len(names.roots) :]
    return {name: int(model.jnt_qposadr[j]) for name, j in zip(moving, joints, strict=True)}


def motors_of(physics: PhysicsWorld) -> tuple[str, ...]:
    """Return the names of all motors."""
    return tuple(physics.model.actuator(i).name for i in range(physics.model.nu))


def show_at(
    model: mujoco.MjModel, data: mujoco.MjData, qpos: NDArray[np.float64], time_s: float = 0.0
) -> None:
    """Put everything where MuJoCo's positions ``qpos`` (nq,) say, in data that no simulation uses."""
    data.time = time_s
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)


class SeenWorld(Copyable):
    """A world as it is seen: its world with what is only seen, its cameras and markers, in a model of its own."""

    _bound = ("_data",)

    def __init__(self, physics: PhysicsWorld) -> None:
        """Build the world of a PhysicsWorld again."""
        self.model = physics.seen_model()
        self._physics = physics
        self._bind()
        names = [physics.model.geom(geom).name for geom in range(physics.model.ngeom)]
        self._geoms = np.array([self.model.geom(name).id for name in names], np.intp)
        """By geom of the physics, which has fewer: its number here."""

    def _bind(self) -> None:
        self._data = mujoco.MjData(self.model)

    def at(self, qpos: NDArray[np.float64]) -> mujoco.MjData:
        """Return data with everything where ``qpos`` (nq,) say, and as drawn; the next call overwrites it."""
        for name in ("body_pos", "body_quat", "hfield_data"):
            getattr(self.model, name)[:] = getattr(self._physics.model, name)
        for name in ("geom_pos", "geom_quat", "geom_size"):
            getattr(self.model, name)[self._geoms] = getattr(self._physics.model, name)
        show_at(self.model, self._data, qpos)
        return self._data

    def now(self) -> mujoco.MjData:
        """Return the data with everything where it is in the PhysicsWorld; the next call overwrites it."""
        return self.at(self._physics.data.qpos.copy())
