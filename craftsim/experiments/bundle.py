"""Replay bundles: folders with everything needed to reproduce a failure, and the replay that checks the reproduction.

A bundle holds the recipe, the attempts of its last step, the drawn physics, the full state before and after, the
contacts, and the scene as MJCF. It contains no code: text, and NumPy arrays that are read without pickle.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import Attempt
from craftsim.checking.judge import Judge
from craftsim.checking.recipe import Recipe, check_recipe, limit_time, perform_step, run_up, start
from craftsim.errors import InputError
from craftsim.experiments.experiment import Failure, Result, TrialRecord
from craftsim.experiments.session import Session
from craftsim.models.composition import world_spec
from craftsim.models.config import SimulationConfig
from craftsim.models.exporting import write_mjcf
from craftsim.models.world import PhysicsWorld
from craftsim.reports.json_file import versions
from craftsim.skills.executor import Observer
from craftsim.skills.library import check_known
from craftsim.storage import limits
from craftsim.storage.folders import directory_within
from craftsim.storage.paths import exists
from craftsim.storage.reading import NamedArrays, read_arrays
from craftsim.storage.records import Listed, read_json_record, to_json
from craftsim.storage.writing import write_whole

_SCHEMA_VERSION: Final = 6
"""Incremented whenever something in a bundle changes its meaning or is removed."""

BUNDLE_FILE: Final = "bundle.json"
PHYSICS_FILE: Final = "physics.npz"
BEFORE: Final = "before.npz"
AFTER: Final = "after.npz"
CONTACTS: Final = "contacts.csv"
SCENE: Final = "scene"
FILM: Final = "film.mp4"
TRAJECTORY_FILE: Final = "trajectory.npz"
"""Optional trajectory of the last step and a short time after it, shown in the film."""
RECORDING_FILE: Final = "recording.json.gz"
"""Optional, the same for the player in report.html."""

BUNDLE_S: Final = 600.0
_LATE: Final = 1.25
_LATE_S: Final = 4.0
"""By what factor, and by how much more, a replay may take longer than what it shows: versions differ."""


@dataclass(frozen=True)
class Bundle:
    """The contents of ``bundle.json``."""

    schema_version: int
    key: str
    versions: dict[str, str]
    recipe: Recipe
    attempts: Listed[Attempt]
    """One for each action of the last step."""
    start_s: float
    end_s: float

    @property
    def most_s(self) -> float:
        """Limit of the simulated time of a replay."""
        # Where the simulation broke down it started over, and so did its time.
        ends = (attempt.start_s + attempt.duration_s for attempt in self.attempts)
        return _LATE * max(self.start_s, self.end_s, *ends) + _LATE_S


@dataclass(frozen=True)
class Recorded:
    """A bundle with its arrays."""

    folder: Path
    bundle: Bundle
    arrays: dict[str, NamedArrays]
    """By file name: the drawn physics, and the state before and after the last step."""


def state_of(physics: PhysicsWorld) -> NamedArrays:
    """Return copies of the complete state of a PhysicsWorld, including what MuJoCo's state vector omits."""
    names = ("time", "qpos", "qvel", "act", "ctrl", "qacc_warmstart", "tree_asleep")
    state = {name: np.array(getattr(physics.data, name)) for name in names}
    return state | {"sleep_policy": physics.model.tree_sleep_policy.copy()}


def physics_of(physics: PhysicsWorld) -> NamedArrays:
    """Return copies of the model parameters that randomization draws."""
    return {name: array.copy() for name, array in vars(physics.baseline).items()}


def write_bundle(
    folder: Path, key: str, recipe: Recipe, attempts: tuple[Attempt, ...] | None = None
) -> Bundle:
    """Run a recipe, write the bundle of its last step into a folder in place of an older one, and return its contents.

    ``key`` is that of the trial. Raises InputError if the folder cannot be written, and ReplayError if the re-run does
    not reproduce the original ``attempts``.
    """
    judge = run_up(recipe)
    before = state_of(judge.physics)
    start_s = judge.physics.time_s
    repeated_attempts = perform_step(judge, recipe.steps[-1])
    if attempts is not None and attempts != repeated_attempts:
        raise ReplayError(
            f"{key} came out otherwise when it was re-run: {repeated_attempts} for {attempts}"
        )
    bundle = Bundle(
        _SCHEMA_VERSION, key, versions(), recipe, repeated_attempts, start_s, judge.physics.time_s
    )
    directory_within(folder.parent, folder.name)
    try:
        _write(folder, bundle, judge, before)
    except OSError as error:
        raise InputError(f"cannot write the replay bundle {folder}: {error.strerror}") from error
    return bundle


