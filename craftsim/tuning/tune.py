"""Tuning gains: search on some seeds, choose on others, and judge on seeds that had no part in either.

A search ends with a coordinate search around the best, and what is chosen has passed whole plans that the start passes.
"""

from __future__ import annotations

import math
import reprlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import count, product
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from craftsim.audit.survey import situation_of
from craftsim.checking.attempt import Attempt, Thresholds
from craftsim.checking.measurements import LIMITED
from craftsim.checking.setup import Seed, Setup, compile_world, set_up
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.errors import CraftsimError, InputError, StartError
from craftsim.experiments.experiment import (
    STRICT,
    Experiment,
    Form,
    Result,
    RunOptions,
    Trial,
    TrialRecord,
)
from craftsim.experiments.session import open_session
from craftsim.models.world import PhysicsWorld
from craftsim.planning.plan_file import read_plan
from craftsim.skills.gains import Gains, gains_of_car, load_gains
from craftsim.storage.extras import need
from craftsim.tasks import as_task
from craftsim.tuning.goal import TuningGoal, TuningObjective, TuningScore, spread_out, undominated
from craftsim.tuning.tunable import GainGroup, situations, tunable_gains, values_at, with_values
from craftsim.validation.rollout import EpisodeJob, roll_out

TUNE_COMMAND: Final = "tune"
GAINS_FILE: Final = "gains.yaml"
_WORST: Final = 10.0
"""Share of a limit beyond which an error counts no more, nor one that is no number."""
_WORLDS_KEPT: Final = 96
"""Compiled worlds that a process keeps for the next candidate: 1 MB each."""
_FIRST_STEP: Final = 0.25
"""Standard deviation of the first candidates, in positions of gains: a factor of 1.7."""
_NEXT_STEP: Final = 0.12
"""The same of a search that begins where another one ended."""
COORDINATE_SHARE: Final = 0.5
"""Share of the candidates of the search that change single gains of the best..."""
COORDINATE_ROUNDS: Final = 2
"""...but no more than so many for each way of each gain."""
_COORDINATE_STEP: Final = 0.2
"""By how much they change a gain at first, in positions: a factor of 1.5. It is halved when all have been changed."""
_LEAST_STEP: Final = 1e-3
_NEEDED_PER_GAIN: Final = 20
"""Candidates that a search needs for each gain: some 20 generations of 17 gains."""
PLANS: Final = (
    "block",
    "strip",
    "simple_two_story",
    "free_building",
    "breaking_barrier",
    "complex_two_story",
)
"""Shipped plans that are carried out with the start and with the best finalists."""
_PLAN_FINALISTS: Final = 3
"""Finalists that are tried in whole plans."""
FINALISTS: Final = 6
"""Candidates of the search that are tried again on fresh seeds."""
FINAL_BLOCKS: Final = 4
"""Trials of each situation with which they are."""
HELD_OUT_BLOCKS: Final = 8
"""Trials of each situation for the verdict."""
_PRIOR_WEIGHT: Final = 0.002
"""What a gain at its bound costs the search, as a logarithm: gains without effect stay at the start."""
_SENSITIVITY_STEP: Final = 0.1
"""By how much each gain is moved either way to see what it does: a factor of 1.23."""

_COMPARED: Final = ("start", "best", "shipped")
_IN_PLANS: Final = ("start", *(f"finalist {number}" for number in range(_PLAN_FINALISTS)))
_Values = Mapping[str, float]
"""Tuned gains by name."""
Candidate = tuple[_Values, TuningScore]
"""Gains that were tried, and how they did."""


@dataclass(frozen=True)
class TriedAction:
    """What one action showed; shares are of the limits (:class:`~craftsim.checking.setup.Thresholds`).

    Not an Attempt: it has the work of the motors, and of the errors only what gains are chosen by.
    """

    __pydantic_config__ = STRICT
    situation: str
    """Its properties as text."""
    block: Annotated[int, Field(ge=0)]
    agrees: bool
    """Whether it did what the rules predict, within all limits, and nothing else."""
    duration_s: float
    error_share: float
    """The largest error, at the end, of the car and of what it sets down."""
    used_share: float
    """The same, or the displacement of a bystander, if that is more."""
    energy_j: float
    """Work of all wheel, board and hinge motors: the integral of ``|torque * speed|``, sampled each control period."""
    peak_force_n: float
    """Between any two machines, the ground included."""


