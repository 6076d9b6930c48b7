"""Learning of rules: from examples in physics to the fewest preconditions under which allowed actions go as predicted.

A round tries things in physics: random legal play under the rules learned so far, which searches for counterexamples;
unfamiliar situations; failures once more, since what does not fail again is chance; these without one thing after the
other, which tells what matters (near misses, Winston 1975); and what new patterns forbid, in situations unlike those
that asked for them. Then patterns are fitted anew.
Rounds end when play has met no failure for so long that the share of actions as predicted is certain, or when the
budget is spent.
"""

from __future__ import annotations

import hashlib
import os
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, cast

import numpy as np

from craftsim.audit.examples import (
    ActionsJob,
    Example,
    PlayJob,
    WorldAction,
    episodes_of,
    examples_of,
    is_single_action,
    near_misses,
    placed_action,
    try_actions,
    unsolved_in,
)
from craftsim.audit.induction import ExampleSet, Pattern, cautious, fit, forbidden
from craftsim.audit.plan import audit_plan, quick_rows
from craftsim.audit.queries import doubtful, options_of_play, unfamiliar
from craftsim.checking.recipe import Recipe, Step
from craftsim.checking.setup import Setup, set_up
from craftsim.discrete.grid import Grid
from craftsim.discrete.kernel import patterns as bits
from craftsim.discrete.kinds import RuleSetName
from craftsim.discrete.learned import (
    CAR_PROPERTIES,
    LearnedRule,
    LearnedRules,
    PatternCell,
    RulesOrigin,
    Verb,
    cell_words,
)
from craftsim.errors import InputError
from craftsim.experiments.anytime import CONFIDENCE, play_lower_bound
from craftsim.experiments.bundle import write_bundle
from craftsim.experiments.experiment import Experiment, RunOptions, Trial
from craftsim.experiments.session import open_session
from craftsim.reports.json_file import versions
from craftsim.storage.folders import directory_within