class ReplayError(RuntimeError):
    """A re-run on the same machine and version gave another result."""


def _write(folder: Path, bundle: Bundle, judge: Judge, before: NamedArrays) -> None:
    for name in (BUNDLE_FILE, FILM, TRAJECTORY_FILE, RECORDING_FILE):
        (folder / name).unlink(missing_ok=True)
    physics = judge.physics
    for name, arrays in (
        (PHYSICS_FILE, physics_of(physics)),
        (BEFORE, before),
        (AFTER, state_of(physics)),
    ):
        # In memory first, for a zip archive cannot be closed on a full disk.
        archive = io.BytesIO()
        np.savez_compressed(archive, allow_pickle=False, **arrays)
        write_whole(folder / name, archive.getvalue())
    assert judge.log is not None
    judge.log.write(folder / CONTACTS)
    recipe = bundle.recipe
    config = recipe.setup.simulation or SimulationConfig()
    spec = world_spec(recipe.grid, config, recipe.setup.machines, recipe.goals)
    write_mjcf(directory_within(folder, SCENE) / "site.xml", spec)
    # Written last, so that a folder with this file is a whole bundle.
    write_whole(folder / BUNDLE_FILE, to_json(bundle))


def read_bundle(folder: Path, of_own_run: bool = False) -> Recorded:
    """Read and check a bundle. Raises InputError, naming the file, for one that is missing, damaged or too large.

    Modules of skills that it names are imported only for a bundle of this run (``of_own_run``); otherwise they must
    have been imported before.
    """
    path = folder / BUNDLE_FILE
    if not exists(path):
        bundles = sorted(file.parent for file in folder.glob(f"bundles/*/{BUNDLE_FILE}"))
        example = ""
        if bundles:
            example = f", such as {bundles[0]}"
        raise InputError(f"{path}: no such file; give the folder of a replay bundle{example}")
    bundle = read_json_record(path, Bundle, limits.BUNDLE)
    try:
        _check_text(bundle)
        if not of_own_run:
            check_known(bundle.recipe.setup.skills)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    arrays = {
        name: read_arrays(folder / name, limits.ARRAYS) for name in (PHYSICS_FILE, BEFORE, AFTER)
    }
    return Recorded(folder, bundle, arrays)


def _check_text(bundle: Bundle) -> None:
    """Raise InputError for an inconsistent bundle, or one whose replay would exceed the limits."""
    recipe = bundle.recipe
    version = bundle.schema_version
    if version != _SCHEMA_VERSION:
        raise InputError(
            f"schema_version is {version}; this craftsim reads version {_SCHEMA_VERSION}"
        )
    if not recipe.steps:
        raise InputError("recipe.steps is empty; a bundle shows its last step")
    check_recipe(recipe)
    acts = [(act.car, act.action) for act in recipe.steps[-1].acts]
    if not acts:
        raise InputError(
            "recipe.steps: the last step has no actions; a bundle shows what became of them"
        )
    if acts != [(attempt.car, attempt.action) for attempt in bundle.attempts]:
        raise InputError(
            f"attempts: {len(bundle.attempts)}, but the last step has {len(acts)} actions; "
            "allowed: one for each of them, in their order"
        )
    config = recipe.setup.simulation
    most_s = bundle.most_s
    times = [bundle.start_s, bundle.end_s]
    for a in bundle.attempts:
        times.extend((a.start_s, a.duration_s))
    if not all(0 <= time < math.inf for time in times):
        raise InputError("start_s, end_s and the times of attempts must be 0 or more, and finite")
    starts = []
    for step in recipe.steps:
        for start_s in step.starts_s:
            starts.append(start_s)
    late = [start_s for start_s in starts if not 0 <= start_s <= most_s]
    if late:
        raise InputError(
            f"recipe.steps: starts_s has {late[0]:.6g}; allowed: 0 to the end, {most_s:.6g} s"
        )
    steps = most_s / config.timestep_s
    if steps > limits.PHYSICS_STEPS:
        raise InputError(
            f"end_s and attempts claim {bundle.end_s:.6g} s of simulated time, which may take {steps:.3g} physics "
            f"steps; allowed: at most {limits.PHYSICS_STEPS}"
        )
    n_acts = sum(len(step.acts) for step in recipe.steps)
    fit = int(limits.ACTIONS_WITHOUT_TIME + most_s / config.control_period_s)
    if n_acts > fit:
        raise InputError(
            f"recipe.steps: {n_acts} actions do not fit into the {bundle.end_s:.6g} s that end_s claims; "
            f"allowed: at most {fit}"
        )


