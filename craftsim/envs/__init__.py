"""Environments for training, on the grid or in contact physics: PettingZoo, Gymnasium, and batches.

Importing this package registers ``craftsim/SimpleTwoStory-v0`` and its like with Gymnasium and PettingZoo, and
registered tasks, too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import gymnasium
import pettingzoo

from craftsim.errors import InputError
from craftsim.tasks import TASK_NAMES, VARIED_NAMES, Task, as_task
from craftsim.tasks.registry import on_registration, task_id

if TYPE_CHECKING:
    from gymnasium.vector import VectorEnv
    from pettingzoo import AECEnv

    from craftsim.envs.options import BackendName
    from craftsim.envs.parallel import ParallelConstruction
    from craftsim.workers.pool import Engine

__all__ = ["TASK_IDS", "env", "parallel_env", "vector_env"]


def parallel_env(
    task: Task | str,
    backend: BackendName = "physics",
    n_cars: int | None = None,
    n_blocks: int | None = None,
    **options: Any,
) -> ParallelConstruction:
    """Return a task as a PettingZoo environment whose agents act at the same time.

    Args:
        task: a Task, or what :func:`craftsim.tasks.as_task` makes one of, a registered name for instance.
        backend: contact physics, or the grid and its rules.
        n_cars: other than the task's number of cars; those that its start does not list are drawn at random.
        n_blocks: the same for blocks.
        options: the other fields of :class:`craftsim.envs.options.Options`.

    Raises:
        InputError: there is no such task, backend, option or option value.

    Example:
        >>> import craftsim
        >>> env = craftsim.parallel_env("strip", "grid")
        >>> observations, infos = env.reset(seed=0)
        >>> observations["car_0"]["action_mask"].shape
        (15,)
    """
    from craftsim.envs.asynchronous import AsynchronousParallel
    from craftsim.envs.options import Options
    from craftsim.envs.parallel import ParallelConstruction

    chosen = Options(backend=backend, **options)
    if chosen.execution == "synchronous":
        form = ParallelConstruction
    else:
        form = AsynchronousParallel
    return form(as_task(task, n_cars, n_blocks), chosen)


def env(
    task: Task | str, backend: BackendName = "physics", **options: Any
) -> AECEnv[str, Any, Any]:
    """Return the same as a PettingZoo environment whose agents take turns; a tick happens after the last one's.

    With ``execution="asynchronous"`` it is the turn of the car that decides next, whose own action has ended.

    Example:
        >>> import craftsim
        >>> env = craftsim.env("strip", "grid")
        >>> env.reset(seed=0)
        >>> env.agent_selection
        'car_0'
    """
    if options.get("execution") == "asynchronous":
        from craftsim.envs.asynchronous import AsynchronousConstruction
        from craftsim.envs.options import Options

        counts = [options.pop(name, None) for name in ("n_cars", "n_blocks")]
        return AsynchronousConstruction(as_task(task, *counts), Options(backend=backend, **options))
    from craftsim.envs.turns import TurnConstruction

    return TurnConstruction(parallel_env(task, backend, **options))


def vector_env(
    task: Task | str,
    num_envs: int,
    backend: BackendName = "grid",
    n_cars: int | None = None,
    n_blocks: int | None = None,
    workers: int | None = None,
    engine: Engine = "local",
    **options: Any,
) -> VectorEnv[Any, Any, Any]:
    """Return many worlds of a task as a Gymnasium environment, one agent for all cars of each world.

    An episode that ends is reset in the same step, and its last observation is in ``infos["final_obs"]``. Grid worlds
    advance in one array call; worlds in physics are spread over processes, so close it.

    Args:
        task: as in :func:`parallel_env`.
        num_envs: how many worlds, 1 or more.
        backend: the grid and its rules, or contact physics.
        n_cars: as in :func:`parallel_env`.
        n_blocks: as in :func:`parallel_env`.
        workers: physics only: how many processes share the worlds, one for each processor unless given; no number
            depends on it.
        engine: physics only: processes of this machine, or actors of an existing Ray cluster.
        options: the other fields of :class:`craftsim.envs.options.Options`: in physics all but ``observe``, on the grid
            those that its ``BATCH_OPTIONS`` name.

    Raises:
        InputError: there is no such task, backend, option or option value.

    Example:
        >>> import craftsim
        >>> envs = craftsim.vector_env("strip", 8)
        >>> observations, infos = envs.reset(seed=0)
        >>> observations["action_mask"].shape
        (8, 2, 15)
    """
    task = as_task(task, n_cars, n_blocks)
    if backend == "physics":
        from craftsim.envs.physics_vector import PhysicsVectorEnv

        return PhysicsVectorEnv(task, num_envs, workers=workers, engine=engine, **options)
    for name, is_given in (("workers", workers is not None), ("engine", engine != "local")):
        if is_given:
            raise InputError(f"a batch of grid worlds knows no '{name}'; leave it out")
    from craftsim.envs.vector import GridVectorEnv

    return GridVectorEnv(task, num_envs, backend=backend, **options)


TASK_IDS: Final[dict[str, str]] = {}
"""The ids of tasks in ``gymnasium.make``, ``gymnasium.make_vec`` and ``pettingzoo.make``, by the tasks' names."""
_PETTINGZOO: Final = {
    "parallel": (pettingzoo.parallel_registry, "craftsim.envs:parallel_env"),
    "aec": (pettingzoo.aec_registry, "craftsim.envs:env"),
}
"""The registries of PettingZoo's two forms, and what makes an environment of each form."""


def _add_id(task: Task | str) -> None:
    if isinstance(task, str):
        name = task
    else:
        name = task.name
    TASK_IDS[name] = task_id(name)
    # A task that is registered again replaces the first one.
    gymnasium.registry.pop(TASK_IDS[name], None)
    gymnasium.register(
        TASK_IDS[name],
        entry_point="craftsim.envs.central:CentralConstruction",
        vector_entry_point="craftsim.envs:vector_env",
        kwargs={"task": task},
    )
    for form, (registry, entry_point) in _PETTINGZOO.items():
        registry.pop(TASK_IDS[name], None)
        pettingzoo.register(form, TASK_IDS[name], entry_point, kwargs={"task": task})


for _name in (*TASK_NAMES, *VARIED_NAMES):
    _add_id(_name)
on_registration(_add_id)
