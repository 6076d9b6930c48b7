"""What a tuning wants: one weighted product of objectives, or a front of several."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from craftsim.errors import InputError, suggestion
from craftsim.tuning.gains.objectives import DEFAULT_WEIGHTS, OBJECTIVES, Objective, knee, weightings

Choice = Literal["knee", "time", "error", "margin", "energy", "force"]


@dataclass(frozen=True)
class Goal:
    """A weighted product of objectives, or the front of several and the choice on it."""

    weights: Mapping[Objective, float]
    """Of a front all the same."""
    front: bool = False
    choice: Choice = "knee"
    """The point of a front that is taken: its knee, or the best by an objective."""

    @classmethod
    def of(
        cls, words: Sequence[str] = (), objectives: Sequence[Objective] = (), choice: Choice = "knee"
    ) -> Goal:
        """Return the goal that options stand for.

        Args:
            words: ``NAME=WEIGHT`` each, for one product; time=1, error=0.2 and margin=0.2 unless anything is given.
            objectives: those of a front.
            choice: of a front.

        Raises InputError for both at once, and for what is no objective, no weight or no choice.
        """
        names: tuple[Objective, ...] = tuple(dict.fromkeys(objectives))
        if names and words:
            raise InputError("--weights and --objectives exclude each other: a product, or a front")
        if not names:
            if choice != "knee":
                raise InputError("--choose is for a front; give its --objectives")
            return cls(dict(map(_weight, words)) or DEFAULT_WEIGHTS)
        if len(names) < 2:
            raise InputError(f"a front has at least two objectives; for one give --weights {names[0]}=1")
        if choice != "knee" and choice not in names:
            raise InputError(f"--choose is {choice}; allowed on this front: knee, {', '.join(names)}")
        return cls(dict.fromkeys(names, 1.0), True, choice)

    @property
    def objectives(self) -> tuple[Objective, ...]:
        """Those that count."""
        return tuple(self.weights)

    @property
    def searches(self) -> Sequence[Mapping[Objective, float]]:
        """The weights of each search."""
        return weightings(self.objectives) if self.front else [self.weights]

    def pick(self, costs: NDArray[np.float64]) -> int:
        """Return which row of a front's costs (n, k) is chosen."""
        if self.choice == "knee":
            return knee(costs)
        return int(costs[:, self.objectives.index(self.choice)].argmin())

    def __str__(self) -> str:
        if self.front:
            return f"{self.choice} of the front of {', '.join(self.objectives)}"
        return ", ".join(f"{name}={weight:g}" for name, weight in self.weights.items())


def _weight(word: str) -> tuple[Objective, float]:
    name, equals, text = word.partition("=")
    if name not in OBJECTIVES:
        raise InputError(
            f"unknown objective '{name}'{suggestion(name, OBJECTIVES)}; there are {', '.join(OBJECTIVES)}"
        )
    try:
        weight = float(text) if equals else 1.0
    except ValueError:
        weight = math.nan
    if not 1e-3 <= weight <= 1e3:
        raise InputError(f"the weight of {name} is '{text}'; allowed: 0.001 to 1000, such as {name}=0.5")
    return cast(Objective, name), weight
