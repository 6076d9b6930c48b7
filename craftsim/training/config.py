"""The configuration of a training run; it is kept in its checkpoints."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from typing import Any, Final, Literal, get_args

from craftsim.errors import InputError

AlgoName = Literal["ippo", "mappo", "qmix", "vdn", "iql"]
ALGO_NAMES: Final[tuple[str, ...]] = get_args(AlgoName)


@dataclass(frozen=True)
class TrainConfig:
    """Everything that decides what a run learns, its length aside. Raises InputError for a bad value."""

    task: str
    """A registered name, a file or ``module:factory``, as :func:`craftsim.discrete.tasks.as_task` takes it."""
    algo: AlgoName = "ippo"
    seed: int = 0
    worlds: int = 500
    """How many grid worlds are stepped side by side in a rollout."""
    width: int = 128
    """Length of the vectors inside the networks."""
    novelty: float = 0.0
    """Exploration bonus for a building never seen before; for one seen k times it is divided by the root of k."""
    n_cars: int | None = None
    """Other than the task's number of cars; those that its start does not list are drawn at random."""
    n_blocks: int | None = None
    """The same for blocks."""

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise InputError(f"seed is {self.seed}; allowed: 0 or more")
        if self.worlds < 1:
            raise InputError(f"worlds is {self.worlds}; allowed: 1 or more")
        if self.width < 1:
            raise InputError(f"width is {self.width}; allowed: 1 or more")
        if not 0 <= self.novelty < math.inf:
            raise InputError(f"novelty is {self.novelty}; allowed: 0 or more, and finite")

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> TrainConfig:
        """Return what :meth:`as_dict` was made of; raises InputError if a key is missing or unknown."""
        names = {field.name for field in fields(cls)}
        if set(values) != names:
            raise InputError(f"a configuration has the keys {sorted(names)}, not {sorted(values)}")
        return cls(**values)
