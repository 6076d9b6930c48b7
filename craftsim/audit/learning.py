"""Learning of rules: from examples in physics to the fewest preconditions under which allowed actions go as predicted.

A round tries things in physics: random legal play under the rules learned so far, which searches for counterexamples;
failures again without one thing after the other, which tells what matters (near misses, Winston 1975); and what new
patterns forbid, in situations unlike those that asked for them. Then patterns are fitted anew. Rounds end when play has
met no failure for so long that the share of actions as predicted is certain, or when the budget is spent.
"""

from __future__ import annotations

import gzip
import hashlib
import os
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from craftsim.audit.examples import (
    MOST_PLAYED,
    ROTATE_LEFT,
    ActionsJob,
    Example,
    PlayJob,
    WorldAction,
    episodes_of,
    examples_of,
    mirrored,
    near_misses,
    surroundings_of,
    trace_lines,
    try_actions,
)
from craftsim.audit.induction import ExampleSet, Pattern, fit, similar
from craftsim.audit.plan import audit_plan, quick_rows
from craftsim.checking.recipe import Recipe, Step
from craftsim.checking.setup import Setup, set_up
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.grid import Grid
from craftsim.discrete.kernel import patterns as bits
from craftsim.discrete.kinds import Action, Correction, RuleSetName
from craftsim.discrete.learned import (
    CAR_PROPERTIES,
    LearnedRule,
    LearnedRules,
    PatternCell,
    RulesOrigin,
    Verb,
    cell_words,
)
from craftsim.discrete.rules import RULE_SETS, Rules
from craftsim.errors import InputError
from craftsim.experiments.anytime import CONFIDENCE, play_bounds, play_lower_bound
from craftsim.experiments.bundle import write_bundle
from craftsim.experiments.experiment import Experiment, RunOptions, Trial
from craftsim.experiments.session import open_session
from craftsim.reports.json_file import versions
from craftsim.storage.folders import directory_within
from craftsim.storage.writing import write_whole
from craftsim.validation.play import choose
from craftsim.validation.worlds import RandomWorlds

_LEARNED_VERBS: Final = tuple(
    number for number, verb in enumerate(bits.VERBS) if verb != "ROTATE_RIGHT"
)
_SITUATIONS_PER_JOB: Final = 8
_EPISODES: Final = 60
"""Episodes of play in a round; each has about 70 actions, at most MOST_PLAYED."""
_NEAR_MISSES: Final = 30
"""Failures of a round that are tried again without one thing after the other."""
_DOUBTS: Final = 4
"""Situations in which a new pattern is tried beyond those that asked for it."""
_CONJECTURES: Final = 2
"""Situations in which something like a pattern is tried."""
_MOST_CONJECTURED: Final = 160
_REFUTED: Final = 2
"""Successes after which it is not tried any more."""
_POOL_WORLDS: Final = 32
"""Worlds of play on the grid alone, of a round, from which these are taken."""
TRACES: Final = "traces.jsonl.gz"
"""All examples for other learners, but those of play to compare with."""
_EMPTY_WORLD: Final = Grid.empty((4, 4, 1), n_cars=1)
_TIMEOUT_S: Final = 300.0
_MOST_ROUNDS: Final = 100


@dataclass(frozen=True)
class Budget:
    """When learning ends."""

    share: float = 0.999
    """The share of actions as predicted that is to be certain, at every number of actions."""
    most_actions: int = 40_000
    """Actions in physics after which no further round begins."""
    held_out: int = 5_000
    """Actions of play in worlds that were never seen, after the last round."""


@dataclass
class Round:
    """What a round brought."""

    number: int
    actions: int = 0
    """Actions of play."""
    failures: int = 0
    """Those that did not go as predicted: counterexamples to the rules of the round before."""
    trials: int = 0
    """Single situations that were tried."""
    patterns: int = 0
    uncovered: int = 0
    """Failures that no pattern covers."""
    certain: float = 0.0
    """Share of actions as predicted that is certain for the rules that the round began with: with 95 % confidence for
    all rule sets of a run together."""
    cpu_s: float = 0.0
    """Of all processes, from the beginning on."""