@dataclass(frozen=True)
class _Extra:
    __pydantic_config__ = STRICT
    gains: dict[str, float]
    """The tuned ones, by name."""


_FORM: Final = Form(TriedAction, _Extra)
Job = tuple[GainGroup, Setup, int, Sequence[int]]
"""A candidate to be tried: the group, its setup with its gains, the seed, and the blocks. A block is one trial of every
situation: its own place on the map, physics and noise."""


@dataclass(frozen=True)
class PlanJob:
    """A shipped plan to be carried out by a candidate."""

    group: GainGroup
    setup: Setup
    """With its gains."""
    seed: int
    plan: str


def try_gains(job: Job | PlanJob) -> Result:
    """Try a candidate in every situation of its blocks, alike for all candidates, but not in worlds that cannot be.

    A plan is carried out whole.
    """
    if isinstance(job, PlanJob):
        return _try_plan(job)
    group, setup, seed, blocks = job
    pairs = product(blocks, range(len(situations(group))))
    trials = []
    for block, number in pairs:
        trial = _try(group, setup, seed, block, number)
        if trial:
            trials.append(trial)
    if not trials:
        raise CraftsimError("none of the worlds that were drawn can be")
    extra = {"gains": _tuned_gains(group, setup)}
    return Result(all(trial.agrees for trial in trials), trials, extra=extra)


def _tuned_gains(group: GainGroup, setup: Setup) -> dict[str, float]:
    return {gain.name: gain.of(setup.gains) for gain in tunable_gains(group, setup.gains)}


def _try_plan(job: PlanJob) -> Result:
    """Carry out a plan; it agrees if all of its actions do."""
    task = as_task(job.plan)
    n_cars = len(task.draw(np.random.default_rng(0)).cars)
    plan = read_plan(shipped_plan(job.plan), n_cars)
    episode = roll_out(
        EpisodeJob(key=job.plan, world=task, behaviour=plan, seed=job.seed, setup=job.setup)
    )
    agrees = episode.agrees and not episode.forbidden
    return Result(agrees, extra={"gains": _tuned_gains(job.group, job.setup)})


def _try(group: GainGroup, setup: Setup, seed: int, block: int, number: int) -> TriedAction | None:
    world, grid, action = _world(group, number, seed, block, replace(setup, gains=Setup().gains))
    try:
        judge = set_up(grid, setup, Seed((seed, block, number)), reuse=world)
    except StartError:
        return None
    cars = judge.physics.cars
    slopes = judge.physics.slopes
    motors: list[int] = []
    for car in cars:
        motors.extend(map(int, car.wheel_actuators))
    for car in cars:
        motors.append(car.board.actuator)
    for slope in slopes:
        motors.append(slope.hinge.actuator)
    joules = 0.0
    period_s = judge.physics.config.control_period_s

    def add_work(physics: PhysicsWorld) -> None:
        nonlocal joules
        force = physics.data.actuator_force[motors]
        speed = physics.data.actuator_velocity[motors]
        joules += float(np.abs(force * speed).sum()) * period_s

    judge.executor.observers.append(add_work)
    attempt = judge.perform(0, action)
    errors = shares(attempt, setup.thresholds)
    situation = str(situations(group)[number])
    measured = attempt.agrees, attempt.duration_s, *errors, joules, attempt.peak_force_n
    return TriedAction(situation, block, *measured)


@lru_cache(maxsize=_WORLDS_KEPT)
def _world(
    group: GainGroup, number: int, seed: int, block: int, setup: Setup
) -> tuple[PhysicsWorld, Grid, Action]:
    situation = situation_of(situations(group)[number], setup.rules, forbidden=True)
    placed = situation.placed(np.random.default_rng([seed, block, number]))
    return compile_world(placed.grid, setup), placed.grid, placed.acts[0]


