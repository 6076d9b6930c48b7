"""The phases of a tuning: search, finals on fresh seeds, the verdict on seeds held out, and sensitivity."""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.setup import Setup
from craftsim.errors import InputError
from craftsim.experiments.experiment import Item, TrialRecord
from craftsim.skills.gains import load_gains
from craftsim.tuning.goal import Goal
from craftsim.tuning.gains.knobs import Knob, Subject, knobs_of, turned, values_at
from craftsim.tuning.gains.objectives import Score, spread, undominated
from craftsim.tuning.gains.search import FIRST_STEP, NEXT_STEP, Search, population
from craftsim.tuning.gains.trials import Job
from craftsim.tuning.gains.verdict import HeldOut, joined, verdict_on

FINALISTS: Final = 6
"""Candidates of the search that are tried again on fresh seeds."""
FINAL_BLOCKS: Final = 4
"""Trials of each situation with which they are."""
HELD_OUT_BLOCKS: Final = 8
"""Trials of each situation for the verdict."""
PULL: Final = 0.002
"""What a knob that is turned to its bound costs the search, as a logarithm: gains without effect stay at the start."""
NUDGE: Final = 0.1
"""By how much each knob is turned either way to see what it does: a factor of 1.23."""

_JUDGED: Final = ("start", "best", "shipped")
Values = Mapping[str, float]
"""Tuned gains by name."""


@dataclass(frozen=True)
class Candidate:
    """Gains that were tried."""

    values: Values
    score: Score


@dataclass(frozen=True)
class Effect:
    """What turning a single knob does to the goal's product: factors."""

    down: float
    """By :data:`NUDGE` towards smaller values."""
    up: float


@dataclass(frozen=True)
class TuningPlan:
    """What a tuning evaluates, known before it begins."""

    subject: Subject
    setup: Setup
    """With the gains to start from."""
    goal: Goal
    evaluations: int
    """Candidates of the search, about."""
    trials: int
    """Of each situation in the search."""
    seed: int

    @property
    def knobs(self) -> tuple[Knob, ...]:
        """What is tuned."""
        return knobs_of(self.subject, self.setup.gains)

    @property
    def generations(self) -> int:
        """Of each search."""
        return max(1, round(self.evaluations / len(self.goal.searches) / population(len(self.knobs))))

    @property
    def n_search(self) -> int:
        """Candidates of the search, the start included."""
        return 1 + len(self.goal.searches) * self.generations * population(len(self.knobs))

    @property
    def start(self) -> Values:
        """The tuned gains of the start."""
        return {knob.name: knob.start for knob in self.knobs}

    def items(self) -> list[Item]:
        """Return an item, without a job yet, for each evaluation."""
        names = [f"search {n}" for n in range(self.n_search)]
        names += [f"finalist {n} on block {b}" for n in range(FINALISTS) for b in range(FINAL_BLOCKS)]
        names += [f"{who} held out on block {b}" for who in _JUDGED for b in range(HELD_OUT_BLOCKS)]
        names += ["result", *(f"{knob.name} {way}" for knob in self.knobs for way in ("down", "up"))]
        return [Item(name, name, self.seed, None) for name in names]


