"""Certificates: trials until it is decided whether a plan or policy succeeds often enough."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from craftsim.experiments.anytime import log_evidence_above, log_evidence_below, lower_bound
from craftsim.experiments.experiment import Trial, TrialRecord

REPETITIONS: Final = (1, 10, 100)
"""Numbers of repetitions for which a certificate bounds the probability that all succeed."""
_FIRST_ROUND: Final = 8
_GROWTH: Final = 8
"""A round has at least an eighth of the trials before it: as many may be more than needed."""


class Decision(StrEnum):
    """Whether the success rate is as high as asked for."""

    YES = "yes"
    NO = "no"
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class Certificate:
    """What is certain of the success of a plan or policy in a world."""

    subject: str
    """The world and the plan or policy."""
    required_rate: float
    confidence: float
    decision: str
    """One of :class:`Decision`."""
    trials: int
    successes: int
    at_least: float
    """The success rate is above this with the confidence."""
    repetitions: Mapping[str, float]
    """The probability that so many independent runs all succeed is at least this, by their number."""

    @classmethod
    def of(
        cls, subject: str, successes: int, trials: int, required_rate: float, confidence: float
    ) -> Certificate:
        """Return what follows from the successes among some trials."""
        at_least = lower_bound(successes, trials, confidence)
        return cls(
            subject,
            required_rate,
            confidence,
            decision_on(successes, trials, required_rate, confidence).value,
            trials,
            successes,
            at_least,
            {str(repetitions): at_least**repetitions for repetitions in REPETITIONS},
        )


def decision_on(successes: int, trials: int, required_rate: float, confidence: float) -> Decision:
    """Return whether the success rate is above or below the required one.

    Whatever the true rate, and however often this is asked of one run, the answer is ever wrong with at most the
    probability ``1 - confidence``.
    """
    log_needed = -math.log1p(-confidence)
    if log_evidence_above(successes, trials, required_rate) >= log_needed:
        return Decision.YES
    if log_evidence_below(successes, trials, required_rate) >= log_needed:
        return Decision.NO
    return Decision.UNDECIDED


class CertificationRule:
    """Runs trials of each plan or policy in each world until it is decided on; see :class:`StoppingRule`."""

    def __init__(
        self, required_rate: float, confidence: float, succeeds: Callable[[TrialRecord], bool]
    ) -> None:
        """Take the required success rate, the confidence, and what counts as a success."""
        self._required_rate = required_rate
        self._confidence = confidence
        self._succeeds = succeeds
        self._trials = Counter[str]()
        self._successes = Counter[str]()

    def subject_of(self, trial: Trial) -> str:
        """Return the world and the plan or policy of a trial."""
        return f"{trial.context}: {trial.group}"

    def order_of(self, trial: Trial) -> int:
        """Return the number of a trial."""
        return trial.episode or 0

    def round_sizes(self) -> Iterator[int]:
        """Yield numbers of trials, each in proportion to all before it."""
        total = 0
        while True:
            size = max(_FIRST_ROUND, total // _GROWTH)
            yield size
            total += size

    def is_decided(self, subject: str, records: Sequence[TrialRecord]) -> bool:
        """Count the records of a round, and return whether the answer is yes or no."""
        self._trials[subject] += len(records)
        self._successes[subject] += sum(self._succeeds(record) for record in records)
        return self.certificate_of(subject).decision != Decision.UNDECIDED

    def certificate_of(self, subject: str) -> Certificate:
        """Return what follows from the records so far."""
        return Certificate.of(
            subject,
            self._successes[subject],
            self._trials[subject],
            self._required_rate,
            self._confidence,
        )

    def certificates(self) -> list[Certificate]:
        """Return what follows of each subject, in the order in which they were run."""
        return [self.certificate_of(subject) for subject in self._trials]


def plan_of_actions(successes: int, actions: int, length: int) -> float:
    """Return the probability, at least, at 95 % confidence, that a plan of ``length`` actions goes as predicted.

    It follows from actions that were tried, if actions fail independently of each other.
    """
    return lower_bound(successes, actions) ** length