@dataclass
class RuleLearner:
    """Learns the rules of a machine; see :meth:`learn`."""

    setup: Setup
    base: RuleSetName
    seed: int
    out: Path | None
    options: RunOptions
    budget: Budget = field(default_factory=Budget)
    on_round: Callable[[Round], None] = lambda _: None
    with_rows: bool = True
    """Whether the rows of a quick audit are tried first: rare situations that play hardly meets."""
    rounds: list[Round] = field(default_factory=list)
    examples: list[Example] = field(default_factory=list)
    n_actions: int = 0
    patterns: list[Pattern] = field(default_factory=list)
    _tried: set[WorldAction] = field(default_factory=set)
    _reduced: set[WorldAction] = field(default_factory=set)

    def learn(self, name: str) -> LearnedRules:
        """Return the rules, with the trials that ask for each.

        Raises InputError for machines of which there is no world in physics, and where no trial of a kind finishes.
        """
        set_up(_EMPTY_WORLD, self.setup)
        learned = LearnedRules(name, self.base)
        played: list[Example] = []
        n_rule_sets = 1
        if self.with_rows:
            self._try(audit_situations(self.base), "audit-rows")
        for number in range(_MOST_ROUNDS):
            this_round = Round(number)
            new = self._play(learned, number, f"round-{number:02}-play")
            this_round.actions = len(new)
            this_round.failures = sum(not example.worked for example in new)
            if not new and not learned.rules:
                raise InputError(
                    f"no action could be tried in {_EPISODES} worlds of play: with these machines none of them stands"
                )
            if this_round.failures:
                self.examples += new
                self._ask(learned, number, this_round)
                self.patterns, this_round.uncovered = self._fitted(number)
                learned = self._rules(name, self.patterns)
                played = []
                n_rule_sets += 1
            else:
                self.examples += new
                played += new
                # The errors of all rule sets of a run add up to at most 5 %.
                error = (1 - CONFIDENCE) / (n_rule_sets * (n_rule_sets + 1))
                this_round.certain = play_lower_bound(*episodes_of(played), 1 - error)
            this_round.patterns = len(learned.rules)
            this_round.cpu_s = sum(os.times()[:4])
            self.rounds.append(this_round)
            self.on_round(this_round)
            is_certain = this_round.certain >= self.budget.share
            if is_certain or not new or self.n_actions > self.budget.most_actions:
                break
        return learned

    def _play(self, learned: LearnedRules, number: int, stage: str) -> list[Example]:
        """Return the examples of random legal play under some rules."""
        setup = replace(self.setup, rules=learned)
        jobs = []
        for episode in range(_EPISODES):
            jobs.append(PlayJob((self.seed, number, episode), setup))
        return self._run(stage, jobs)

    def held_out(self, rules: LearnedRules | RuleSetName, stage: str) -> list[Example]:
        """Return the examples of play under some rules in worlds that no round has seen; none if they allow none."""
        setup = replace(self.setup, rules=rules)
        examples: list[Example] = []
        number = 0
        while len(examples) < self.budget.held_out:
            jobs = []
            for episode in range(_EPISODES):
                jobs.append(PlayJob((self.seed, 1_000_000 + number, episode), setup))
            # A run that goes on with more rounds has other rules to try here than before.
            new = self._run(f"{stage}-{_rules_key(rules)}-{number:02}", jobs)
            if not new:
                break
            examples += new
            number += 1
        return examples

    def _run(self, stage: str, jobs: Sequence[PlayJob | ActionsJob]) -> list[Example]:
        """Run jobs as an experiment of its own, which is resumed by itself, and return their examples.

        Raises InputError if no trial finishes.
        """
        trials = [Trial(f"{stage}#{n}", stage, self.seed, job) for n, job in enumerate(jobs)]
        config = {
            "stage": stage,
            "base": self.base,
            "jobs": jobs_digest(jobs),
            **self.setup.provenance,
        }
        experiment = Experiment(
            "audit learn", self.seed, config, trials, try_actions, timeout_s=_TIMEOUT_S
        )
        out = None
        if self.out is not None:
            out = self.out / stage
        with open_session(experiment, out, self.options) as session:
            records = session.run()
            examples = list(examples_of(records))
            errors = [record["error"] for record in records if record["error"] is not None]
        if len(errors) == len(trials):
            raise InputError(f"no trial of {stage} has finished; the first: {errors[0]}")
        self.n_actions += len(examples)
        return examples

    def _try(
        self, situations: Iterable[WorldAction], stage: str, is_near_miss: bool = False
    ) -> int:
        """Try situations that were not tried before; return how many there were."""
        new = [item for item in dict.fromkeys(situations) if item not in self._tried]
        self._tried.update(new)
        setup = replace(self.setup, rules=self.base)
        jobs = []
        for start in range(0, len(new), _SITUATIONS_PER_JOB):
            seed = (self.seed, zlib.crc32(stage.encode()), start)
            jobs.append(ActionsJob(seed, tuple(new[start : start + _SITUATIONS_PER_JOB]), setup))
        if not jobs:
            return 0
        examples = self._run(stage, jobs)
        for example in examples:
            self.examples.append(example._replace(is_near_miss=is_near_miss))
        return len(examples)

    def _ask(self, learned: LearnedRules, number: int, this_round: Round) -> None:
        """Try what tells most: failures without one thing each, and new patterns where nothing was tried yet."""
        rng = np.random.default_rng((self.seed, number, 1))
        failures = []
        for example in self.examples:
            if example.situation is not None and example.situation not in self._reduced:
                failures.append(example.situation)
        # The counterexamples of this round come last.
        chosen = failures[-_NEAR_MISSES:]
        self._reduced.update(failures)
        misses = []
        for situation in chosen:
            misses += near_misses(situation)
        this_round.trials += self._try(misses, f"round-{number:02}-near", is_near_miss=True)
        patterns, _ = self._fitted(number)
        doubts = list(self._doubts(patterns, rng))
        this_round.trials += self._try(doubts, f"round-{number:02}-doubts")

    def _doubts(
        self, patterns: Sequence[Pattern], rng: np.random.Generator
    ) -> Iterator[WorldAction]:
        """Yield situations that tell more of patterns: some that they forbid, and some that are like these.

        What is like a pattern has another thing there, or the same one cell further; successes rule it out.
        """
        pool = list(self._pool(rng))
        conjectured: list[WorldAction] = []
        for verb in _LEARNED_VERBS:
            of_verb = [(situation, around) for situation, number, around in pool if number == verb]
            of_patterns = [pattern for pattern in patterns if pattern.verb == verb]
            if not of_verb or not of_patterns:
                continue
            around_all = np.array([around for _, around in of_verb])
            matches = forbidden(of_patterns, verb, around_all)
            for matched in matches:
                for place in rng.permutation(np.flatnonzero(matched))[:_DOUBTS].tolist():
                    yield of_verb[place][0]
            worked = [
                example.surroundings
                for example in self.examples
                if example.verb == verb and example.worked
            ]
            conjectures = list(similar(of_patterns))
            refuted = forbidden(conjectures, verb, np.array(worked)).sum(axis=1) >= _REFUTED
            open_ones = [c for c, wrong in zip(conjectures, refuted, strict=True) if not wrong]
            likely = forbidden(open_ones, verb, around_all) & ~matches.any(axis=0)
            for matched in likely:
                for place in rng.permutation(np.flatnonzero(matched))[:_CONJECTURES].tolist():
                    conjectured.append(of_verb[place][0])
        order = rng.permutation(len(conjectured))[:_MOST_CONJECTURED]
        for place in order.tolist():
            yield conjectured[place]

    def _pool(self, rng: np.random.Generator) -> Iterator[tuple[WorldAction, int, Any]]:
        """Yield situations of random play by the base on the grid alone, with verb and surroundings."""
        rules = Rules(self.base)
        for _ in range(_POOL_WORLDS):
            grid = RandomWorlds().grid(rng)
            done: Counter[str] = Counter()
            for _ in range(8):
                for car in rng.permutation(grid.n_cars).tolist():
                    yield from self._options(grid, rules, car)
                    chosen = choose(grid, rules, rng, car, done)
                    if chosen is not None:
                        grid = chosen[1]
                        grid.derive_marks()

    def _options(
        self, grid: Grid, rules: Rules, car: int
    ) -> Iterator[tuple[WorldAction, int, Any]]:
        text = blueprint_text(grid)
        for number in np.flatnonzero(rules.mask(grid)[car]).tolist():
            if number != Action.STOP:
                yield WorldAction(text, car, Action(number)), *surroundings_of(grid, car, number)

    def _fitted(self, number: int) -> tuple[list[Pattern], int]:
        """Return the patterns that the examples ask for, and how many failures none covers."""
        rng = np.random.default_rng((self.seed, number, 2))
        patterns: list[Pattern] = []
        n_uncovered = 0
        for verb in _LEARNED_VERBS:
            examples = ExampleSet.of(verb, self.examples)
            if examples.failures.any():
                fitted, _ = fit(examples, rng)
                patterns += fitted
                failed = [e.surroundings for e in self.examples if e.verb == verb and not e.worked]
                n_uncovered += int((~forbidden(fitted, verb, np.array(failed)).any(axis=0)).sum())
        return patterns, n_uncovered

    def cost(self, examples: Sequence[Example]) -> tuple[int, int]:
        """Return how many examples worked, and how many of these the patterns forbid."""
        n_worked = 0
        n_forbidden = 0
        for verb in _LEARNED_VERBS:
            around = [e.surroundings for e in examples if e.verb == verb and e.worked]
            of_patterns = [pattern for pattern in self.patterns if pattern.verb == verb]
            n_worked += len(around)
            if around and of_patterns:
                n_forbidden += int(forbidden(of_patterns, verb, np.array(around)).any(0).sum())
        return n_worked, n_forbidden

    def failures_of(self, rules: LearnedRules) -> dict[str, list[Example]]:
        """Return the failures that ask for each rule, by its name."""
        failures: dict[str, list[Example]] = {rule.name: [] for rule in rules.rules}
        for verb in _LEARNED_VERBS:
            failed = [e for e in self.examples if e.verb == verb and e.situation is not None]
            of_patterns = [pattern for pattern in self.patterns if pattern.verb == verb]
            if failed and of_patterns:
                around = np.array([example.surroundings for example in failed])
                for number, matched in enumerate(forbidden(of_patterns, verb, around)):
                    listed = [failed[place] for place in np.flatnonzero(matched).tolist()]
                    failures[_name(verb, number)] = listed
        return failures

    def bundles(self, failures: Mapping[str, Sequence[Example]]) -> Iterator[str]:
        """Write a replay bundle of a failure for each rule, and yield their folders, relative to the run's."""
        if self.out is None:
            return
        setup = replace(self.setup, rules=self.base)
        for name, examples in failures.items():
            if not examples or examples[0].situation is None:
                continue
            world, car, action = examples[0].situation
            recipe = Recipe(world, (Step.single(0, car, action),), setup)
            folder = f"bundles/{name}"
            write_bundle(directory_within(self.out, folder), name, recipe)
            yield folder

    def _rules(self, name: str, patterns: Sequence[Pattern]) -> LearnedRules:
        """Return patterns as rules, with the trials that ask for them."""
        rules = []
        for verb in _LEARNED_VERBS:
            of_patterns = [pattern for pattern in patterns if pattern.verb == verb]
            tried = [example for example in self.examples if example.verb == verb]
            around = np.array([example.surroundings for example in tried])
            failed = np.array([not example.worked for example in tried], np.bool_)
            matches = forbidden(of_patterns, verb, around)
            word = bits.VERBS[verb]
            for number, pattern in enumerate(of_patterns):
                car = pattern.car
                if not pattern.conditions:
                    # An action that never works is forbidden with every load.
                    car = {"load": CAR_PROPERTIES["load"]}
                rules.append(
                    LearnedRule(
                        name=_name(verb, number),
                        action=cast(Verb, word),
                        cells=_pattern_cells(pattern),
                        car=car,
                        trials=int(matches[number].sum()),
                        failures=int((matches[number] & failed).sum()),
                    )
                )
        origin = RulesOrigin(
            machines=self.setup.machines.digest,
            seed=self.seed,
            versions=versions(),
            actions=self.n_actions,
        )
        return LearnedRules(name, self.base, (), origin, tuple(rules))