def write_bundles(session: Session, recipes: Mapping[int, Callable[[], Recipe]]) -> dict[int, str]:
    """Write the missing bundles of trials, given functions that return their recipes, by trial index.

    Returns the folders, relative to the run's, by index. Raises InputError for one that cannot be written.
    """
    out = session.out
    records = session.records
    assert out is not None
    folders = {number: f"bundles/{number:05d}" for number in recipes}
    places = {number: out.resolve() / folder for number, folder in folders.items()}
    jobs = {
        records.of_trial(number)["key"]: (place, records.of_trial(number), recipes[number])
        for number, place in places.items()
        if not (place / BUNDLE_FILE).exists()  # it is written last
    }
    answers = session.map(None, jobs, _write_one, "writing replay bundles", timeout_s=BUNDLE_S)
    for key, answer in answers.items():
        if isinstance(answer, Failure):
            raise InputError(
                f"no replay bundle of the trial '{key}': {answer.text}; all trials are kept in {out}: "
                "--resume tries the bundle again"
            )
    return folders


def _write_one(job: tuple[Path, TrialRecord, Callable[[], Recipe]]) -> Result:
    """Write one bundle, whose attempts must equal those of its record."""
    folder, record, recipe = job
    write_bundle(folder, record["key"], recipe(), tuple(map(Attempt.of, record["attempts"])))
    return Result(agrees=True)


DECISIVE: Final = ("craftsim", "mujoco", "numpy")
"""Packages whose versions determine bit equality; with other versions poses are compared with a tolerance."""
POSITION_M: Final = 0.002
"""Tolerance of positions with other versions: the effect of a finer time step."""
ANGLE_RAD: Final = 0.01
_LENGTH: Final = 0.01
"""Tolerance for the length of a recorded quaternion; what differs by less is compared."""

_Watch = Callable[[Judge], AbstractContextManager[Observer | None]]
"""Given the world before the last step, returns a context whose value observes it."""


@dataclass(frozen=True)
class Replay:
    """A bundle's last step, re-run."""

    changed: dict[str, tuple[str, str]]
    """Decisive versions that differ: (the bundle's, the installed)."""
    differing: tuple[str, ...]
    """Arrays that are not bit-equal, by file and name."""
    position_m: float
    angle_rad: float
    attempts: tuple[Attempt, ...]
    same_results: bool
    """Whether every action has the recorded result and finding."""

    @property
    def reproduced(self) -> bool:
        """Whether everything is bit-equal, or, with other versions, within the tolerance."""
        if not self.changed:
            return not self.differing and self.same_results
        return self.same_results and self.position_m <= POSITION_M and self.angle_rad <= ANGLE_RAD


