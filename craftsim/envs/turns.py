"""The PettingZoo form in which agents take turns: a tick happens after the last one's."""

from __future__ import annotations

from typing import Any

from pettingzoo.utils.conversions import parallel_to_aec_wrapper
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from craftsim.envs.parallel import ParallelConstruction
from craftsim.workers.copying import Copyable


class TurnConstruction(Copyable, OrderEnforcingWrapper[str, Any, Any]):
    """PettingZoo's conversion of a parallel environment. A shallow copy of it is a whole one, too."""

    def __init__(self, env: ParallelConstruction) -> None:
        """Convert an environment."""
        super().__init__(parallel_to_aec_wrapper(env))

    def __str__(self) -> str:
        return str(self.env)
