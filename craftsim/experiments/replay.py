"""Re-running what a replay bundle shows, and comparing the two."""

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
from craftsim.experiments.bundle import TEXT, Recorded, physics_of, state_of
from craftsim.reports.json_file import versions
from craftsim.skills.executor import Observer
from craftsim.storage.reading import Arrays

DECISIVE: Final = ("craftsim", "mujoco", "numpy")
"""Packages whose version decides every bit; with other versions poses are compared with a tolerance."""
POSITION_M: Final = 0.002
"""How far poses may be apart with other versions: what a finer time step changes at most."""
ANGLE_RAD: Final = 0.01

Watch = Callable[[Judge], AbstractContextManager[Observer | None]]
"""Opens what watches the last step, on the world that stands before it."""


@dataclass(frozen=True)
class Replay:
    """A bundle's last step, re-run."""

    changed: dict[str, tuple[str, str]]
    """Versions that decide and differ: (the bundle's, this one)."""
    differing: tuple[str, ...]
    """What is not the same bit for bit, by file and name."""
    position_m: float
    """The furthest that anything ends from where it ended."""
    angle_rad: float
    """The largest angle between where anything points and where it pointed."""
    attempts: tuple[Attempt, ...]
    same_results: bool
    """Whether every action came out as it did: its result and its finding."""

    @property
    def reproduced(self) -> bool:
        """Whether all is the same bit for bit; with other versions, whether it is within the tolerance."""
        if not self.changed:
            return not self.differing and self.same_results
        return self.same_results and self.position_m <= POSITION_M and self.angle_rad <= ANGLE_RAD


def unwatched(judge: Judge) -> AbstractContextManager[None]:
    """Watch nothing."""
    return nullcontext()


def replay(recorded: Recorded, watch: Watch = unwatched) -> Replay:
    """Re-run what a bundle shows, and compare.

    Raises InputError for a bundle whose recipe makes no world or takes longer than it says, or whose arrays are of
    another one.
    """
    bundle = recorded.bundle
    try:
        judge = start(bundle.recipe)
    except InputError as error:
        raise InputError(f"{recorded.folder / TEXT}: {error}") from error
    physics = judge.physics
    drawn = physics_of(physics)
    begun = state_of(physics)
    for file, arrays in Recorded(recorded.folder, bundle, drawn, begun, begun).arrays.items():
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
        for file, arrays in Recorded(recorded.folder, bundle, drawn, before, after).arrays.items()
        for name, array in arrays.items()
        if recorded.arrays[file][name].tobytes() != array.tobytes()
    ]
    if (bundle.start_s, bundle.end_s) != (before["time"], after["time"]):
        differing.append("start_s and end_s")
    if bundle.attempts != attempts:
        differing.append("the attempts")
    position_m, angle_rad = _apart(physics.model, recorded.after["qpos"], after["qpos"])
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
