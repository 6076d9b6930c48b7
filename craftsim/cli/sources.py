"""Where trajectories come from: files, folders of runs and of bundles, and runs that are made now."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from craftsim.cli.text import say
from craftsim.errors import InputError
from craftsim.storage.paths import is_file, is_folder

if TYPE_CHECKING:
    from craftsim.choices import PlanOrder
    from craftsim.options import Physics
    from craftsim.rendering.trajectory import Trajectory

_NAMED: Final = 12
"""Trajectories of a folder that an error names."""


def find_trajectory(
    what: str,
    out: Path,
    run: str | None,
    physics: Physics,
    plan: Path | None,
    policy: str | None,
    order: PlanOrder,
) -> Trajectory:
    """Return the trajectory that a word on the command line stands for.

    What is not recorded yet is run now, and written beside ``out``, under its name with the ending ``.npz``.

    Raises InputError for a word that stands for none.
    """
    from craftsim.discrete.tasks import TASK_NAMES
    from craftsim.rendering.trajectory import SUFFIX, Trajectory
    from craftsim.validation.validation import record_once

    path = Path(what)
    recorded = what not in TASK_NAMES and (path.suffix == SUFFIX or is_folder(path))
    if recorded and (plan or policy):
        raise InputError(f"{what} is recorded already; leave --plan and --policy out")
    if recorded and is_folder(path):
        return _in_folder(path, run)
    if run is not None:
        raise InputError(f"--run chooses from a folder of a run, and {what} is none")
    if recorded:
        return Trajectory.read(path)
    trajectory = record_once(what, physics.setup(), physics.seed, plan=plan, policy=policy, order=order)
    say(f"Recorded: {trajectory.write(out.with_suffix(SUFFIX))}")
    return trajectory


def _in_folder(folder: Path, run: str | None) -> Trajectory:
    from craftsim.experiments.bundle import TEXT, read_bundle
    from craftsim.rendering.trajectory import Trajectory, name_of, trajectory_files
    from craftsim.validation.recording import record_bundle

    if is_file(folder / TEXT) and run is None:
        return record_bundle(read_bundle(folder))[1]
    first, *others = trajectory_files(folder, run)
    if others:
        names = [name_of(path) for path in (first, *others[: _NAMED - 1])]
        more = f" and {len(others) + 1 - _NAMED} more" if len(others) >= _NAMED else ""
        raise InputError(f"{folder}: choose one with --run; there are {', '.join(names)}{more}")
    return Trajectory.read(first)
