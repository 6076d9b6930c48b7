"""How alike the actions of two runs of the same trials are: verdicts, durations, errors, forces, and what differs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from statistics import median
from typing import Final

from craftsim.validation.statistics.proportions import Proportion
from craftsim.validation.statistics.records import AttemptRecord, Record, as_predicted, carried_out, grouped

_SHOWN: Final = 6
"""How many kinds of difference the text shows."""


@dataclass(frozen=True)
class Difference:
    """One kind of action that went as predicted in one run alone."""

    kind: str
    """The verb, what was carried and whether on a slope, and the two results."""
    actions: int
    example: str
    """Key of the first trial with such an action."""


@dataclass(frozen=True)
class Alike:
    """Actions that both runs tried, paired in the order of each trial for as long as both try the same."""

    actions: int
    as_predicted_alike: int
    """How many went as predicted in both runs or in neither."""
    legal: Proportion
    """The same among the actions that the rules allow."""
    duration_ratio: float | None
    """Of the second run by the first, the median over the actions as predicted in both; None where there are none."""
    error_ratio: float | None
    """The same of the car's distance from its cell's centre."""
    peak_force_ratio: float | None
    """The same of the largest force between two machines."""
    differences: tuple[Difference, ...]
    """Commonest first."""

    @property
    def share(self) -> float:
        """The share of actions that went as predicted in both runs or in neither."""
        return self.as_predicted_alike / self.actions if self.actions else 1.0

    def __str__(self) -> str:
        ratios = [
            f"{name} {ratio:.3f} times theirs"
            for name, ratio in (
                ("durations", self.duration_ratio),
                ("errors", self.error_ratio),
                ("peak forces", self.peak_force_ratio),
            )
            if ratio is not None
        ]
        lines = [
            f"Of {self.actions:,} actions {self.share:.2%} went as predicted in both or in neither, and "
            f"{self.legal.successes:,} of the {self.legal.trials:,} that the rules allow"
            + (f"; at the median {', '.join(ratios)}." if ratios else ".")
        ]
        lines += [f"  {one.actions} {one.kind}: such as {one.example}" for one in self.differences[:_SHOWN]]
        left = sum(one.actions for one in self.differences[_SHOWN:])
        return "\n".join([*lines, *([f"  {left} of other kinds"] if left else [])])


def paired_actions(first: Iterable[Record], second: Iterable[Record]) -> list[tuple[str, Tried, Tried]]:
    """Return the actions of each trial, by its key, that both runs tried, for as long as both try the same."""
    earlier = {record["key"]: [*map(Tried.of, record["attempts"])] for record in carried_out(first)}
    return [
        (record["key"], a, b)
        for record in carried_out(second)
        for a, b in _paired(earlier.get(record["key"], []), map(Tried.of, record["attempts"]))
    ]


def alike(first: Iterable[Record], second: Iterable[Record]) -> Alike:
    """Return how alike the actions of two runs of the same trials are."""
    pairs = paired_actions(first, second)
    legal = [(a, b) for _, a, b in pairs if a.legal and b.legal]
    both = [(a, b) for _, a, b in pairs if a.good and b.good]
    kinds = grouped([(a.kind(b), key) for key, a, b in pairs if a.good != b.good], key=lambda one: one[0])
    differences = [Difference(kind, len(found), found[0][1]) for kind, found in kinds.items()]
    return Alike(
        actions=len(pairs),
        as_predicted_alike=sum(a.good == b.good for _, a, b in pairs),
        legal=Proportion.of(sum(a.good == b.good for a, b in legal), len(legal)),
        duration_ratio=_ratio((a.duration_s, b.duration_s) for a, b in both),
        error_ratio=_ratio((a.error_m, b.error_m) for a, b in both),
        peak_force_ratio=_ratio((a.force_n, b.force_n) for a, b in both),
        differences=tuple(sorted(differences, key=lambda one: (-one.actions, one.kind))),
    )


@dataclass(frozen=True, slots=True)
class Tried:
    """What is kept of an attempt; there are many."""

    what: tuple[int, int, str]
    verb: str
    name: str
    legal: bool
    result: str
    good: bool
    duration_s: float
    error_m: float
    force_n: float

    @classmethod
    def of(cls, attempt: AttemptRecord) -> Tried:
        """Return it of an attempt."""
        load = "" if attempt["load"] == "none" else f" with a {attempt['load']}"
        slope = " on a slope" if attempt["slope"] else ""
        return cls(
            (attempt["tick"], attempt["car"], attempt["action"]),
            attempt["verb"],
            f"{attempt['verb']}{load}{slope}{'' if attempt['legal'] else ', forbidden'}",
            attempt["legal"],
            attempt["result"],
            as_predicted(attempt),
            attempt["duration_s"],
            attempt["car_error_m"],
            attempt["peak_force_n"],
        )

    def kind(self, other: Tried) -> str:
        """Return what differs from the same action in the other run."""
        return f"{self.name}: {self.result} there, {other.result} here"


def _paired(first: Iterable[Tried], second: Iterable[Tried]) -> Iterator[tuple[Tried, Tried]]:
    for a, b in zip(first, second, strict=False):
        if a.what != b.what:
            return
        yield a, b


def _ratio(pairs: Iterable[tuple[float, float]]) -> float | None:
    ratios = [b / a for a, b in pairs if a > 0]
    return median(ratios) if ratios else None