def shares(attempt: Attempt, limits: Thresholds) -> tuple[float, float]:
    """Return the largest share of a limit that an action's own errors took, and that they or a bystander took."""
    of_action = [0.0]
    with_bystanders = [0.0]
    for measurement in LIMITED:
        share = (getattr(attempt, measurement.name) or 0.0) / measurement.limit_in(limits)
        with_bystanders.append(min(share, _WORST) if math.isfinite(share) else _WORST)
        if measurement.of != "bystander":
            of_action.append(with_bystanders[-1])
    return max(of_action), max(with_bystanders)


@dataclass(frozen=True)
class Ratio:
    """Gains against others on the same seeds: a factor of the goal's product, below 1 where they are better."""

    factor: float
    """The geometric mean over blocks of trials: one trial of every situation each."""
    low: float
    """Of its 95 % interval, by Student's t of the paired differences."""
    high: float


@dataclass(frozen=True)
class HeldOut:
    """Scores on the held-out seeds."""

    before: TuningScore
    """Of the gains that the tuning started from."""
    after: TuningScore
    """Of what was chosen."""
    shipped: TuningScore
    """Of craftsim's own gains, in place of those that were tuned."""
    against_start: Ratio
    """Of what was chosen."""
    against_shipped: Ratio
    control: Ratio
    """Of the start against itself, each second block against the one before: nothing is changed but what is drawn."""
    improved: bool
    """Whether what was chosen takes the place of the start: it fails no more often and costs less; of a front, it fails
    no more often, and the start is not as good in all objectives."""


@dataclass(frozen=True)
class PlanCheck:
    """Whole plans with some gains."""

    values: _Values
    failed: tuple[str, ...]
    """Plans in which an action did not do what the rules predict."""


def _joined(records: Sequence[TrialRecord]) -> list[dict[str, Any]]:
    trials = []
    for record in records:
        for trial in record["attempts"]:
            trials.append(trial)
    return trials


def _ratio(
    ours: Sequence[TrialRecord],
    reference: Sequence[TrialRecord],
    weights: Mapping[TuningObjective, float],
) -> Ratio:
    from scipy.stats import t

    differences = _log_costs(ours, weights) - _log_costs(reference, weights)
    half = float(
        t.ppf(0.975, len(differences) - 1) * differences.std(ddof=1) / math.sqrt(len(differences))
    )
    middle = float(differences.mean())
    return Ratio(math.exp(middle), math.exp(middle - half), math.exp(middle + half))


def _log_costs(
    records: Sequence[TrialRecord], weights: Mapping[TuningObjective, float]
) -> NDArray[np.float64]:
    """Return the logarithm (n,) of the goal's product of each record."""
    return np.array([TuningScore.of(record["attempts"]).log_cost(weights) for record in records])


def need_cma() -> None:
    """Raise InputError where cma is missing."""
    need("tune", "tuning needs", "cma")


def population(n: int) -> int:
    """Return how many candidates of n gains a generation has, by Hansen's rule."""
    return 4 + int(3 * np.log(n))


def cma_es(
    bounds: Sequence[tuple[float, float]],
    begin: Sequence[float],
    step: float,
    rng: np.random.Generator,
) -> Any:
    """Return a search by ask and tell from a position within bounds, (n,) each: covariance matrix adaptation (Hansen,
    arXiv 1604.00772; the package cma), fit for tens of gains and a noisy cost of which only the order counts."""
    from cma import CMAEvolutionStrategy

    low, high = np.array(bounds).T
    options = {
        "bounds": [low.tolist(), high.tolist()],
        "popsize": population(len(bounds)),
        # The usual one draws from NumPy's global generator.
        "randn": lambda *shape: rng.standard_normal(shape),
        "seed": np.nan,
        "verbose": -9,
    }
    return CMAEvolutionStrategy(np.clip(begin, low, high).tolist(), step, options)


