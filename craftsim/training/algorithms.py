"""The algorithms by name."""

from __future__ import annotations

from craftsim.training.coma import COMALearner
from craftsim.training.config import TrainConfig
from craftsim.training.learner import Learner
from craftsim.training.off_policy import QLearner
from craftsim.training.on_policy import PPOLearner
from craftsim.training.shape import Shape


def make_learner(config: TrainConfig, shape: Shape, ticks: int) -> Learner:
    """Return the algorithm that a configuration names, for episodes of at most ``ticks`` ticks."""
    if config.algo in ("ippo", "mappo"):
        return PPOLearner(shape, ticks, sees_team=config.algo == "mappo")
    if config.algo == "coma":
        return COMALearner(shape, ticks)
    return QLearner(shape, ticks, config.algo)
