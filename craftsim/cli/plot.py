"""Figures of what a run has recorded."""

from __future__ import annotations

from pathlib import Path

from craftsim.cli.text import say


def draw_figures(recorded: Path, run: str | None, out: Path) -> int:
    """Draw paths, tracking errors, wheel torques, boards, hinges and contact forces of recorded runs.

    Args:
        recorded: folder of a run that was recorded, or a trajectory file.
        run: the one trajectory of the folder to draw; all of them if None.
        out: folder for the figures; each trajectory gets a folder of its own in it.
    """
    from craftsim.cli.progress import counting
    from craftsim.rendering.plots.figures import write_figures
    from craftsim.rendering.plots.signals import Signals
    from craftsim.rendering.trajectory import Trajectory, trajectory_files
    from craftsim.reports.terminal import Terminal
    from craftsim.storage.folders import directory_within, output_directory

    files = trajectory_files(recorded, run)
    output_directory(out)
    with counting(Terminal(), "trajectories", len(files), bool) as on_trajectory:
        for file in files:
            written = list(write_figures(directory_within(out, file.stem), Signals.of(Trajectory.read(file))))
            on_trajectory(written)
            say(f"{file.stem}: {len(written)} files in {out / file.stem}")
    return 0