def replay(recorded: Recorded, watch: _Watch = lambda judge: nullcontext()) -> Replay:
    """Re-run a bundle and compare.

    Raises InputError if the recipe gives no valid world or takes longer than recorded, or if arrays do not fit it.
    """
    bundle = recorded.bundle
    try:
        judge = start(bundle.recipe)
    except InputError as error:
        raise InputError(f"{recorded.folder / BUNDLE_FILE}: {error}") from error
    physics = judge.physics
    drawn_physics = physics_of(physics)
    start_state = state_of(physics)
    for file, arrays in (
        (PHYSICS_FILE, drawn_physics),
        (BEFORE, start_state),
        (AFTER, start_state),
    ):
        _check_shapes(recorded.folder / file, recorded.arrays[file], arrays)
    for file in (BEFORE, AFTER):
        _check_poses(recorded.folder / file, physics.model, recorded.arrays[file]["qpos"])
    subject = (
        f"{recorded.folder / BUNDLE_FILE}: the recipe, which end_s says takes {bundle.end_s:.4g} s,"
    )
    limit_time(judge, bundle.most_s, subject)
    for step in bundle.recipe.steps[:-1]:
        perform_step(judge, step)
    before = state_of(physics)
    with watch(judge) as observer:
        if observer is not None:
            judge.executor.observers.append(observer)
        attempts = perform_step(judge, bundle.recipe.steps[-1])
        after = state_of(physics)  # who watches may let it go on
    differing = []
    for file, arrays in ((PHYSICS_FILE, drawn_physics), (BEFORE, before), (AFTER, after)):
        for name, array in arrays.items():
            if recorded.arrays[file][name].tobytes() != array.tobytes():
                differing.append(f"{file}: {name}")
    if (bundle.start_s, bundle.end_s) != (before["time"], after["time"]):
        differing.append("start_s and end_s")
    if bundle.attempts != attempts:
        differing.append("the attempts")
    position_m, angle_rad = _largest_pose_change(
        physics.model, recorded.arrays[AFTER]["qpos"], after["qpos"]
    )
    installed = versions()
    changed = {}
    for package in DECISIVE:
        recorded_version = bundle.versions.get(package, "unknown")
        if recorded_version != installed[package]:
            changed[package] = (recorded_version, installed[package])
    return Replay(
        changed=changed,
        differing=tuple(differing),
        position_m=position_m,
        angle_rad=angle_rad,
        attempts=attempts,
        same_results=_results(bundle.attempts) == _results(attempts),
    )


def _results(attempts: Iterable[Attempt]) -> list[tuple[str, str]]:
    """Return the result and the finding of each attempt."""
    return [(attempt.result, attempt.finding) for attempt in attempts]


def _check_shapes(file: Path, recorded: NamedArrays, replayed: NamedArrays) -> None:
    unknown = set(recorded) - set(replayed)
    if unknown:
        raise InputError(f"{file}: has an unknown array '{min(unknown)[:40]}'")
    for name, array in replayed.items():
        if name not in recorded:
            raise InputError(f"{file}: has no array '{name}'")
        recorded_form = f"{recorded[name].dtype} {recorded[name].shape}"
        expected_form = f"{array.dtype} {array.shape}"
        if recorded_form != expected_form:
            raise InputError(
                f"{file}: array '{name}' is {recorded_form}, but the recipe's world has {expected_form}"
            )


def _check_poses(file: Path, model: mujoco.MjModel, qpos: NDArray[np.generic]) -> None:
    """Raise InputError for numbers that are none, and for rotations that are not unit quaternions."""
    first = model.jnt_qposadr[model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)]
    with np.errstate(over="ignore"):
        lengths = np.linalg.norm(qpos[first[:, None] + np.arange(3, 7)], axis=1)
    unit = np.abs(lengths - 1.0) <= _LENGTH
    if not (np.isfinite(qpos).all() and unit.all()):
        raise InputError(
            f"{file}: array 'qpos' holds what is no pose; allowed: finite numbers, and quaternions of length 1"
        )


def _largest_pose_change(
    model: mujoco.MjModel, recorded: NDArray[np.generic], replayed: NDArray[np.generic]
) -> tuple[float, float]:
    """Return the largest distance and the largest angle between the poses of the free bodies of two states."""
    first = model.jnt_qposadr[model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)]
    recorded_poses = recorded[first[:, None] + np.arange(7)]
    replayed_poses = replayed[first[:, None] + np.arange(7)]
    distance = np.linalg.norm(recorded_poses[:, :3] - replayed_poses[:, :3], axis=1).max(
        initial=0.0
    )
    # A rotation has two quaternions; the chord to the nearer one is twice the sine of a quarter of the angle.
    a = recorded_poses[:, 3:]
    b = replayed_poses[:, 3:]
    chord = np.minimum(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))
    return float(distance), float(4 * np.arcsin(np.clip(chord / 2, 0.0, 1.0)).max(initial=0.0))
