"""The algorithms, a row each. Options, help, messages and tests follow from these rows.

A variant of an algorithm is a row here, a learner of its own (a subclass of the one that it varies) and a test.
Importing this is cheap, which help and tab completion need: learners are imported when a run begins.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import TYPE_CHECKING, Final, Literal, TypeAlias, get_type_hints

from craftsim.learning.settings import (
    COMASettings,
    PPOSettings,
    PQNSettings,
    QSettings,
    Settings,
)
from craftsim.storage.limits import Range


@dataclass(frozen=True, kw_only=True)
class Algorithm:
    """An algorithm: what learns, from which settings, and what goes together with it."""

    title: str
    """For help."""
    learner: str
    """Module and class of its learner."""
    settings: type[Settings]
    """Its hyperparameters."""
    grid_worlds: int
    """Default number of parallel worlds on the grid: fewer worlds mean more updates."""
    learns_probabilities: bool = False
    """It learns a stochastic policy; others learn values of actions."""
    imitates: bool = False
    """It can imitate plans before it learns."""
    is_asynchronous: bool = False
    """It learns from cars that decide one by one, too."""
    is_recurrent: bool = False
    """Its policy may have a memory."""
    decays_in_paper: bool = True
    """Its learning rate decays to 0 under the paper's protocol."""


_PPO: Final = "craftsim.learning.policy_gradient"
_Q: Final = "craftsim.learning.q_learning"
ALGORITHMS: Final[Mapping[str, Algorithm]] = {
    "ippo": Algorithm(
        title="independent PPO",
        learner=f"{_PPO}:PPOLearner",
        settings=PPOSettings,
        grid_worlds=500,
        learns_probabilities=True,
        imitates=True,
        is_asynchronous=True,
        decays_in_paper=False,
    ),
    "mappo": Algorithm(
        title="multi-agent PPO",
        learner=f"{_PPO}:MAPPOLearner",
        settings=PPOSettings,
        grid_worlds=500,
        learns_probabilities=True,
        imitates=True,
        is_asynchronous=True,
        decays_in_paper=False,
    ),
    "coma": Algorithm(
        title="COMA",
        learner=f"{_PPO}:COMALearner",
        settings=COMASettings,
        grid_worlds=25,
        learns_probabilities=True,
    ),
    "iql": Algorithm(
        title="independent Q-learning",
        learner=f"{_Q}:IQLLearner",
        settings=QSettings,
        grid_worlds=25,
        is_recurrent=True,
    ),
    "vdn": Algorithm(
        title="VDN",
        learner=f"{_Q}:VDNLearner",
        settings=QSettings,
        grid_worlds=25,
        is_recurrent=True,
    ),
    "qmix": Algorithm(
        title="QMIX",
        learner=f"{_Q}:QMIXLearner",
        settings=QSettings,
        grid_worlds=25,
        is_recurrent=True,
    ),
    "qtran": Algorithm(
        title="QTRAN",
        learner=f"{_Q}:QTRANLearner",
        settings=QSettings,
        grid_worlds=25,
        is_recurrent=True,
    ),
    "pqn": Algorithm(
        title="PQN-VDN",
        learner=f"{_Q}:PQNLearner",
        settings=PQNSettings,
        grid_worlds=100,
    ),
}
"""The algorithms by name."""

if TYPE_CHECKING:
    AlgoName: TypeAlias = str
else:
    # The command line and records check it, so that a row is all that a name needs.
    AlgoName = Literal[tuple(ALGORITHMS)]

Trait = Literal["learns_probabilities", "imitates", "is_asynchronous", "is_recurrent"]


def with_trait(trait: Trait) -> list[AlgoName]:
    """Return the algorithms that have a trait."""
    names = []
    for name, algorithm in ALGORITHMS.items():
        if getattr(algorithm, trait):
            names.append(name)
    return names


def names_of(settings: type[Settings]) -> list[AlgoName]:
    """Return the algorithms that have settings of a class."""
    names = []
    for name, algorithm in ALGORITHMS.items():
        if algorithm.settings is settings:
            names.append(name)
    return names


def enumerated(names: Iterable[str]) -> str:
    """Return names in a sentence, such as "iql, vdn and qmix"."""
    *first, last = names
    if not first:
        return last
    return f"{', '.join(first)} and {last}"


def readers_of(name: str) -> list[AlgoName]:
    """Return the algorithms that read a hyperparameter."""
    algos = []
    for algo, algorithm in ALGORITHMS.items():
        if name in {field.name for field in fields(algorithm.settings)}:
            algos.append(algo)
    return algos


def default_of(name: str, algo: AlgoName) -> float:
    """Return the default of a hyperparameter of an algorithm."""
    default: float = getattr(ALGORITHMS[algo].settings(), name)
    return default


@cache
def setting_range(name: str, algo: AlgoName) -> Range:
    """Return the range of a hyperparameter of an algorithm."""
    # A command line asks for each many times, and each time all annotations would be evaluated.
    annotation = get_type_hints(ALGORITHMS[algo].settings, include_extras=True)[name]
    (allowed,) = annotation.__metadata__
    assert isinstance(allowed, Range)
    return allowed