def _rules_key(rules: LearnedRules | RuleSetName) -> str:
    """Return a word for a rule set, another one for each that forbids something else."""
    if isinstance(rules, str):
        return rules
    return rules.digest[:12]


def jobs_digest(jobs: Iterable[PlayJob | ActionsJob]) -> str:
    """Return the SHA-256, in hexadecimal, of what jobs try beside their setup: rules, and seeds or situations."""
    digest = hashlib.sha256()
    for job in jobs:
        situations: tuple[WorldAction, ...] = ()
        if isinstance(job, ActionsJob):
            situations = job.situations
        digest.update(repr((_rules_key(job.setup.rules), job.seed, situations)).encode())
    return digest.hexdigest()


def audit_situations(base: RuleSetName) -> list[WorldAction]:
    """Return the situations of a quick audit in which a rule set allows a single action."""
    situations = []
    for row in quick_rows(audit_plan(base), base):
        situation = row.members[0]
        is_single = situation.order is None and len(situation.acts) == 1
        if row.legal and is_single and situation.acts[0] != Action.STOP:
            placed = situation.placed(np.random.default_rng(situation.digest))
            situations.append(WorldAction(blueprint_text(placed.grid), 0, placed.acts[0]))
    return situations


def _name(verb: int, number: int) -> str:
    """Return the name of a rule: its verb, and its number among those of the verb."""
    return f"{bits.VERBS[verb].lower().replace('_', '-')}-{number + 1}"


