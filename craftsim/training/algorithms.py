"""The algorithms by name."""

from __future__ import annotations

from craftsim.training.coma import COMALearner
from craftsim.training.config import TrainConfig
from craftsim.training.learner import Learner
from craftsim.training.off_policy import QLearner
from craftsim.training.on_policy import PPOLearner
from craftsim.training.settings import COMASettings, PPOSettings, QSettings, settings_of
from craftsim.training.shape import Shape


def make_learner(config: TrainConfig, shape: Shape, ticks: int) -> Learner:
    """Return the algorithm that a configuration names, for episodes of at most ``ticks`` ticks."""
    match settings_of(config.algo, config.hyperparameters):
        case PPOSettings() as settings:
            return PPOLearner(shape, ticks, config.algo == "mappo", settings)
        case COMASettings() as settings:
            return COMALearner(shape, ticks, settings)
        case QSettings() as settings:
            return QLearner(shape, ticks, config.algo, settings)
    raise AssertionError(config.algo)