_LEARNED_VERBS: Final = tuple(
    number for number, verb in enumerate(bits.VERBS) if verb != "ROTATE_RIGHT"
)
_SITUATIONS_PER_JOB: Final = 8
_EPISODES: Final = 30
"""Episodes of play in a round; each has about 70 actions, at most MOST_PLAYED."""
_NEAR_MISSES: Final = 30
"""Failures of a round that are tried again without one thing after the other."""
_UNFAMILIAR: Final = 240
"""Unfamiliar situations that a round tries."""
_POOL_WORLDS: Final = 64
"""Worlds of play on the grid alone, of a round, from which situations are taken."""
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
    is_cautious: bool = True
    """Whether rules also forbid what is like a failure and has never worked."""
    rounds: list[Round] = field(default_factory=list)
    examples: list[Example] = field(default_factory=list)
    n_actions: int = 0
    n_unfinished: int = 0
    """Trials that did not finish: some situations, or an episode of play."""
    n_unsolved: int = 0
    """Actions in which the solver gave up."""
    patterns: list[Pattern] = field(default_factory=list)
    tried: set[WorldAction] = field(default_factory=set)
    """Single situations that were learned from."""
    _tried_again: set[WorldAction] = field(default_factory=set)
    """Failures that were tried once more."""

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
        is_unexplained = any(not example.worked for example in self.examples)
        for number in range(_MOST_ROUNDS):
            this_round = Round(number)
            new = self._play(learned, number, f"round-{number:02}-play")
            this_round.actions = len(new)
            this_round.failures = sum(not example.worked for example in new)
            if not new and not learned.rules:
                raise InputError(
                    f"no action could be tried in {_EPISODES} worlds of play: with these machines none of them stands"
                )
            if this_round.failures or is_unexplained:
                is_unexplained = False
                self._ask(new, number, this_round)
                self.patterns, this_round.uncovered = self._fitted(number, self.is_cautious)
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
            self.n_unsolved += unsolved_in(records)
            errors = [record["error"] for record in records if record["error"] is not None]
        if len(errors) == len(trials):
            raise InputError(f"no trial of {stage} has finished; the first: {errors[0]}")
        self.n_unfinished += len(errors)
        self.n_actions += len(examples)
        return examples

    def _try(
        self, situations: Iterable[WorldAction], stage: str, is_near_miss: bool = False
    ) -> int:
        """Learn from situations that were not tried before; return how many there were."""
        new = [item for item in dict.fromkeys(situations) if item not in self.tried]
        self.tried.update(new)
        examples = self.try_situations(new, stage)
        for example in examples:
            self.examples.append(example._replace(is_near_miss=is_near_miss))
        return len(examples)

    def try_situations(self, situations: Sequence[WorldAction], stage: str) -> list[Example]:
        """Return the examples of situations in physics, each in a world of its own."""
        setup = replace(self.setup, rules=self.base)
        jobs = []
        for start in range(0, len(situations), _SITUATIONS_PER_JOB):
            seed = (self.seed, zlib.crc32(stage.encode()), start)
            batch = tuple(situations[start : start + _SITUATIONS_PER_JOB])
            jobs.append(ActionsJob(seed, batch, setup))
        if not jobs:
            return []
        return self._run(stage, jobs)

    def _ask(self, new: Sequence[Example], number: int, this_round: Round) -> None:
        """Learn from new examples of play, and try what tells most.

        That is unfamiliar situations; failures once more, of which those that do not fail again were chance, or of a
        fault that is gone; those that do without one thing each; and new patterns elsewhere.
        """
        rng = np.random.default_rng((self.seed, number, 1))
        options = list(options_of_play(self.base, rng, _POOL_WORLDS))
        with_new = [*self.examples, *new]
        situations = unfamiliar(self.patterns, with_new, options, _UNFAMILIAR)
        this_round.trials += self._try(situations, f"round-{number:02}-unfamiliar")
        self.examples += new
        failures = []
        for example in self.examples:
            if example.situation is not None and example.situation not in self._tried_again:
                failures.append(example.situation)
        self._tried_again.update(failures)
        again = self.try_situations(failures, f"round-{number:02}-again")
        this_round.trials += len(again)
        failed_again = [example.situation for example in again if example.situation is not None]
        # What fails again says nothing new.
        self.examples += [example for example in again if example.worked]
        misses = []
        # Those of play come last.
        for situation in failed_again[-_NEAR_MISSES:]:
            misses += near_misses(situation)
        this_round.trials += self._try(misses, f"round-{number:02}-near", is_near_miss=True)
        patterns, _ = self._fitted(number)
        doubts = list(doubtful(patterns, self.examples, options, rng))
        this_round.trials += self._try(doubts, f"round-{number:02}-doubts")

    def _fitted(self, number: int, is_cautious: bool = False) -> tuple[list[Pattern], int]:
        """Return the patterns that the examples ask for, and how many failures none covers.

        Cautious ones forbid also what is like these and never worked.
        """
        rng = np.random.default_rng((self.seed, number, 2))
        patterns: list[Pattern] = []
        n_uncovered = 0
        for verb in _LEARNED_VERBS:
            examples = ExampleSet.of(verb, self.examples)
            if examples.failures.any():
                fitted, _ = fit(examples, rng)
                if is_cautious:
                    fitted = [cautious(examples, pattern) for pattern in fitted]
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

    def failures_of(self, examples: Sequence[Example]) -> dict[str, list[Example]]:
        """Return the failures among examples that each rule forbids, by its name."""
        failures: dict[str, list[Example]] = {}
        for verb in _LEARNED_VERBS:
            failed = [e for e in examples if e.verb == verb and e.situation is not None]
            of_patterns = [pattern for pattern in self.patterns if pattern.verb == verb]
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
        if row.legal and is_single_action(situation):
            situations.append(placed_action(situation))
    return situations


def _name(verb: int, number: int) -> str:
    """Return the name of a rule: its verb, and its number among those of the verb."""
    return f"{bits.VERBS[verb].lower().replace('_', '-')}-{number + 1}"


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
