"""Replay of bundles: re-run the recipe and compare with the recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import Attempt
from craftsim.checking.episode import do, limit_time, start
from craftsim.checking.judge import Judge
from craftsim.errors import InputError
from craftsim.experiments.bundle import AFTER, BEFORE, PHYSICS, TEXT, Recorded, physics_of, state_of
from craftsim.reports.json_file import versions
from craftsim.skills.executor import Observer
from craftsim.storage.reading import Arrays

DECISIVE: Final = ("craftsim", "mujoco", "numpy")
"""Packages whose versions determine bit equality; with other versions poses are compared with a tolerance."""
POSITION_M: Final = 0.002
"""Tolerance of positions with other versions: the effect of a finer time step."""
ANGLE_RAD: Final = 0.01

Watch = Callable[[Judge], AbstractContextManager[Observer | None]]
"""Given the world before the last step, returns a context whose value observes it."""


@dataclass(frozen=True)
class Replay:
    """A bundle's last step, re-run."""

    changed: dict[str, tuple[str, str]]
    """Decisive versions that differ: (the bundle's, the installed)."""
    differing: tuple[str, ...]
    """Arrays that are not bit-equal, by file and name."""
    position_m: float
    """Largest difference of a final position."""
    angle_rad: float
    """Largest difference of a final orientation."""
    attempts: tuple[Attempt, ...]
    same_results: bool
    """Whether every action has the recorded result and finding."""

    @property
    def reproduced(self) -> bool:
        """Whether everything is bit-equal, or, with other versions, within the tolerance."""
        if not self.changed:
            return not self.differing and self.same_results
        return self.same_results and self.position_m <= POSITION_M and self.angle_rad <= ANGLE_RAD


def unwatched(judge: Judge) -> AbstractContextManager[None]:
    """Observe nothing."""
    return nullcontext()


def replay(recorded: Recorded, watch: Watch = unwatched) -> Replay:
    """Re-run a bundle and compare.

    Raises InputError if the recipe gives no valid world or takes longer than recorded, or if arrays do not fit it.
    """
    bundle = recorded.bundle
    try:
        judge = start(bundle.recipe)
    except InputError as error:
        raise InputError(f"{recorded.folder / TEXT}: {error}") from error
    physics = judge.physics
    drawn = physics_of(physics)
    begun = state_of(physics)
    for file, arrays in ((PHYSICS, drawn), (BEFORE, begun), (AFTER, begun)):
        _check_shapes(recorded.folder / file, recorded.arrays[file], arrays)
    limit_time(
        judge,
        bundle.most_s,
        f"{recorded.folder / TEXT}: the recipe, which end_s says takes {bundle.end_s:.4g} s,",
    )
    for step in bundle.recipe.steps[:-1]:
        do(judge, step)
    before = state_of(physics)
    with watch(judge) as observer:
        if observer is not None:
            judge.executor.observers.append(observer)
        attempts = do(judge, bundle.recipe.steps[-1])
        after = state_of(physics)  # who watches may let it go on
    differing = [
        f"{file}: {name}"
        for file, arrays in ((PHYSICS, drawn), (BEFORE, before), (AFTER, after))
        for name, array in arrays.items()
        if recorded.arrays[file][name].tobytes() != array.tobytes()
    ]
    if (bundle.start_s, bundle.end_s) != (before["time"], after["time"]):
        differing.append("start_s and end_s")
    if bundle.attempts != attempts:
        differing.append("the attempts")
    position_m, angle_rad = _apart(physics.model, recorded.arrays[AFTER]["qpos"], after["qpos"])
    return Replay(
        changed=_changed(bundle.versions),
        differing=tuple(differing),
        position_m=position_m,
        angle_rad=angle_rad,
        attempts=attempts,
        same_results=_results(bundle.attempts) == _results(attempts),
    )


def _results(attempts: Sequence[Attempt]) -> list[tuple[str, str]]:
    return [(attempt.result, attempt.finding) for attempt in attempts]


def _changed(was: dict[str, str]) -> dict[str, tuple[str, str]]:
    now = versions()
    pairs = {package: (was.get(package, "unknown"), now[package]) for package in DECISIVE}
    return {package: pair for package, pair in pairs.items() if pair[0] != pair[1]}


def _check_shapes(file: Path, was: Arrays, now: Arrays) -> None:
    if unknown := set(was) - set(now):
        raise InputError(f"{file}: has an unknown array '{min(unknown)[:40]}'")
    for name, array in now.items():
        if name not in was:
            raise InputError(f"{file}: has no array '{name}'")
        if (was[name].shape, was[name].dtype) != (array.shape, array.dtype):
            raise InputError(
                f"{file}: array '{name}' is {was[name].dtype} {was[name].shape}, but the recipe's world "
                f"has {array.dtype} {array.shape}"
            )


def _apart(model: mujoco.MjModel, was: NDArray[np.generic], now: NDArray[np.generic]) -> tuple[float, float]:
    """Return the largest distance and the largest angle between the poses of the free bodies of two states."""
    start = model.jnt_qposadr[model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)]
    then, here = was[start[:, None] + np.arange(7)], now[start[:, None] + np.arange(7)]
    distance = np.linalg.norm(then[:, :3] - here[:, :3], axis=1).max(initial=0.0)
    # A rotation has two quaternions; the chord to the nearer one is twice the sine of a quarter of the angle.
    a, b = then[:, 3:], here[:, 3:]
    chord = np.minimum(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))
    return float(distance), float(4 * np.arcsin(np.clip(chord / 2, 0.0, 1.0)).max(initial=0.0))
