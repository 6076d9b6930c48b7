"""What people see of a world in physics and what is kept of it: pictures, MuJoCo's viewer, and trajectories."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import Attempt
from craftsim.checking.episode import Recipe, in_order
from craftsim.checking.judge import Judge
from craftsim.discrete.files.design import Design
from craftsim.envs.options import MOTION_FPS
from craftsim.errors import InputError
from craftsim.extras import install
from craftsim.rendering.images import camera_number
from craftsim.rendering.offscreen import make_renderer
from craftsim.rendering.trajectory import SUFFIX, Recorder, SeenWorld
from craftsim.storage.folders import output_directory

if TYPE_CHECKING:
    import mujoco
    from mujoco.viewer import Handle

    from craftsim.models.world import PhysicsWorld

Picture = NDArray[np.uint8]
"""Shape (height, width, 3), red green blue."""
_DIGITS: Final = 8
"""Of the digest that tells a recorded episode from others."""


def has_display() -> bool:
    """Return whether windows can be opened here."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


class Pictures:
    """Looks at one PhysicsWorld after the other; call :meth:`watch` after every control period."""

    def __init__(
        self, camera: str | None = None, size: tuple[int, int] | None = None, motion: bool = False
    ) -> None:
        """Prepare for a camera and a size (width, height); ``motion`` keeps the pictures between ticks."""
        self.camera, self.size, self.motion = camera or "overview", size or (640, 480), motion
        self._physics: PhysicsWorld | None = None
        self._kept: list[Picture] = []
        self._due_s = 0.0
        self._renderer: mujoco.Renderer | None = None
        self._viewer: Handle | None = None

    def begin(self, physics: PhysicsWorld) -> None:
        """Look at a world from now on, at the start of an episode; raises InputError for a camera that it lacks."""
        if physics is not self._physics:
            self.close()
            seen = SeenWorld(physics)
            self._number = camera_number(seen.model, self.camera)
            self._physics, self._seen = physics, seen
        self._kept.clear()
        self._due_s = physics.time_s

    def watch(self, physics: PhysicsWorld) -> None:
        """Keep the viewer up to date, and a picture where its moment has come."""
        if self._viewer is not None:
            self._seen.now()
            self._viewer.sync()
        # The allowance is for sums of time steps that end a rounding error before a picture's moment.
        if self.motion and physics.time_s >= self._due_s - 1e-6:
            self._kept.append(self.picture())
            self._due_s += 1 / MOTION_FPS

    def picture(self) -> Picture:
        """Return what the camera sees now."""
        assert self._physics is not None, "begin() comes first"
        if self._renderer is None:
            self._renderer = make_renderer(self._seen.model, self.size)
        self._renderer.update_scene(self._seen.now(), self._number)
        taken: Picture = self._renderer.render()
        return taken

    def taken(self) -> list[Picture]:
        """Return the pictures of the motion since the last call, or one of now where nothing has moved since."""
        kept, self._kept = self._kept or [self.picture()], []
        return kept

    def show(self) -> None:
        """Open MuJoCo's viewer; it follows the simulation from now on. Raises InputError without a display."""
        assert self._physics is not None, "begin() comes first"
        if self._viewer is None:
            if not has_display():
                raise InputError(
                    "render_mode 'human' needs a display, or the viewer in the browser, and there is neither here; try "
                    f"'rgb_array' or 'ansi', or {install('view')}"
                )
            import mujoco.viewer

            self._viewer = mujoco.viewer.launch_passive(self._seen.model, self._seen.now())
        self._viewer.sync()

    def close(self) -> None:
        """Close the viewer and the renderer."""
        if self._viewer is not None:
            self._viewer.close()
        if self._renderer is not None:
            self._renderer.close()
        self._viewer = self._renderer = None


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
        ordered = in_order(recipe.steps, attempts)
        self._recorder.trajectory(f"{self._task}, {name}", recipe, ordered, self._design).write(
            self._folder / f"{name}{SUFFIX}"
        )
        self._number += 1
