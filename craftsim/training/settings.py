"""Hyperparameters of the algorithms: what they are unless said otherwise, within which bounds, and from a YAML file."""

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
    """What all algorithms have. Raises InputError for a number outside its range; a whole default wants a whole one."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount of a tick."""
    learning_rate: Annotated[float, Range(1e-6, 1)] = 1e-3
    """Of the optimiser, Adam; RAdam of PQN."""
    max_gradient: Annotated[float, Range(1e-3, 1_000_000)] = 1.0
    """Gradients of a larger norm are scaled down to it."""
    decay_ticks: Annotated[int, Range(0, 1_000_000_000)] = 0
    """Ticks in which the learning rate falls evenly to nothing; 0 for a rate that stays."""

    def rate(self, learnt: int) -> float:
        """Return the learning rate after so many ticks."""
        left = max(0.0, 1 - learnt / self.decay_ticks) if self.decay_ticks else 1.0
        return self.learning_rate * left


@record(kw_only=True)
class PPOSettings(Settings):
    """Of IPPO and MAPPO."""

    gae_lambda: Annotated[float, Range(0, 1)] = 0.95
    """Of generalised advantages."""
    clip: Annotated[float, Range(0.001, 10)] = 0.2
    """How far the ratio of probabilities may go from 1."""
    entropy: Annotated[float, Range(0, 10)] = 0.01
    """Weight of the policy's entropy."""
    critic: Annotated[float, Range(0, 100)] = 0.5
    """Weight of the critic's error."""
    epochs: Annotated[int, Range(1, 100)] = 4
    """How often each tick is learnt from."""
    minibatches: Annotated[int, Range(1, 1024)] = 4
    """Parts of a rollout, each with a step of the optimiser."""


@record(kw_only=True)
class COMASettings(Settings):
    """Of COMA."""

    td_lambda: Annotated[float, Range(0, 1)] = 0.8
    """Of the critic's returns."""
    entropy: Annotated[float, Range(0, 10)] = 0.01
    """Weight of the policy's entropy."""
    minibatches: Annotated[int, Range(1, 1024)] = 2
    """Parts of a rollout, each with a step of the optimiser."""
    target_rate: Annotated[float, Range(1e-4, 0.999)] = 0.05
    """How far the target critic follows at each step."""


@record(kw_only=True)
class ValueSettings(Settings):
    """Of all algorithms that rate actions by value, and explore by random ones."""

    learning_rate: Annotated[float, Range(1e-6, 1)] = 5e-4
    max_gradient: Annotated[float, Range(1e-3, 1_000_000)] = 10.0
    epsilon_start: Annotated[float, Range(0, 1)] = 0.5
    """Part of random actions at first."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.2
    """The same in the end."""
    epsilon_ticks: Annotated[int, Range(1, 1_000_000_000)] = 50_000
    """Ticks until then."""

    def __post_init__(self) -> None:
        if self.epsilon_end > self.epsilon_start:
            raise ValueError(
                f"epsilon_end is {self.epsilon_end}; allowed: at most epsilon_start, {self.epsilon_start}"
            )

    def epsilon(self, learnt: int) -> float:
        """Return the part of random actions after so many ticks."""
        left = max(0.0, 1 - learnt / self.epsilon_ticks)
        return self.epsilon_end + (self.epsilon_start - self.epsilon_end) * left


@record(kw_only=True)
class QSettings(ValueSettings):
    """Of IQL, VDN, QMIX and QTRAN."""

    td_lambda: Annotated[float, Range(0, 1)] = 0.6
    """Of the returns; 0 is one-step Q-learning."""
    batch: Annotated[int, Range(1, 50_000)] = 512
    """Ticks that a step of the optimiser learns from, in whole rollouts of one world."""
    buffer: Annotated[int, Range(1, 1_000_000)] = 5_000
    """Ticks that are remembered; with ten times as many a run of VDN on the strip lost what it had learned."""
    replays: Annotated[float, Range(0.01, 1000)] = 16.0
    """How often each tick is learnt from, on average."""
    target_rate: Annotated[float, Range(1e-4, 1)] = 0.01
    """How far the target networks follow at each step."""


@record(kw_only=True)
class PQNSettings(ValueSettings):
    """Of PQN-VDN."""

    td_lambda: Annotated[float, Range(0, 1)] = 0.65
    """Of the returns."""
    epochs: Annotated[int, Range(1, 100)] = 2
    """How often each tick is learnt from."""
    minibatches: Annotated[int, Range(1, 1024)] = 8
    """Parts of a rollout, each with a step of the optimiser."""


KINDS: Final[Mapping[AlgoName, type[Settings]]] = {
    **dict.fromkeys(("ippo", "mappo"), PPOSettings),
    "coma": COMASettings,
    **dict.fromkeys(("iql", "vdn", "qmix", "qtran"), QSettings),
    "pqn": PQNSettings,
}


def settings_of(algo: AlgoName, given: Mapping[str, float]) -> Settings:
    """Return the settings of an algorithm, some of them as given; raises InputError for unknown ones too."""
    kind = KINDS[algo]
    # What is whole stays so, though a file may have it as 4.0.
    whole = {of.name for of in fields(kind) if isinstance(of.default, int)}
    values: dict[str, Any] = {n: int(v) if n in whole and v == v // 1 else v for n, v in given.items()}
    return kind(**values)


def read_settings(path: Path, algo: AlgoName) -> dict[str, float]:
    """Return what a YAML file says of an algorithm's settings; raises InputError with file, line and key."""
    document = read_document(path)
    document.to(KINDS[algo])
    return document.plain
