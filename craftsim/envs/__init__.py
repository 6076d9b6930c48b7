"""Environments for training, on the grid or in contact physics: PettingZoo, Gymnasium, and batches.

Importing this package registers ``craftsim/SimpleTwoStory-v0`` and its like with Gymnasium.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import gymnasium

from craftsim.discrete.tasks import TASK_NAMES, Task

if TYPE_CHECKING:
    from pettingzoo import AECEnv

    from craftsim.envs.core import BackendName
    from craftsim.envs.parallel import ParallelConstruction

__all__ = ["GYMNASIUM_IDS", "env", "parallel_env"]


def parallel_env(task: Task | str, backend: BackendName = "physics", **options: Any) -> ParallelConstruction:
    """Return a task as a PettingZoo environment whose agents act at the same time.

    Args:
        task: name of one of the six, or a task of one's own.
        backend: contact physics, or the grid and its rules.
        options: the other fields of :class:`craftsim.envs.core.Options`.

    Raises:
        InputError: there is no such task, backend, option or option value.
    """
    from craftsim.envs.core import Options
    from craftsim.envs.parallel import ParallelConstruction

    return ParallelConstruction(task, Options.named(backend=backend, **options))


def env(task: Task | str, backend: BackendName = "physics", **options: Any) -> AECEnv[str, Any, Any]:
    """Return the same as a PettingZoo environment whose agents take turns; a tick happens after the last one's."""
    from pettingzoo.utils.conversions import parallel_to_aec

    return parallel_to_aec(parallel_env(task, backend, **options))


GYMNASIUM_IDS: Final = {
    name: f"craftsim/{''.join(word.capitalize() for word in name.split('_'))}-v0" for name in TASK_NAMES
}
"""What each of the six tasks is called in ``gymnasium.make`` and ``gymnasium.make_vec``."""

for _name, _id in GYMNASIUM_IDS.items():
    gymnasium.register(
        _id,
        entry_point="craftsim.envs.central:CentralConstruction",
        vector_entry_point="craftsim.envs.vector:GridVectorEnv",
        kwargs={"task": _name},
    )
