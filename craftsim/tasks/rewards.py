"""Rewards: sums of named, weighted terms. A term is what a potential pays for a tick, or a function of a tick.

A new term is a function and a row of :data:`TERMS`, or a call of :func:`register_term`; weights are in
:data:`REWARDS`, in task files, or given to :class:`Reward`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.arrays import Flags, Floats
from craftsim.discrete.grid import Grid
from craftsim.errors import InputError, suggestion
from craftsim.tasks.observation import Layout
from craftsim.tasks.potentials import (
    Potential,
    building,
    complex_building,
    complexity,
    flag_nearness,
    platform,
    published_building,
    published_platform,
    structure,
)
from craftsim.tasks.starts import Targets
from craftsim.workers.modules import note_registering

ALPHA: Final = 10.0
"""Reward of a tick that ends with the flag on the goal, by the paper."""
BETA: Final = 1.0
"""Cost of every tick of the barrier task, by the paper."""
PUBLISHED_BONUS: Final = 20.0
"""From this CraftEnv's code subtracts the tick's number when the flag first reaches the goal."""


@dataclass(frozen=True, eq=False)
class Transition:
    """One tick of B worlds with n cars each, or one event of asynchronous execution. To keep, not to change.

    It has the same fields on the grid and in physics, in ticks and asynchronous.
    """

    before: Grid
    """The B worlds before the tick."""
    after: Grid
    """The B worlds after it: on the grid by the rules, in physics as read from poses."""
    designs: Targets
    """(B, T, 5): what is to be built in each world."""
    layout: Layout
    """What the task announces: numbers of things, and the goal cell."""
    t: NDArray[np.int64]
    """(B,): number of the tick in its episode, from 0."""
    actions: NDArray[np.int64]
    """(B, n): actions as chosen; in asynchronous execution STOP for a car whose decision has not ended."""
    applied: Flags
    """(B, n): true if the rules allowed the action when its turn came."""
    durations_s: Floats
    """(B, n): durations of the actions, nominal on the grid, simulated in physics; 0 where nothing was done."""
    duration_s: Floats
    """(B,): duration of the tick."""
    attempts: tuple[tuple[Any, ...], ...]
    """By world and car the :class:`craftsim.Attempt` of the judge: primitive, result, errors and forces; None on the
    grid, and for a car whose action has not ended."""
    contacts: tuple[tuple[Any, ...] | None, ...]
    """By world the contacts of the tick, each with ``first``, ``second`` and ``peak_n``; None on the grid, and in
    physics unless the option ``check_contacts`` is on. In asynchronous execution those of the cars whose actions have
    ended, and of what these handled, since the actions began."""
    problems: tuple[tuple[str, ...], ...]
    """By world the reasons why it cannot be read as a grid any more; empty where it can."""

    @property
    def verdicts(self) -> NDArray[np.object_]:
        """(B, n): ``as predicted``, ``failed``, ``side effect``, ``unsafe``, ``numerics``; None without an attempt."""
        verdicts = np.full(self.applied.shape, None, object)
        for world, attempts in enumerate(self.attempts):
            for car, attempt in enumerate(attempts):
                if attempt is not None:
                    verdicts[world, car] = str(attempt.result)
        return verdicts


Payment = Callable[[Floats, Floats, NDArray[np.int64], Flags], Floats]
"""(B,): what a tick pays by its potential before and after, its number from 0, and whether the goal was reached in an
earlier tick but the first, so that a bonus that is paid once is spent; all (B,)."""


def change(before: Floats, after: Floats, t: NDArray[np.int64], bonus_given: Flags) -> Floats:
    """Return the change of the potential: over an episode that of the end less that of the start."""
    return after - before


def published_change(
    before: Floats, after: Floats, t: NDArray[np.int64], bonus_given: Flags
) -> Floats:
    """Return in the first tick the whole potential, then its change (docs/rules.md#first-tick)."""
    return np.where(t == 0, after, after - before)


def published_steps(
    before: Floats, after: Floats, t: NDArray[np.int64], bonus_given: Flags
) -> Floats:
    """Return in the first tick nothing, then the change of the potential."""
    return np.where(t == 0, 0.0, after - before)


def published_bonus(
    before: Floats, after: Floats, t: NDArray[np.int64], bonus_given: Flags
) -> Floats:
    """Return one bonus for the flag at the goal, the less the later (docs/rules.md#flag-bonus)."""
    arrived = (t >= 1) & (after == 0) & ~bonus_given
    return np.where(arrived, PUBLISHED_BONUS - t, 0.0)


def at_zero(before: Floats, after: Floats, t: NDArray[np.int64], bonus_given: Flags) -> Floats:
    """Return 1 in each tick that ends with a potential of 0."""
    return (after == 0).astype(np.float64)


_CHANGES: Final = (change, published_change, published_steps)
"""Payments that add up to the potential of the end, but for that of the start."""
_WITHOUT_MEMORY: Final = (*_CHANGES, at_zero)
"""Payments that do not look at ``bonus_given``."""


@dataclass(frozen=True)
class PotentialTerm:
    """A term that looks at worlds alone: what is paid for a potential before and after a tick."""

    potential: Potential
    pays: Payment = change


Term = float | PotentialTerm | Callable[[Transition], Any]
"""A number, which each tick pays; a potential; or a function of a Transition, which returns (B,) finite numbers.

In asynchronous execution a tick is an event, and what numbers and potentials cost while nothing changes is charged for
each usual tick of time.
"""
Weights = Mapping[Any, float]
"""Weights by term, or by the name of a term."""


def illegal_actions(tick: Transition) -> Any:
    """Return how many actions the rules forbade."""
    return (~tick.applied).sum(axis=1)


def failures(tick: Transition) -> Any:
    """Return how many actions did not go as predicted in physics; 0 on the grid."""
    verdicts = tick.verdicts
    return ((verdicts != None) & (verdicts != "as predicted")).sum(axis=1)  # noqa: E711


def seconds(tick: Transition) -> Floats:
    """Return the duration of the tick."""
    return tick.duration_s


TERMS: Final[dict[str, Term]] = {
    "building": PotentialTerm(building),
    "complex_building": PotentialTerm(complex_building),
    "published_building": PotentialTerm(published_building, published_change),
    "platform": PotentialTerm(platform),
    "published_platform": PotentialTerm(published_platform, published_change),
    "complexity": PotentialTerm(complexity),
    "structure": PotentialTerm(structure),
    "flag_nearness": PotentialTerm(flag_nearness),
    "flag_at_goal": PotentialTerm(flag_nearness, at_zero),
    "published_flag_steps": PotentialTerm(flag_nearness, published_steps),
    "published_flag_bonus": PotentialTerm(flag_nearness, published_bonus),
    "tick": 1.0,
    "illegal_actions": illegal_actions,
    "failures": failures,
    "seconds": seconds,
}
"""Terms by name, the registered ones included."""

REWARDS: Final[dict[str, dict[str, dict[str, float]]]] = {
    "paper": {
        "built": {"building": 1.0},
        # By table 1 a block of the second storey is worth more in this building.
        "complex_two_story": {"complex_building": 1.0},
        "one_platform": {"platform": 1.0},
        "flag_at_goal": {"flag_nearness": 1.0, "flag_at_goal": ALPHA, "tick": -BETA},
    },
    "published_code": {
        "built": {"published_building": 1.0},
        "one_platform": {"published_platform": 1.0},
        "flag_at_goal": {"published_flag_steps": 1.0, "published_flag_bonus": 1.0},
    },
}
"""Weights of terms by reward and goal: as the paper states rewards, and as CraftEnv's code computes them."""

_SHIPPED: Final = frozenset(TERMS)
_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


def register_term(name: str, term: Term) -> None:
    """Make a term known by its name, in Python and in task files; registering it again replaces it.

    Processes that craftsim starts import the modules that register at their top level. Raises InputError for the name
    of a shipped term or reward, for one that is not made of letters, digits and ``_``, and for what is no term.

    Example:
        >>> from craftsim.tasks import make_task
        >>> from craftsim.tasks.rewards import register_term
        >>> register_term("idle_cars", lambda tick: (tick.durations_s == 0).sum(axis=1))
        >>> task = make_task("strip", reward={"paper": 1.0, "idle_cars": -0.1})
        >>> task.reward.terms
        {'building': 1.0, 'idle_cars': -0.1}
    """
    if name in _SHIPPED or name in REWARDS:
        raise InputError(f"'{name}' is a term or reward of craftsim's own; give yours another name")
    if not _NAME.fullmatch(name):
        raise InputError(f"a term's name is made of letters, digits and _, not '{name}'")
    if not callable(term) and not isinstance(term, PotentialTerm):
        raise InputError(f"the term '{name}' must be a PotentialTerm or a function, not {term!r}")
    note_registering()
    TERMS[name] = term


@dataclass(frozen=True)
class Reward:
    """The reward of a tick, one number shared by all cars: the weighted sum of terms.

    Example:
        >>> from craftsim.tasks.rewards import Reward
        >>> Reward({"building": 1.0, "illegal_actions": -0.1}).sees_transitions
        True
    """

    terms: Weights

    def __post_init__(self) -> None:
        if not isinstance(self.terms, Mapping) or not self.terms:
            raise InputError(
                f"a reward is a mapping of terms and weights, such as {{'building': 1.0}}, not {self.terms!r}"
            )
        for term, weight in self.terms.items():
            if not isinstance(term, PotentialTerm):
                check_name("reward term", term, TERMS)
            _check_weight(term, weight)

    def __getstate__(self) -> dict[str, Any]:
        """Return what is copied and pickled: names stay names, whatever they stand for."""
        return {"terms": self.terms}

    @property
    def is_published(self) -> bool:
        """Whether it is what CraftEnv's code pays, and nothing else."""
        return dict(self.terms) in REWARDS["published_code"].values()

    @cached_property
    def _potentials(self) -> list[Potential]:
        """Potentials that terms look at, each once."""
        potentials: list[Potential] = []
        for term in map(_term, self.terms):
            if isinstance(term, PotentialTerm) and term.potential not in potentials:
                potentials.append(term.potential)
        return potentials

    @cached_property
    def _payments(self) -> list[tuple[Payment, int, float]]:
        """Payments, each with the index of its potential and its weight."""
        payments = []
        for name, weight in self.terms.items():
            term = _term(name)
            if isinstance(term, PotentialTerm):
                payments.append((term.pays, self._potentials.index(term.potential), float(weight)))
        return payments

    @cached_property
    def _each_tick(self) -> float:
        """What each tick pays, whatever happens."""
        total = 0.0
        for name, weight in self.terms.items():
            term = _term(name)
            if isinstance(term, float):
                total += weight * term
        return total

    @cached_property
    def _functions(self) -> list[tuple[str, Callable[[Transition], Any], float]]:
        """Functions of a Transition, each with its name and weight."""
        functions = []
        for name, weight in self.terms.items():
            term = _term(name)
            if not isinstance(term, float | PotentialTerm):
                functions.append((_words(name), term, float(weight)))
        return functions

    @cached_property
    def _costs_time(self) -> bool:
        """Whether a tick may cost something in which nothing changes."""
        pays = [pays for pays, _, _ in self._payments if pays is not change]
        return bool(pays) or self._each_tick < 0

    @cached_property
    def pays_once(self) -> bool:
        """Whether a payment may depend on whether the goal was reached earlier."""
        return any(pays not in _WITHOUT_MEMORY for pays, _, _ in self._payments)

    @cached_property
    def sees_transitions(self) -> bool:
        """Whether a term is a function of a Transition."""
        return bool(self._functions)

    @cached_property
    def sees_marks(self) -> bool:
        """Whether a term is not a shipped potential, so that it may look at the marks of worlds."""
        return self.sees_transitions or not {*self.terms} <= _SHIPPED

    def potentials(self, grids: Grid, designs: Targets, layout: Layout) -> list[Floats]:
        """Return the potentials that terms look at, each (B,)."""
        values = []
        for potential in self._potentials:
            values.append(potential(grids, designs, layout))
        if self.sees_marks:
            return [_checked("a potential", value, len(designs)) for value in values]
        return values

    def potential(self, values: Sequence[Floats], n_worlds: int) -> Floats:
        """Return (B,): the weighted sum of the potentials whose changes are paid."""
        total = np.zeros(n_worlds)
        for pays, index, weight in self._payments:
            if pays in _CHANGES:
                total = total + weight * values[index]
        return total

    def score(
        self,
        before: Sequence[Floats],
        after: Sequence[Floats],
        t: NDArray[np.int64],
        bonus_given: Flags,
        transition: Transition | None = None,
        usual_ticks: Floats | None = None,
    ) -> Floats:
        """Return (B,): the reward of a tick, on each backend and in each execution.

        Args:
            before: the :meth:`potentials` before the tick.
            after: the same after it.
            t: (B,), numbers of the ticks, from 0.
            bonus_given: (B,), see :data:`Payment`.
            transition: what happened; needed where the reward :attr:`sees_transitions`.
            usual_ticks: (B,), how many usual ticks the time of an asynchronous event is.

        Raises InputError for a function that returns anything but (B,) finite numbers.
        """
        total = self._pay(before, after, t, bonus_given)
        for name, function, weight in self._functions:
            assert transition is not None
            total = total + weight * _checked(name, function(transition), len(t))
        if usual_ticks is not None and self._costs_time:
            idle = self._pay(before, before, t, bonus_given)
            total = total + np.minimum(idle, 0.0) * (usual_ticks - 1.0)
        return total

    def _pay(
        self,
        before: Sequence[Floats],
        after: Sequence[Floats],
        t: NDArray[np.int64],
        bonus_given: Flags,
    ) -> Floats:
        """Return (B,): the weighted sum of what potentials and each tick pay."""
        total: Floats | None = None
        for pays, index, weight in self._payments:
            value = pays(before[index], after[index], t, bonus_given)
            if weight != 1.0:
                value = weight * value
            if total is None:
                total = value
            else:
                total = total + value
        if total is None:
            return np.full(len(t), self._each_tick)
        if self._each_tick:
            total = total + self._each_tick
        return total


def make_reward(reward: str | Weights, *goals: str) -> Reward:
    """Return the reward of a name in :data:`REWARDS` or :data:`TERMS`, or of weights of such names and of terms.

    ``goals`` are keys of the entries of :data:`REWARDS`; the first that an entry has counts. Raises InputError for an
    unknown name, and for the name of a reward without a goal.
    """
    weights = reward
    if isinstance(weights, str):
        weights = {weights: 1.0}
    if not isinstance(weights, Mapping):
        raise InputError(f"a reward is a name, or a mapping of names and weights, not {reward!r}")
    terms: dict[str | Term, float] = {}
    for name, weight in weights.items():
        if not isinstance(name, PotentialTerm):
            check_name("reward", name, [*REWARDS, *TERMS])
        _check_weight(name, weight)
        for term, share in _shares(name, goals).items():
            terms[term] = terms.get(term, 0.0) + weight * share
    return Reward(terms)


def _shares(name: str | Term, goals: Sequence[str]) -> Weights:
    """Return the terms that a name stands for."""
    if not isinstance(name, str) or name not in REWARDS:
        return {name: 1.0}
    by_goal = REWARDS[name]
    for goal in goals:
        if goal in by_goal:
            return dict(by_goal[goal])
    raise InputError(f"the reward '{name}' is of a goal, and there is none")


def _check_weight(name: str | Term, weight: Any) -> None:
    """Raise InputError for anything but a finite number."""
    is_number = isinstance(weight, int | float | np.number) and not isinstance(weight, bool)
    if not is_number or not np.isfinite(weight):
        raise InputError(f"the weight of {_words(name)} is {weight!r}; allowed: a finite number")


def _term(name: str | Term) -> Term:
    """Return a term, or the one of a name."""
    if not isinstance(name, str):
        return name
    check_name("reward term", name, TERMS)
    return TERMS[name]


def _words(name: str | Term) -> str:
    if isinstance(name, str):
        return f"the reward term '{name}'"
    return f"the reward term {getattr(name, '__qualname__', name)}"


def _checked(name: str, value: Any, n_worlds: int) -> Floats:
    """Return what a function gave for a tick; raise InputError for anything but a finite number a world."""
    numbers = np.asarray(value)
    if (
        numbers.shape != (n_worlds,)
        or numbers.dtype.kind not in "biuf"
        or not np.isfinite(numbers).all()
    ):
        raise InputError(
            f"{name} returned {value!r}; it must return a finite number a world, shape ({n_worlds},)"
        )
    return numbers.astype(np.float64)


def check_name(noun: str, value: Any, options: Iterable[str]) -> None:
    """Raise InputError for anything but a function or the known name of one."""
    if not callable(value):
        names = list(options)
        if value not in names:
            raise InputError(
                f"unknown {noun} '{value}'{suggestion(str(value), names)}; there are {', '.join(names)}, or a function"
            )
