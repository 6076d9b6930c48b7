"""Where the trajectories of a run are."""

from __future__ import annotations

from pathlib import Path

from craftsim.errors import InputError, suggestion
from craftsim.rendering.trajectory import SUFFIX, TRAJECTORIES


def trajectory_files(run: Path, name: str | None = None) -> list[Path]:
    """Return the trajectory files that a path stands for, by name.

    Args:
        run: a run's folder, or a trajectory file.
        name: of the one file of the folder that is wanted, with or without its ending.

    Raises InputError where there is nothing of the kind.
    """
    if not run.is_dir():
        if name is not None:
            raise InputError(f"{run} is no folder; a trajectory's name goes with a run's folder")
        if not run.is_file():
            raise InputError(f"{run}: no such file or folder; allowed: a run's folder or a trajectory file")
        return [run]
    found = sorted((run / TRAJECTORIES).glob(f"*{SUFFIX}")) or sorted(run.glob(f"*{SUFFIX}"))
    if not found:
        raise InputError(f"{run}: no trajectories in it; run it again with --record")
    if name is None:
        return found
    names = {path.stem: path for path in found}
    if (stem := name.removesuffix(SUFFIX)) not in names:
        listed = ", ".join(list(names)[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
        raise InputError(f"{run}: no trajectory '{name}'{suggestion(name, names)}; there are {listed}")
    return [names[stem]]