class Phases:
    """Carries a plan out; each phase goes by the results of those before."""

    def __init__(self, plan: TuningPlan, run_some: Callable[[Mapping[int, Job]], list[TrialRecord]]) -> None:
        """Evaluate by what returns the records of items, by their numbers, each with its job."""
        self.plan, self.knobs, self._run_some = plan, plan.knobs, run_some
        self._next = 0
        """The item that comes next: they are all done in their order."""

    def search(self) -> tuple[list[Candidate], list[Values]]:
        """Return all candidates of all searches, first the start, and the centre of each search at its end."""
        plan, knobs = self.plan, self.knobs
        found = self._candidates([plan.start])
        favourites: list[Values] = []
        for number, weights in enumerate(plan.goal.searches):
            best = min(found, key=lambda one: one.score.log_cost(weights))
            begin = [knob.position(best.values[knob.name]) for knob in knobs]
            rng = np.random.default_rng([plan.seed, number])
            step = FIRST_STEP if number == 0 else NEXT_STEP
            search = Search([knob.bounds for knob in knobs], begin, step, rng)
            for _ in range(plan.generations):
                positions = search.ask()
                tried = self._candidates([values_at(knobs, x) for x in positions])
                costs = [one.score.log_cost(weights) for one in tried]
                search.tell(
                    positions, [c + PULL * float(x @ x) for c, x in zip(costs, positions, strict=True)]
                )
                found += tried
            favourites.append(values_at(knobs, search.favourite))
        return found, favourites

    def finals(self, searched: Sequence[Candidate], favourites: Sequence[Values]) -> list[Candidate]:
        """Try the best again on fresh seeds, and return the chosen one first, then the others.

        Of a front only those that are still on it.
        """
        goal, blocks = self.plan.goal, self._blocks(self.plan.trials, FINAL_BLOCKS)
        chosen = self._finalists(searched, favourites)
        again = [Candidate(own, Score.of(joined(self._try_apart(own, blocks)))) for own in chosen]
        if not goal.front:
            return sorted(again, key=lambda one: one.score.log_cost(goal.weights))
        front = undominated(costs := _costs(again, goal))
        pick = front[goal.pick(costs[front])]
        return [again[pick], *(again[n] for n in front if n != pick)]

    def _finalists(self, searched: Sequence[Candidate], favourites: Sequence[Values]) -> list[Values]:
        goal = self.plan.goal
        ranked = sorted(searched, key=lambda one: one.score.log_cost(goal.weights))
        if not goal.front:
            return [*favourites, *(one.values for one in ranked[: FINALISTS - 1])]
        front = [searched[n] for n in undominated(_costs(searched, goal))]
        wide = [front[n] for n in spread(_costs(front, goal), FINALISTS)]
        return [one.values for one in (*wide, *(one for one in ranked if one not in wide))][:FINALISTS]

    def judge(self, best: Candidate) -> tuple[HeldOut, list[tuple[str, Mapping[str, Any]]]]:
        """Compare the best with the start, and with what is shipped, on seeds that nothing was chosen by.

        Returns the verdict, and each trial that failed, with the name of the gains that it was tried with.
        """
        plan, nominal = self.plan, load_gains()
        shipped = {knob.name: knob.of(nominal) for knob in self.knobs}
        blocks = self._blocks(plan.trials + FINAL_BLOCKS, HELD_OUT_BLOCKS)
        start, found, usual = (self._try_apart(own, blocks) for own in (plan.start, best.values, shipped))
        failures: list[tuple[str, Mapping[str, Any]]] = [
            (name, trial)
            for name, records in (("before", start), ("after", found), ("shipped", usual))
            for trial in joined(records)
            if not trial["agrees"]
        ]
        return verdict_on(start, found, usual, plan.goal), failures

    def sensitivity(self, values: Values) -> dict[str, Effect]:
        """Return what each knob does around some gains, on the search's seeds."""
        turns = [values]
        for knob in self.knobs:
            at = knob.position(values[knob.name])
            turns += [{**values, knob.name: knob.value(at + way)} for way in (-NUDGE, NUDGE)]
        costs = np.array([one.score.log_cost(self.plan.goal.weights) for one in self._candidates(turns)])
        factors = np.exp(costs[1:] - costs[0]).reshape(-1, 2).tolist()
        return {knob.name: Effect(*both) for knob, both in zip(self.knobs, factors, strict=True)}

    def _candidates(self, values: Sequence[Values]) -> list[Candidate]:
        """Try gains on the search's seeds."""
        blocks = self._blocks(0, self.plan.trials)
        records = self._try([(own, blocks) for own in values])
        return [
            Candidate(own, Score.of(record["attempts"])) for own, record in zip(values, records, strict=True)
        ]

    def _try_apart(self, values: Values, blocks: Sequence[int]) -> list[TrialRecord]:
        """Try the same gains on several blocks, one at a time."""
        return self._try([(values, (block,)) for block in blocks])

    def _try(self, wanted: Sequence[tuple[Values, Sequence[int]]]) -> list[TrialRecord]:
        plan, jobs = self.plan, {}
        for values, blocks in wanted:
            gains = turned(plan.setup.gains, self.knobs, values)
            setup = replace(plan.setup, gains=gains)
            jobs[self._next] = Job(plan.subject, setup, tuple(values.items()), plan.seed, tuple(blocks))
            self._next += 1
        records = self._run_some(jobs)
        for job, record in zip(jobs.values(), records, strict=True):
            if record["extra"]["gains"] != dict(job.values):
                raise InputError(
                    f"{reprlib.repr(record['key'])} tried other gains than it would now: the search takes another way "
                    "on this machine; choose another --out"
                )
        return records

    @staticmethod
    def _blocks(first: int, count: int) -> Sequence[int]:
        return range(first, first + count)


def _costs(candidates: Sequence[Candidate], goal: Goal) -> NDArray[np.float64]:
    """Return the logarithms of a goal's objectives, (n, k)."""
    return np.array([one.score.log_costs(goal.objectives) for one in candidates])
