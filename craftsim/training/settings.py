"""Hyperparameters of the algorithms: what they are unless said otherwise, within which bounds, and from a YAML file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from craftsim.errors import InputError, suggestion
from craftsim.storage.limits import Range
from craftsim.storage.yaml import described, read_document

if TYPE_CHECKING:
    from craftsim.training.config import AlgoName


def _within(default: float, low: float, high: float) -> Any:
    return field(default=default, metadata={"range": Range(low, high)})


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What all algorithms have. Raises InputError for a number outside its range; a whole default wants a whole one."""

    gamma: float = _within(0.99, 0, 1)
    """Discount of a tick."""
    learning_rate: float = _within(1e-3, 1e-6, 1)
    max_gradient: float = _within(1.0, 1e-3, 1_000_000)
    """Gradients of a larger norm are scaled down to it."""

    def __post_init__(self) -> None:
        for of in fields(self):
            value = getattr(self, of.name)
            of.metadata["range"].check(of.name, value)
            if isinstance(of.default, int) and value != int(value):
                raise InputError(f"{of.name} is {value}; it must be an integer")


@dataclass(frozen=True, kw_only=True)
class PPOSettings(Settings):
    """Of IPPO and MAPPO."""

    gae_lambda: float = _within(0.95, 0, 1)
    """Of generalised advantages."""
    clip: float = _within(0.2, 0.001, 10)
    """How far the ratio of probabilities may go from 1."""
    entropy: float = _within(0.01, 0, 10)
    """Weight of the policy's entropy."""
    critic: float = _within(0.5, 0, 100)
    """Weight of the critic's error."""
    epochs: int = _within(4, 1, 100)
    """How often each tick is learnt from."""
    minibatches: int = _within(4, 1, 1024)
    """Parts of a rollout, each with a step of the optimiser."""
    decay_ticks: int = _within(0, 0, 1_000_000_000)
    """Ticks in which the learning rate falls evenly to nothing; 0 for a rate that stays."""

    def rate(self, learnt: int) -> float:
        """Return the learning rate after so many ticks."""
        left = max(0.0, 1 - learnt / self.decay_ticks) if self.decay_ticks else 1.0
        return self.learning_rate * left


@dataclass(frozen=True, kw_only=True)
class COMASettings(Settings):
    """Of COMA."""

    td_lambda: float = _within(0.8, 0, 1)
    """Of the critic's returns."""
    entropy: float = _within(0.01, 0, 10)
    """Weight of the policy's entropy."""
    minibatches: int = _within(16, 1, 1024)
    """Parts of a rollout, each with a step of the optimiser."""
    target_rate: float = _within(0.05, 1e-4, 0.999)
    """How far the target critic follows at each step."""


@dataclass(frozen=True, kw_only=True)
class QSettings(Settings):
    """Of IQL, VDN, QMIX and QTRAN."""

    learning_rate: float = _within(5e-4, 1e-6, 1)
    max_gradient: float = _within(10.0, 1e-3, 1_000_000)
    batch: int = _within(512, 1, 50_000)
    """Ticks that a step of the optimiser learns from."""
    learns_every: int = _within(128, 1, 1_000_000)
    """Ticks played for each batch learnt from."""
    target_rate: float = _within(0.01, 1e-4, 0.999)
    """How far the target networks follow at each step."""
    epsilon_start: float = _within(1.0, 0, 1)
    """Part of random actions at first."""
    epsilon_end: float = _within(0.03, 0, 1)
    """The same in the end."""
    epsilon_ticks: int = _within(300_000, 1, 1_000_000_000)
    """Ticks until then."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.epsilon_end > self.epsilon_start:
            raise InputError(
                f"epsilon_end is {self.epsilon_end}; allowed: at most epsilon_start, {self.epsilon_start}"
            )


KINDS: Final[Mapping[AlgoName, type[Settings]]] = {
    **dict.fromkeys(("ippo", "mappo"), PPOSettings),
    "coma": COMASettings,
    **dict.fromkeys(("iql", "vdn", "qmix", "qtran"), QSettings),
}


def settings_of(algo: AlgoName, given: Mapping[str, float]) -> Settings:
    """Return the settings of an algorithm, some of them as given; raises InputError for unknown ones too."""
    kind = KINDS[algo]
    wholes = {of.name: isinstance(of.default, int) for of in fields(kind)}
    for name, value in given.items():
        if name not in wholes:
            raise InputError(
                f"{algo} has no setting '{str(name)[:40]}'{suggestion(str(name)[:80], list(wholes))}; "
                f"allowed: {', '.join(wholes)}"
            )
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"{name} is {str(value)[:40]!r}; it must be a number")
    settings = kind(**given)
    # What is whole stays so, though a file may have it as 4.0.
    return kind(**{name: int(v) if wholes[name] else v for name, v in vars(settings).items()})


def read_settings(path: Path, algo: AlgoName) -> dict[str, float]:
    """Return what a YAML file says of an algorithm's settings; raises InputError with file, line and key."""
    document = read_document(path)
    given = document.mapping(of.name for of in fields(KINDS[algo]))
    document.refuse(
        ((name,), f"key '{name}': must be a number, not {described(value)}")
        for name, value in given.items()
        if not isinstance(value, int | float)
    )
    try:
        settings_of(algo, given)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return given
