"""Where the trajectories of a run are."""

from __future__ import annotations

from pathlib import Path

from craftsim.errors import InputError, suggestion
from craftsim.rendering.trajectory import SUFFIX, TRAJECTORIES
from craftsim.storage.paths import is_file, is_folder

BUNDLE = "bundle.json"
"""What tells the folder of a replay bundle; other archives lie in it, too."""


def name_of(path: Path) -> str:
    """Return the name of a trajectory within its run: of its file, or of the bundle that it lies in."""
    return path.parent.name if is_file(path.parent / BUNDLE) else path.stem


def trajectory_files(run: Path, name: str | None = None) -> list[Path]:
    """Return the trajectory files that a path stands for, by name.

    Args:
        run: a run's folder, or a trajectory file.
        name: of the one file of the folder that is wanted, with or without its ending.

    Raises InputError where there is nothing of the kind.
    """
    if not is_folder(run):
        if name is not None:
            raise InputError(f"{run} is no folder; a trajectory's name goes with a run's folder")
        if not is_file(run):
            raise InputError(f"{run}: no such file or folder; allowed: a run's folder or a trajectory file")
        return [run]
    if is_file(run / BUNDLE):
        found = sorted(run.glob(f"trajectory{SUFFIX}"))
    else:
        # What begins with a dot is what a kill left of one.
        found = sorted((run / TRAJECTORIES).glob(f"[!.]*{SUFFIX}")) or sorted(run.glob(f"[!.]*{SUFFIX}"))
        # An audit records in the bundles of its disagreements.
        found = found or sorted(run.glob(f"bundles/*/trajectory{SUFFIX}"))
    if not found:
        raise InputError(f"{run}: no trajectories in it; run it again with --record")
    if name is None:
        return found
    names = {name_of(path): path for path in found}
    if (stem := name.removesuffix(SUFFIX)) not in names:
        listed = ", ".join(list(names)[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
        raise InputError(f"{run}: no trajectory '{name}'{suggestion(name, names)}; there are {listed}")
    return [names[stem]]
