"""A trained policy, as anything that plays a task calls it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.errors import InputError
from craftsim.training.extra import need_torch

if TYPE_CHECKING:
    import torch

    from craftsim.training.config import TrainConfig
    from craftsim.training.features import Shape
    from craftsim.training.networks import CarNet

Observations = dict[str, dict[str, NDArray[Any]]]
"""By agent, ``car_0`` and so on: ``observation`` (vector_length,) and ``action_mask`` (15,)."""


class TrainedPolicy:
    """Chooses an offered action for every car that it is shown; the same seed chooses the same."""

    def __init__(self, config: TrainConfig, shape: Shape, net: CarNet, samples: bool, seed: int) -> None:
        self.config = config
        self.shape = shape
        self.net = net
        self.samples = samples
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Begin to draw anew."""
        import torch

        self._draws = torch.Generator().manual_seed(seed)

    def __call__(self, observations: Observations) -> dict[str, int]:
        """Return one action for each agent; raises InputError if the observations are those of another task."""
        import torch

        from craftsim.training.evaluation import choose

        names = [f"car_{i}" for i in range(self.shape.n_cars)]
        if set(observations) != set(names):
            raise InputError(
                f"this policy was trained on {self.config.task} with the agents {', '.join(names)}; "
                f"asked for {', '.join(sorted(observations)) or 'none'}"
            )
        seen, mask = (self._stack(observations, names, key) for key in ("observation", "action_mask"))
        if seen.shape[-1] != self.shape.vector_length:
            raise InputError(
                f"this policy was trained on {self.config.task}, whose observations have "
                f"{self.shape.vector_length} numbers, not {seen.shape[-1]}"
            )
        with torch.no_grad():
            actions = choose(self.net(seen, mask), mask, self._draws if self.samples else None)
        return dict(zip(names, actions.tolist(), strict=True))

    @staticmethod
    def _stack(observations: Observations, names: list[str], key: str) -> torch.Tensor:
        import torch

        return torch.from_numpy(np.stack([observations[name][key] for name in names]).astype(np.int64))


def load_policy(path: str | Path, seed: int = 0, samples: bool | None = None) -> TrainedPolicy:
    """Return the policy of a file that ``craftsim train`` wrote.

    Args:
        path: ``policy.pt``, or the folder of the run.
        seed: of the actions that are drawn.
        samples: draw actions instead of taking the best; None does as the algorithm is meant to: draw after PPO.

    Raises:
        InputError: the extra ``train`` is not installed, or the file is not a policy.
    """
    need_torch()
    from craftsim.training.checkpoint import POLICY_FILE, read_policy

    path = Path(path)
    config, shape, net = read_policy(path / POLICY_FILE if path.is_dir() else path)
    return TrainedPolicy(config, shape, net, config.samples if samples is None else samples, seed)
