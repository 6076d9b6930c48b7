"""Trajectories of an environment's episodes."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from craftsim.checking.attempt import Attempt
from craftsim.checking.episode import Recipe
from craftsim.checking.judge import Judge
from craftsim.discrete.files.design import Design
from craftsim.rendering.recorder import Recorder
from craftsim.rendering.trajectory import SUFFIX
from craftsim.storage.folders import output_directory

_DIGITS: Final = 8


class EpisodeRecords:
    """Writes a trajectory of each episode into a folder."""

    def __init__(self, folder: Path, task: str, design: Design | None) -> None:
        """Prepare for a task; raises InputError for a folder that cannot be written to."""
        self._folder, self._task, self._design = output_directory(folder), task, design
        self._recorder = Recorder()
        self._number, self._running = 0, False

    def begin(self, judge: Judge, design: Design | None = None) -> None:
        """Begin an episode, which may have a design of its own."""
        self._design = design or self._design
        self._recorder.begin(judge)
        self._running = True

    def end(self, recipe: Recipe, attempts: Sequence[Attempt]) -> None:
        """Write what was recorded of an episode, unless nothing was done in it or it is written.

        Its name tells it from others in the folder: by what was drawn for it and what was done in it.
        """
        if not self._running or not attempts:
            return
        self._running = False
        drawn = hashlib.sha256(repr(recipe).encode()).hexdigest()
        name = f"episode-{self._number:04d}-{drawn[:_DIGITS]}"
        self._recorder.trajectory(f"{self._task}, {name}", recipe, attempts, self._design).write(
            self._folder / f"{name}{SUFFIX}"
        )
        self._number += 1
