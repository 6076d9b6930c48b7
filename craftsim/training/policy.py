"""A trained policy, as anything that plays a task calls it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.errors import InputError
from craftsim.training.extra import need_torch

if TYPE_CHECKING:
    from craftsim.training.config import TrainConfig
    from craftsim.training.features import Shape
    from craftsim.training.networks import CarNet

Observations = dict[str, dict[str, NDArray[Any]]]
"""By agent, ``car_0`` and so on: ``observation`` (vector_length,) and ``action_mask`` (15,)."""


class TrainedPolicy:
    """Chooses for every car the offered action that training rates highest; nothing is drawn."""

    def __init__(self, config: TrainConfig, shape: Shape, net: CarNet) -> None:
        self.config = config
        self.shape = shape
        self.net = net

    def __call__(self, observations: Observations) -> dict[str, int]:
        """Return one action for each agent; raises InputError if the observations are those of another task."""
        from craftsim.training.evaluation import best_actions

        names = [f"car_{i}" for i in range(self.shape.n_cars)]
        if set(observations) != set(names):
            raise InputError(
                f"this policy was trained on {self.config.task} with the agents {', '.join(names)}; "
                f"asked for {', '.join(sorted(observations)) or 'none'}"
            )
        seen, mask = (
            np.stack([observations[name][key] for name in names]) for key in ("observation", "action_mask")
        )
        if seen.shape[-1] != self.shape.vector_length:
            raise InputError(
                f"this policy was trained on {self.config.task}, whose observations have "
                f"{self.shape.vector_length} numbers, not {seen.shape[-1]}"
            )
        return dict(zip(names, best_actions(self.net, seen, mask).tolist(), strict=True))


def load_policy(path: str | Path) -> TrainedPolicy:
    """Return the policy of a file that ``craftsim train`` wrote: its ``policy.pt``, or the folder that holds it.

    Raises:
        InputError: the extra ``train`` is not installed, or the file is not a policy.
    """
    need_torch()
    from craftsim.training.checkpoint import POLICY_FILE, read_policy

    path = Path(path)
    return TrainedPolicy(*read_policy(path / POLICY_FILE if path.is_dir() else path))
