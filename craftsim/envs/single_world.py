"""What the forms of one world share, whatever their interface."""

from __future__ import annotations

from io import StringIO
from typing import Any

from craftsim.discrete.grid import Grid
from craftsim.envs.asynchronous_core import AsynchronousCore
from craftsim.envs.backends import Backend
from craftsim.envs.core import Core
from craftsim.envs.options import RENDER_FPS, RENDER_MODES, Options
from craftsim.tasks import Task
from craftsim.workers.copying import Copyable


class SingleWorld(Copyable):
    """What the forms of one world share, whatever their interface.

    A copy (``copy.deepcopy``, or a pickle in any process) is an environment of its own in the same state, random
    generators included; it renders with a renderer of its own.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (as Gymnasium declares it)
        "render_modes": list(RENDER_MODES),
        "render_fps": RENDER_FPS,
    }

    def __init__(self, task: Task | str, options: Options, backend: Backend | None = None) -> None:
        """Prepare a task; the first episode begins with ``reset()``. ``backend`` replaces the one of the options."""
        kind = Core
        if options.execution == "asynchronous":
            kind = AsynchronousCore
        self.core = kind(task, options, backend)
        self.metadata = type(self).metadata | {"render_fps": options.render_fps}
        self.render_mode: str | None = options.render_mode

    @property
    def grid(self) -> Grid:
        """A copy of the world as it is seen."""
        return self.core.grid

    def render(self) -> Any:
        """Return a picture (height, width, 3) (``rgb_array``), several (``rgb_array_list``) or text (``ansi``).

        ``rgb_array_list`` returns the pictures since the last call, or since the reset if that was later; ``human``
        shows every tick by itself.
        """
        core = self.core
        goal = self.core.task.layout.goal
        if self.render_mode == "rgb_array":
            return core.backend.picture(core.grid, goal)
        if self.render_mode == "rgb_array_list":
            pictures = core.pictures
            core.pictures = []
            return pictures
        if self.render_mode != "ansi":
            return None
        from rich.console import Console

        from craftsim.discrete.drawing import world_text

        text = StringIO()
        console = Console(
            file=text, force_terminal=True, color_system="standard", highlight=False, width=200
        )
        console.print(world_text(core.grid, goal), end="")
        return text.getvalue()

    def close(self) -> None:
        """Release what rendering holds, and write what is recorded."""
        self.core.backend.close()
