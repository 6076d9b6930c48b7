"""Hyperparameters of the algorithms, with ranges and defaults.

The command line, a file and Python take them from here; importing this is cheap, which help and tab completion need.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from craftsim.storage.limits import Range

BackendChoice = Literal["grid", "physics"]
"""Where cars are trained and evaluated."""
Device = Literal["cpu", "cuda"]
"""Where networks learn."""
PresetName = Literal["paper", "paper_plus", "fork"]
"""The training protocol of CraftEnv's paper, without and with our own exploration before; and the learner that was
released with it."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Common hyperparameters."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per tick."""
    learning_rate: Annotated[float, Range(1e-6, 1)] = 1e-3
    """Learning rate of Adam; of RAdam for PQN, of RMSProp where a setting says so."""
    max_gradient: Annotated[float, Range(1e-3, 1_000_000)] = 1.0
    """Clipping norm of gradients."""
    decay_ticks: Annotated[int, Range(0, 1_000_000_000)] = 0
    """Ticks of linear decay of the learning rate to 0; 0: constant rate."""

    def rate(self, learnt: int) -> float:
        """Return the learning rate after ``learnt`` ticks."""
        remaining = 1.0
        if self.decay_ticks:
            remaining = max(0.0, 1 - learnt / self.decay_ticks)
        return self.learning_rate * remaining


@dataclass(frozen=True, kw_only=True)
class PPOSettings(Settings):
    """Hyperparameters of IPPO and MAPPO."""

    gae_lambda: Annotated[float, Range(0, 1)] = 0.95
    """Lambda of generalised advantage estimation."""
    clip: Annotated[float, Range(0.001, 10)] = 0.2
    """Clipping range of the probability ratio."""
    entropy: Annotated[float, Range(0, 10)] = 0.01
    """Entropy coefficient."""
    critic: Annotated[float, Range(0, 100)] = 0.5
    """Weight of the critic's loss."""
    epochs: Annotated[int, Range(1, 100)] = 4
    """Epochs over each rollout."""
    minibatches: Annotated[int, Range(1, 1024)] = 4
    """Minibatches per epoch."""


@dataclass(frozen=True, kw_only=True)
class COMASettings(Settings):
    """Hyperparameters of COMA."""

    td_lambda: Annotated[float, Range(0, 1)] = 0.8
    """Lambda of the critic's returns."""
    entropy: Annotated[float, Range(0, 10)] = 0.01
    """Entropy coefficient."""
    minibatches: Annotated[int, Range(1, 1024)] = 2
    """Minibatches per epoch."""
    target_rate: Annotated[float, Range(1e-4, 0.999)] = 0.05
    """Soft update rate of the target critic."""


@dataclass(frozen=True, kw_only=True)
class ValueSettings(Settings):
    """Hyperparameters of value-based algorithms with epsilon-greedy exploration."""

    learning_rate: Annotated[float, Range(1e-6, 1)] = 5e-4
    max_gradient: Annotated[float, Range(1e-3, 1_000_000)] = 10.0
    epsilon_start: Annotated[float, Range(0, 1)] = 0.5
    """Initial probability of a random action."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.2
    """Final probability of a random action."""
    epsilon_ticks: Annotated[int, Range(1, 1_000_000_000)] = 50_000
    """Ticks of linear decay between them."""

    def __post_init__(self) -> None:
        if self.epsilon_end > self.epsilon_start:
            raise ValueError(
                f"epsilon_end is {self.epsilon_end}; allowed: at most epsilon_start, {self.epsilon_start}"
            )

    def epsilon(self, learnt: int) -> float:
        """Return the probability of a random action after ``learnt`` ticks."""
        remaining = max(0.0, 1 - learnt / self.epsilon_ticks)
        return self.epsilon_end + (self.epsilon_start - self.epsilon_end) * remaining


@dataclass(frozen=True, kw_only=True)
class QSettings(ValueSettings):
    """Hyperparameters of IQL, VDN, QMIX and QTRAN."""

    td_lambda: Annotated[float, Range(0, 1)] = 0.6
    """Lambda of the returns; 0 is one-step Q-learning."""
    batch: Annotated[int, Range(1, 50_000)] = 512
    """Ticks per optimiser step, in whole rollouts of one world."""
    buffer: Annotated[int, Range(1, 1_000_000)] = 5_000
    """Capacity of the replay memory in ticks; with ten times as many, VDN on the strip forgot what it had learned."""
    replays: Annotated[float, Range(0.01, 1000)] = 16.0
    """Average number of times that each tick is sampled."""
    target_rate: Annotated[float, Range(1e-4, 1)] = 0.01
    """Part of the difference by which the target networks follow; 1 is a copy."""
    target_ticks: Annotated[int, Range(0, 1_000_000_000)] = 0
    """Ticks from one time that they follow to the next; 0: they do after every step of the optimiser."""
    limit_ends: Annotated[int, Range(0, 1)] = 0
    """1: nothing is worth anything after the time limit, as after success; 0: its value is estimated."""
    rmsprop: Annotated[int, Range(0, 1)] = 0
    """1: RMSProp in place of Adam."""
    standardize: Annotated[int, Range(0, 1)] = 0
    """1: rewards are divided by the standard deviation of all so far."""


@dataclass(frozen=True, kw_only=True)
class PQNSettings(ValueSettings):
    """Hyperparameters of PQN-VDN."""

    td_lambda: Annotated[float, Range(0, 1)] = 0.65
    """Lambda of the returns."""
    epochs: Annotated[int, Range(1, 100)] = 2
    """Epochs over each rollout."""
    minibatches: Annotated[int, Range(1, 1024)] = 8
    """Minibatches per epoch."""