def forbidden(
    patterns: Sequence[Pattern], verb: int, surroundings: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return (patterns, n): whether each pattern of a verb, or its mirror image, matches some surroundings."""
    result = np.zeros((len(patterns), len(surroundings)), np.bool_)
    if not len(surroundings):
        return result
    sides = [surroundings]
    if verb != ROTATE_LEFT:
        sides.append(mirrored(surroundings))
    nothing = np.zeros(len(surroundings), np.int64)
    for side in sides:
        examples = ExampleSet(verb, side, nothing, nothing, nothing.astype(float))
        for number, pattern in enumerate(patterns):
            if pattern.verb == verb:
                result[number] |= examples.matches(pattern.conditions)
    return result


def _pattern_cells(pattern: Pattern) -> tuple[PatternCell, ...]:
    """Return the cells of a pattern as files have them."""
    cells = []
    levels = bits.HIGHEST - bits.LOWEST + 1
    for cell, allowed in pattern.cells:
        forward, remaining = divmod(cell, bits.SIDE * levels)
        aside, up = divmod(remaining, levels)
        at = (forward - bits.REACH_CELLS, aside - bits.REACH_CELLS, up + bits.LOWEST)
        cells.append(PatternCell(at, cell_words(allowed)))
    return tuple(cells)


@dataclass(frozen=True)
class LearnedResult:
    """What learning has brought."""

    rules: LearnedRules
    rounds: tuple[Round, ...]
    held_out: int
    """Actions of play by the learned rules in worlds that were never seen."""
    episodes: int
    """Episodes of these, each in a world of its own."""
    bounds: tuple[float, float]
    """Interval of the share of actions as predicted, with 95 % confidence; actions of one episode may depend on each
    other."""
    reasons: tuple[str, ...]
    """Why some of these did not go as predicted, one each."""
    allowed: int
    """Actions that the rules to compare with allow, of play by these, and that went as predicted; 0 without any."""
    forbidden: int
    """Those that the learned rules forbid."""
    corrections: Mapping[str, tuple[str, ...]]
    """Names of the learned rules like each correction."""
    bundles: tuple[str, ...]
    cpu_s: float
    config: dict[str, Any]
    seed: int

    @property
    def figures(self) -> dict[str, Any]:
        """What ``report.json`` has."""
        return {
            "rules": self.rules,
            "rounds": self.rounds,
            "held_out": {
                "actions": self.held_out,
                "episodes": self.episodes,
                "failures": len(self.reasons),
                "bounds": self.bounds,
            },
            "compared": {"allowed": self.allowed, "forbidden": self.forbidden},
            "corrections": self.corrections,
            "cpu_s": self.cpu_s,
        }


def run_learning(learner: RuleLearner, name: str, compare: RuleSetName | None) -> LearnedResult:
    """Learn rules, try them in worlds that were never seen, and write replay bundles of what asks for each.

    With ``compare`` play by another rule set tells how much the learned rules forbid that it allows, and that works.
    """
    rules = learner.learn(name)
    held_out = learner.held_out(rules, "held-out")
    allowed = 0
    forbidden_count = 0
    if compare is not None:
        compared = learner.held_out(compare, "compared")
        allowed, forbidden_count = learner.cost(compared)
    failures = learner.failures_of(rules)
    likenesses = {}
    for rule in rules.rules:
        likenesses[rule.name] = _like(failures[rule.name], learner.base)
    if learner.out is not None:
        lines = "".join(trace_lines([*learner.examples, *held_out]))
        write_whole(learner.out / TRACES, gzip.compress(lines.encode(), mtime=0))
    n_actions, failed = episodes_of(held_out)
    cpu_s = sum(os.times()[:4])
    origin = replace(rules.origin, actions=learner.n_actions, cpu_s=round(cpu_s, 1))
    liked = [replace(rule, like=likenesses[rule.name]) for rule in rules.rules]
    rules = replace(rules, rules=tuple(liked), origin=origin)
    by_correction: dict[str, tuple[str, ...]] = {}
    for correction in Correction.__members__:
        names = [rule.name for rule in rules.rules if rule.like == correction]
        by_correction[correction] = tuple(names)
    return LearnedResult(
        rules,
        tuple(learner.rounds),
        len(held_out),
        len(n_actions),
        play_bounds(n_actions, failed, MOST_PLAYED),
        tuple(example.reason for example in held_out if not example.worked),
        allowed,
        forbidden_count,
        by_correction,
        tuple(learner.bundles(failures)),
        cpu_s,
        {"base": learner.base, "budget": learner.budget, **learner.setup.provenance},
        learner.seed,
    )


def _like(failures: Iterable[Example], base: RuleSetName) -> str:
    """Return the correction that alone forbids, or changes, most of some failures; empty for none."""
    counts: Counter[str] = Counter()
    for example in list(failures)[:30]:
        if example.situation is not None:
            counts.update(corrections_of_situation(example.situation, base))
    if not counts:
        return ""
    return counts.most_common(1)[0][0]


def corrections_of_situation(situation: WorldAction, base: RuleSetName) -> list[str]:
    """Return the corrections that, each alone, forbid an action or change its effect."""
    grid = situation.grid
    plain = Rules(base)
    expected = plain.apply(grid, situation.car, situation.action)
    names = []
    for name, flag in Correction.__members__.items():
        if flag in RULE_SETS[base]:
            continue
        rules = Rules(base, RULE_SETS[base] | flag)
        legal = rules.legal(grid, situation.car, situation.action)
        if not legal or not rules.apply(grid, situation.car, situation.action).same_visible(
            expected
        ):
            names.append(name)
    return names