class Tuning:
    """A tuning: its evaluations, known before it begins; phases, each of which depends on those before; and results."""

    searched: list[Candidate]
    """All that were tried, in order; first the start."""
    finalists: list[Candidate]
    """On fresh seeds, first the chosen one; of a front those that are on it."""
    plans: list[PlanCheck]
    """Of whole plans: of the start first, then of the best finalists."""
    verdict: HeldOut
    failures: list[tuple[str, Mapping[str, Any]]]
    """The trials on held-out seeds that failed, with the gains that they were tried with: before, after or shipped."""
    gains: Gains
    """The best; those of the start where nothing better was found."""
    sensitivity: dict[str, tuple[float, float]]
    """What moving each gain of these alone by _SENSITIVITY_STEP does to the goal's product, on the search's seeds:
    factors, for smaller and for larger values."""
    config: Mapping[str, Any]
    wall_s: float

    def __init__(
        self,
        group: GainGroup,
        setup: Setup,
        goal: TuningGoal,
        evaluations: int,
        trials: int,
        seed: int,
    ) -> None:
        self.group = group
        self.setup = setup
        self.goal = goal
        self.trials = trials
        self.seed = seed
        self.tunable = tunable_gains(group, setup.gains)
        self.start: _Values = {gain.name: gain.start for gain in self.tunable}
        size = population(len(self.tunable))
        searches = len(goal.searches)
        share = math.ceil(COORDINATE_SHARE * evaluations)
        self.n_coordinate = min(share, COORDINATE_ROUNDS * 2 * len(self.tunable))
        """Candidates of the coordinate search."""
        self.generations = max(1, round((evaluations - self.n_coordinate) / searches / size))
        """Of each search by CMA-ES."""
        self.n_search = 1 + searches * self.generations * size + self.n_coordinate
        """Candidates of the search, the start included."""
        self.n_needed = _NEEDED_PER_GAIN * len(self.tunable) * searches
        """Candidates that a search in so many dimensions needs, about."""
        self.run_some: Callable[[Mapping[int, Job | PlanJob]], list[TrialRecord]]
        """Returns the records of items, by their numbers, each with its job."""
        self._numbers = count()
        """Those of the items to come: they are all done in their order."""

    def items(self) -> list[Trial]:
        """Return an item, without a job yet, for each evaluation."""
        names = [f"search {n}" for n in range(self.n_search)]
        for n in range(FINALISTS):
            for b in range(FINAL_BLOCKS):
                names.append(f"finalist {n} on block {b}")
        for variant in _IN_PLANS:
            for plan in PLANS:
                names.append(f"{variant} in plan {plan}")
        for variant in _COMPARED:
            for b in range(HELD_OUT_BLOCKS):
                names.append(f"{variant} held out on block {b}")
        names.append("result")
        for gain in self.tunable:
            names += [f"{gain.name} down", f"{gain.name} up"]
        return [Trial(name, name, self.seed, None) for name in names]

    def outlook(self) -> list[str]:
        """Return what will be tried, and a warning where that is far too little."""
        n_gains = len(self.tunable)
        n_situations = len(situations(self.group))
        n_after = len(self.items()) - self.n_search
        lines = [
            f"{n_gains} gains; {self.n_search} candidates ({self.n_coordinate} of them by changes of single gains), "
            f"each in {self.trials * n_situations} actions; then {n_after} evaluations of the best: finalists on fresh "
            f"seeds, whole plans, held-out seeds, sensitivities. {len(self.items())} evaluations in all."
        ]
        if 2 * self.n_search < self.n_needed:
            lines.append(
                f"Warning: a search in {n_gains} dimensions needs about {self.n_needed} candidates; "
                f"--evaluations {self.n_needed} is more likely to find something."
            )
        return lines

    def run(self) -> None:
        """Go through all phases."""
        self.searched, means = self._search()
        self.searched += self._coordinates()
        self.finalists = self._finals(means)
        self.plans = self._in_plans()
        best = self._passing()
        self.verdict = self._judge(best)
        if self.verdict.improved:
            self.gains = self._with(best)
            self.sensitivity = self._sensitivity(best)
        else:
            self.gains = self.setup.gains
            self.sensitivity = self._sensitivity(self.start)

    def _sensitivity(self, values: _Values) -> dict[str, tuple[float, float]]:
        """Return the factors of the product where each gain alone is smaller, and where it is larger."""
        moved = [values]
        for gain in self.tunable:
            at = gain.position(values[gain.name])
            for step in (-_SENSITIVITY_STEP, _SENSITIVITY_STEP):
                moved.append({**values, gain.name: gain.value(at + step)})
        costs = np.array([*map(_cost(self.goal.weights), self._candidates(moved))])
        factors = np.exp(costs[1:] - costs[0]).reshape(-1, 2).tolist()
        sensitivity = {}
        for gain, (down, up) in zip(self.tunable, factors, strict=True):
            sensitivity[gain.name] = (down, up)
        return sensitivity

    def _search(self) -> tuple[list[Candidate], list[_Values]]:
        """Return all candidates, first the start, and the mean of each search's last distribution, which noise deceives
        less than the best candidate."""
        candidates = self._candidates([self.start])
        means: list[_Values] = []
        for number, weights in enumerate(self.goal.searches):
            best, _ = min(candidates, key=_cost(weights))
            begin = [gain.position(best[gain.name]) for gain in self.tunable]
            rng = np.random.default_rng([self.seed, number])
            bounds = [gain.bounds for gain in self.tunable]
            strategy = cma_es(bounds, begin, _NEXT_STEP if number else _FIRST_STEP, rng)
            for _ in range(self.generations):
                positions = strategy.ask()
                tried = self._candidates([values_at(self.tunable, x) for x in positions])
                costs = []
                for position, (_, score) in zip(positions, tried, strict=True):
                    prior = _PRIOR_WEIGHT * float(position @ position)
                    costs.append(score.log_cost(weights) + prior)
                strategy.tell(positions, costs)
                candidates += tried
            means.append(values_at(self.tunable, strategy.result.xfavorite))
        return candidates, means

    def _coordinates(self) -> list[Candidate]:
        """Change single gains of the best, then all at once that did better, and go on from what is best."""
        weights = self.goal.weights
        rng = np.random.default_rng([self.seed, len(self.goal.searches)])
        best = min(self.searched, key=_cost(weights))
        moves = list(product(range(len(self.tunable)), (-1.0, 1.0)))
        order = rng.permutation(len(moves)).tolist()
        step = _COORDINATE_STEP
        place = 0
        together: _Values | None = None
        tried: list[Candidate] = []
        while len(tried) < self.n_coordinate:
            batch: list[_Values] = []
            moved: list[int] = []
            if together is not None:
                batch.append(together)
            n_more = min(population(len(self.tunable)), self.n_coordinate - len(tried)) - len(batch)
            while len(moved) < n_more:
                if place == len(order):
                    place = 0
                    step = max(step / 2, _LEAST_STEP)
                column, sign = moves[order[place]]
                place += 1
                batch.append(self._moved(best[0], column, sign * step))
                moved.append(column)
            candidates = self._candidates(batch)
            tried += candidates
            # Those that do better alone are tried together next.
            changed: dict[str, float] = {}
            of_single_gains = candidates[len(batch) - len(moved) :]
            for column, (values, score) in zip(moved, of_single_gains, strict=True):
                if score.log_cost(weights) < best[1].log_cost(weights):
                    name = self.tunable[column].name
                    changed[name] = values[name]
            together = None
            if len(changed) > 1:
                together = {**best[0], **changed}
            best = min([best, *candidates], key=_cost(weights))
        return tried

    def _moved(self, values: _Values, column: int, step: float) -> _Values:
        """Return values with one gain at another position; away from a bound that it lies at."""
        gain = self.tunable[column]
        at = gain.position(values[gain.name])
        low, high = gain.bounds
        if not low <= at + step <= high:
            step = -step
        return {**values, gain.name: gain.value(at + step)}

    def _in_plans(self) -> list[PlanCheck]:
        """Carry out whole plans with the start and with the best finalists."""
        candidates = [values for values, _ in self.finalists[:_PLAN_FINALISTS]]
        # The number of trials is fixed before the search: where there are fewer finalists, the last one is tried again.
        candidates += [candidates[-1]] * (_PLAN_FINALISTS - len(candidates))
        jobs: dict[int, PlanJob] = {}
        values_of_jobs = []
        variants = [self.start, *candidates]
        for values in variants:
            setup = replace(self.setup, gains=self._with(values))
            for plan in PLANS:
                jobs[next(self._numbers)] = PlanJob(self.group, setup, self.seed, plan)
                values_of_jobs.append(values)
        records = self._run_checked(jobs, values_of_jobs)
        checks = []
        for number, values in enumerate(variants):
            failed = []
            of_values = records[number * len(PLANS) : (number + 1) * len(PLANS)]
            for plan, record in zip(PLANS, of_values, strict=True):
                if not record["agrees"]:
                    failed.append(plan)
            checks.append(PlanCheck(values, tuple(failed)))
        return checks

    def _passing(self) -> _Values:
        """Return the best finalist that fails in no plan in which the start does not; the start if there is none."""
        start, *checks = self.plans
        for check in checks:
            if set(check.failed) <= set(start.failed):
                return check.values
        return self.start

    @property
    def refused(self) -> list[PlanCheck]:
        """Finalists that did better in single actions than what was chosen, and failed in whole plans."""
        start, *checks = self.plans
        refused = []
        for check in checks:
            if set(check.failed) <= set(start.failed):
                break
            refused.append(check)
        return refused

    def _finals(self, means: Sequence[_Values]) -> list[Candidate]:
        """Try the best again on fresh seeds; return the chosen one, then the others, of a front those still on it."""
        goal = self.goal
        blocks = range(self.trials, self.trials + FINAL_BLOCKS)
        retried: list[Candidate] = []
        for values in self._finalists(means):
            records = self._try_apart(values, blocks)
            retried.append((values, TuningScore.of(_joined(records))))
        if not goal.front:
            return sorted(retried, key=_cost(goal.weights))
        costs = _costs(retried, goal)
        front = undominated(costs)
        pick = front[goal.pick(costs[front])]
        not_picked = [retried[number] for number in front if number != pick]
        return [retried[pick], *not_picked]

    def _finalists(self, means: Sequence[_Values]) -> list[_Values]:
        goal = self.goal
        ranked = sorted(self.searched, key=_cost(goal.weights))
        if not goal.front:
            best = [values for values, _ in ranked[: FINALISTS - 1]]
            return [*means, *best]
        front = [self.searched[number] for number in undominated(_costs(self.searched, goal))]
        wide = [front[number] for number in spread_out(_costs(front, goal), FINALISTS)]
        fill = [candidate for candidate in ranked if candidate not in wide]
        return [values for values, _ in [*wide, *fill][:FINALISTS]]

    def _judge(self, best: _Values) -> HeldOut:
        """Compare the best with the start, and with what is shipped, on seeds that nothing was chosen by."""
        goal = self.goal
        nominal = load_gains()
        first = self.trials + FINAL_BLOCKS
        usual = {gain.name: gain.of(nominal) for gain in self.tunable}
        blocks = range(first, first + HELD_OUT_BLOCKS)
        tried: dict[str, list[TrialRecord]] = {}
        scores: dict[str, TuningScore] = {}
        self.failures = []
        for name, values in (("before", self.start), ("after", best), ("shipped", usual)):
            tried[name] = self._try_apart(values, blocks)
            trials = _joined(tried[name])
            scores[name] = TuningScore.of(trials)
            self.failures += [(name, trial) for trial in trials if not trial["agrees"]]
        before = scores["before"]
        after = scores["after"]
        against_start = _ratio(tried["after"], tried["before"], goal.weights)
        against_shipped = _ratio(tried["after"], tried["shipped"], goal.weights)
        control = _ratio(tried["before"][1::2], tried["before"][::2], goal.weights)
        dominated = bool(
            (before.log_costs(goal.objectives) <= after.log_costs(goal.objectives)).all()
        )
        if goal.front:
            better = not dominated
        else:
            better = against_start.factor < 1
        improved = better and after.failed <= before.failed
        return HeldOut(
            before, after, scores["shipped"], against_start, against_shipped, control, improved
        )

    def _with(self, values: _Values) -> Gains:
        return with_values(self.setup.gains, self.tunable, values)

    def _candidates(self, values: Sequence[_Values]) -> list[Candidate]:
        records = self._try([(gains, range(self.trials)) for gains in values])
        candidates = []
        for gains, record in zip(values, records, strict=True):
            candidates.append((gains, TuningScore.of(record["attempts"])))
        return candidates

    def _try_apart(self, values: _Values, blocks: Sequence[int]) -> list[TrialRecord]:
        return self._try([(values, (block,)) for block in blocks])

    def _try(self, requests: Sequence[tuple[_Values, Sequence[int]]]) -> list[TrialRecord]:
        jobs: dict[int, Job] = {}
        for values, blocks in requests:
            setup = replace(self.setup, gains=self._with(values))
            jobs[next(self._numbers)] = self.group, setup, self.seed, tuple(blocks)
        return self._run_checked(jobs, [values for values, _ in requests])

    def _run_checked(
        self, jobs: Mapping[int, Job | PlanJob], tried: Sequence[_Values]
    ) -> list[TrialRecord]:
        """Return the records of jobs. Raises InputError for those of an earlier run that tried other values."""
        records = self.run_some(jobs)
        for values, record in zip(tried, records, strict=True):
            if record["extra"]["gains"] != values:
                raise InputError(
                    f"{reprlib.repr(record['key'])} tried other gains than it would now: the search takes another way "
                    "on this machine; choose another --out"
                )
        return records


