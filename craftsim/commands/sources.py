"""Where trajectories come from: files, folders of runs and of bundles, and runs that are made now."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from craftsim.commands.text import say
from craftsim.errors import InputError, suggestion

if TYPE_CHECKING:
    from craftsim.commands.options import PhysicsOptions
    from craftsim.rendering.trajectory import Trajectory

_NAMED = 12
"""Trajectories of a folder that an error names."""


def find_trajectory(
    what: str,
    out: Path,
    run: str | None,
    physics: PhysicsOptions,
    plan: Path | None,
    policy: str | None,
    order: Literal["sequential", "ticks", "concurrent"],
) -> Trajectory:
    """Return the trajectory that a word on the command line stands for.

    What is not recorded yet is run now, and written beside ``out``, under its name with the ending ``.npz``.

    Raises InputError for a word that stands for none.
    """
    from craftsim.rendering.trajectory import SUFFIX, Trajectory
    from craftsim.validation.runs.once import record_once

    path = Path(what)
    recorded = path.suffix == SUFFIX or path.is_dir()
    if recorded and (plan or policy):
        raise InputError(f"{what} is recorded already; leave --plan and --policy out")
    if path.suffix == SUFFIX:
        return Trajectory.read(path)
    if path.is_dir():
        return _in_folder(path, run)
    if run is not None:
        raise InputError(f"--run chooses from a folder of a run, and {what} is none")
    trajectory = record_once(what, physics.setup(), physics.seed, plan=plan, policy=policy, order=order)
    say(f"Recorded: {trajectory.write(out.with_suffix(SUFFIX))}")
    return trajectory


def _in_folder(folder: Path, run: str | None) -> Trajectory:
    from craftsim.rendering.trajectory import Trajectory
    from craftsim.validation.replays.bundle import TEXT, read_bundle
    from craftsim.validation.replays.recording import record_bundle

    if (folder / TEXT).is_file():
        return record_bundle(read_bundle(folder))[1]
    paths = trajectories_in(folder)
    if run is None and len(paths) == 1:
        return Trajectory.read(next(iter(paths.values())))
    if run is None or run not in paths:
        names = [*list(paths)[:_NAMED], *(["..."] if len(paths) > _NAMED else [])]
        wrong = "choose one with --run" if run is None else f"no run '{run}'{suggestion(run, list(paths))}"
        raise InputError(f"{folder}: {wrong}; there are {', '.join(names)}")
    return Trajectory.read(paths[run])


def trajectories_in(folder: Path) -> dict[str, Path]:
    """Return the trajectory files of a run's folder by name; raise InputError where there is none."""
    from craftsim.rendering.trajectory import SUFFIX, TRAJECTORIES

    place = folder / TRAJECTORIES
    paths = sorted((place if place.is_dir() else folder).glob(f"*{SUFFIX}"))
    if not paths:
        raise InputError(f"{folder}: holds no trajectory; run the command again with --record")
    return {path.stem: path for path in paths}
