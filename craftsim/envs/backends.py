"""The backends of environments, and the one that options ask for."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from craftsim.discrete.rules import Rules
from craftsim.envs.grid_backend import GridBackend
from craftsim.envs.options import Options
from craftsim.tasks import Task

if TYPE_CHECKING:
    from craftsim.envs.physics_backend import PhysicsBackend

Backend: TypeAlias = "GridBackend | PhysicsBackend"
"""One world in which ticks happen, or actions begin one by one.

The world as it is seen is kept in a batch of one of :class:`Episodes`, with the queue of the action helper.
"""


def make_backend(task: Task, options: Options) -> Backend:
    """Return the backend that the options of an environment ask for."""
    if options.backend == "grid":
        return GridBackend(Rules(options.rule_set), options.timing)
    if options.images is not None or options.render_mode in ("rgb_array", "rgb_array_list"):
        from craftsim.rendering.offscreen import choose_backend

        choose_backend()
    from craftsim.envs.physics_backend import PhysicsBackend, setup_from

    return PhysicsBackend(setup_from(options, task.layout.n_cars), options, task)