def _cost(weights: Mapping[TuningObjective, float]) -> Callable[[Candidate], float]:
    return lambda candidate: candidate[1].log_cost(weights)


def _costs(candidates: Sequence[Candidate], goal: TuningGoal) -> NDArray[np.float64]:
    return np.array([score.log_costs(goal.objectives) for _, score in candidates])


def tune(
    group: GainGroup,
    setup: Setup,
    out: Path,
    *,
    goal: TuningGoal,
    evaluations: int,
    trials: int,
    seed: int,
    options: RunOptions,
    tell: Callable[[str], None] = lambda text: None,
) -> Tuning:
    """Tune gains, and return the tuning with its results.

    Every evaluation is in ``out/trials.jsonl`` as soon as it is known. Equal arguments give equal results at any number
    of workers, and whether the tuning was cut off and resumed or not.

    Args:
        group: which gains.
        setup: configuration of the physics, with the gains to start from.
        out: the folder; raises InputError for one that holds something else.
        goal: what is wanted.
        evaluations: candidates to try, about: whole generations of each search, at least one.
        trials: of each situation, for every candidate.
        seed: decides the candidates, and the physics and noise of all trials.
        options: how.
        tell: is called with what will be tried, before the first candidate is.
    """
    need_cma()
    started = time.perf_counter()
    start = gains_of_car(setup.gains, setup.machines.cars[0], setup.machines)
    setup = replace(setup, gains=start)
    tuning = Tuning(group, setup, goal, evaluations, trials, seed)
    items = tuning.items()
    for line in tuning.outlook():
        tell(line)
    config: dict[str, Any] = {"subject": group, "goal": goal, "evaluations": tuning.n_search}
    config |= {"trials": trials, **setup.provenance}
    experiment = Experiment(TUNE_COMMAND, seed, config, items, try_gains, _FORM)
    with (
        open_session(experiment, out, options) as session,
        options.progress(len(items)) as on_record,
    ):
        # Of an earlier tuning in this folder.
        (out / GAINS_FILE).unlink(missing_ok=True)
        tuning.run_some = partial(session.run_some, on_record=on_record)
        tuning.run()
    tuning.config, tuning.wall_s = config, time.perf_counter() - started
    return tuning
