"""Hyperparameters of the algorithms, with defaults and bounds, and reading them from YAML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from craftsim.storage.limits import Range
from craftsim.storage.records import record
from craftsim.storage.yaml import read_document

if TYPE_CHECKING:
    from craftsim.training.config import AlgoName


@record(kw_only=True)
class Settings:
    """Common hyperparameters. Raises InputError for a value out of range; integers must stay integers."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per tick."""
    learning_rate: Annotated[float, Range(1e-6, 1)] = 1e-3
    """Learning rate of Adam; of RAdam for PQN."""
    max_gradient: Annotated[float, Range(1e-3, 1_000_000)] = 1.0
    """Clipping norm of gradients."""
    decay_ticks: Annotated[int, Range(0, 1_000_000_000)] = 0
    """Ticks of linear decay of the learning rate to 0; 0: constant rate."""

    def rate(self, learnt: int) -> float:
        """Return the learning rate after ``learnt`` ticks."""
        left = max(0.0, 1 - learnt / self.decay_ticks) if self.decay_ticks else 1.0
        return self.learning_rate * left


@record(kw_only=True)
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


@record(kw_only=True)
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


@record(kw_only=True)
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
        left = max(0.0, 1 - learnt / self.epsilon_ticks)
        return self.epsilon_end + (self.epsilon_start - self.epsilon_end) * left


@record(kw_only=True)
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
    """Soft update rate of the target networks."""
    standardize: Annotated[int, Range(0, 1)] = 0
    """1: rewards are divided by the standard deviation of all so far."""


@record(kw_only=True)
class PQNSettings(ValueSettings):
    """Hyperparameters of PQN-VDN."""

    td_lambda: Annotated[float, Range(0, 1)] = 0.65
    """Lambda of the returns."""
    epochs: Annotated[int, Range(1, 100)] = 2
    """Epochs over each rollout."""
    minibatches: Annotated[int, Range(1, 1024)] = 8
    """Minibatches per epoch."""


KINDS: Final[Mapping[AlgoName, type[Settings]]] = {
    **dict.fromkeys(("ippo", "mappo"), PPOSettings),
    "coma": COMASettings,
    **dict.fromkeys(("iql", "vdn", "qmix", "qtran"), QSettings),
    "pqn": PQNSettings,
}


def settings_of(algo: AlgoName, given: Mapping[str, float]) -> Settings:
    """Return the hyperparameters of an algorithm with some replaced. Raises InputError for unknown or invalid ones."""
    kind = KINDS[algo]
    # What is whole stays so, though a file may have it as 4.0.
    whole = {of.name for of in fields(kind) if isinstance(of.default, int)}
    values: dict[str, Any] = {n: int(v) if n in whole and v == v // 1 else v for n, v in given.items()}
    return kind(**values)


def read_settings(path: Path, algo: AlgoName) -> dict[str, float]:
    """Return the hyperparameters in a YAML file. Raises InputError with file, line and key."""
    document = read_document(path)
    document.to(KINDS[algo])
    return document.plain
