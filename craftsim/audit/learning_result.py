"""What learning has brought: rules, how play by them goes in worlds that were never seen, and what they have in common
with others.
"""

from __future__ import annotations

import gzip
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from craftsim.audit.examples import MOST_PLAYED, episodes_of, trace_lines
from craftsim.audit.known_corrections import CorrectionFound, KnownCorrections, correction_found
from craftsim.audit.learning import Round, RuleLearner
from craftsim.discrete.kinds import RuleSetName
from craftsim.discrete.learned import LearnedRules
from craftsim.experiments.anytime import play_bounds
from craftsim.storage.writing import write_whole

TRACES: Final = "traces.jsonl.gz"
"""All examples for other learners, but those of play to compare with."""


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
    corrections: Mapping[str, CorrectionFound]
    """How much of each correction is found again, by its name; empty without rules to compare with."""
    bundles: tuple[str, ...]
    unfinished: int
    """Trials that did not finish, and count nowhere."""
    unsolved: int
    """Actions in which the solver gave up: neither failures nor successes."""
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
            "unfinished": self.unfinished,
            "unsolved": self.unsolved,
            "cpu_s": self.cpu_s,
        }


def run_learning(learner: RuleLearner, name: str, compare: RuleSetName | None) -> LearnedResult:
    """Learn rules, try them in worlds that were never seen, and write replay bundles of what asks for each.

    With ``compare`` play by another rule set tells how much the learned rules forbid that it allows, and that works;
    and situations of each known correction, what of it they have.
    """
    rules = learner.learn(name)
    held_out = learner.held_out(rules, "held-out")
    allowed = 0
    forbidden_count = 0
    yardstick = KnownCorrections(learner.base)
    corrections: dict[str, CorrectionFound] = {}
    if compare is not None:
        compared = learner.held_out(compare, "compared")
        allowed, forbidden_count = learner.cost(compared)
        corrections = _found_again(learner, yardstick)
    failures = learner.failures_of(learner.examples)
    likenesses = {name: yardstick.most_like(of_rule) for name, of_rule in failures.items()}
    if learner.out is not None:
        lines = "".join(trace_lines([*learner.examples, *held_out]))
        write_whole(learner.out / TRACES, gzip.compress(lines.encode(), mtime=0))
    n_actions, failed = episodes_of(held_out)
    cpu_s = sum(os.times()[:4])
    origin = replace(rules.origin, actions=learner.n_actions, cpu_s=round(cpu_s, 1))
    liked = [replace(rule, like=likenesses[rule.name]) for rule in rules.rules]
    rules = replace(rules, rules=tuple(liked), origin=origin)
    return LearnedResult(
        rules,
        tuple(learner.rounds),
        len(held_out),
        len(n_actions),
        play_bounds(n_actions, failed, MOST_PLAYED),
        tuple(example.reason for example in held_out if not example.worked),
        allowed,
        forbidden_count,
        corrections,
        tuple(learner.bundles(failures)),
        learner.n_unfinished,
        learner.n_unsolved,
        cpu_s,
        {"base": learner.base, "budget": learner.budget, **learner.setup.provenance},
        learner.seed,
    )


def _found_again(learner: RuleLearner, yardstick: KnownCorrections) -> dict[str, CorrectionFound]:
    """Try situations of each correction that learning never tried."""
    rng = np.random.default_rng((learner.seed, 2_000_000))
    corrections = {}
    for name, situations in yardstick.situations(rng, learner.tried).items():
        examples = learner.try_situations(situations, f"correction-{name}")
        corrections[name] = correction_found(examples, learner.failures_of(examples))
    return corrections
