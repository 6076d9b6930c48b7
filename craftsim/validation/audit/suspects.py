"""Rules that were under suspicion before anything was tried, and what the audit's rows say of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Final

from craftsim.validation.statistics.audit_rows import AuditRow, Judgement


@dataclass(frozen=True)
class Suspect:
    """A suspicion, and the names of the rows that decide on it, as patterns."""

    number: int
    question: str
    patterns: tuple[str, ...]


SUSPECTS: Final = (
    Suspect(1, "UNFOLD while something is in the way of the flap", ("UNFOLD/*",)),
    Suspect(2, "FOLD while something is where the flap comes up and over", ("FOLD/*",)),
    Suspect(
        3,
        "a car enters a cell that another leaves in the same tick, both loaded",
        ("MOVE+MOVE/*", "DROP+MOVE/*"),
    ),
    Suspect(
        4,
        "turning with a load among neighbours",
        ("ROTATE_*load=block*", "ROTATE_*load=fslope*", "ROTATE_*/scene=*"),
    ),
    Suspect(
        5,
        "turning without a load under a block or a slope",
        ("ROTATE_*own=block*load=none*", "ROTATE_*own=fslope*load=none*", "ROTATE_*own=body*load=none*"),
    ),
    Suspect(6, "driving sideways with a load", ("MOVE-left/*ground=flat/own=air/load=[bf]*next=air*",)),
    Suspect(7, "moves under blocks sideways", ("MOVE-left/*own=block*", "MOVE-left/*next=block*")),
    Suspect(8, "standing on a folded slope or a flag", ("MOVE/scene=onto a f*",)),
    Suspect(
        9, "carrying past neighbours that stand 2.5 mm away", ("MOVE-*ground=flat*load=[bf]*room=tight",)
    ),
    Suspect(
        10,
        "climbing with a load, under and beside what stands there",
        (
            "MOVE-forward/*ground=*-up*load=[bf]*",
            "MOVE-forward/*load=[bf]*next=foot*",
            "MOVE/scene=up below*",
        ),
    ),
    Suspect(
        11,
        "a car above a ramp's body and another below it",
        ("MOVE/scene=*car on top", "MOVE/scene=*car below"),
    ),
    Suspect(
        12,
        "driving down from whatever stands behind a ramp",
        ("MOVE-forward/*next=above-body*", "MOVE/scene=down*", "MOVE/scene=onto a top*"),
    ),
    Suspect(13, "lifting and setting down beside neighbours", ("LIFT/*", "DROP/*", "DROP+MOVE/*")),
    Suspect(14, "standing on the incline", ("STOP/*ground=low*", "STOP/*ground=high*")),
)


@dataclass(frozen=True)
class SuspectFinding:
    """What was found on a suspect."""

    number: int
    question: str
    rows: int
    """How many were tried."""
    trials: int
    verdict: str
    evidence: str
    """The clearest row of the gravest kind, with its figures and reason."""


def find(rows: Sequence[AuditRow], at_once: Sequence[AuditRow]) -> list[SuspectFinding]:
    """Return what was found on each suspect; ``at_once`` are rows that count as evidence only."""
    return [_finding(suspect, rows, at_once) for suspect in SUSPECTS]


def _concerned(suspect: Suspect, rows: Iterable[AuditRow]) -> list[AuditRow]:
    """Return the rows that were tried and that a suspect is about."""
    patterns = suspect.patterns
    return [r for r in rows if r.trials and any(fnmatchcase(f"{r.action}/{r.context}", p) for p in patterns)]


def _finding(suspect: Suspect, rows: Iterable[AuditRow], at_once: Iterable[AuditRow]) -> SuspectFinding:
    mine, together = _concerned(suspect, rows), _concerned(suspect, at_once)
    counts = Counter(row.verdict for row in mine)
    verdict = ", ".join(f"{counts[j]} {j}" for j in Judgement if counts[j])
    gravest = next((j for j in Judgement if counts[j]), None)
    told = min((r for r in mine if r.verdict == gravest), key=_clarity, default=None)
    return SuspectFinding(
        suspect.number,
        suspect.question,
        len(mine),
        sum(row.trials for row in mine),
        verdict or "not tried",
        "; ".join(
            ([_evidence(told)] if told else []) + [f"begun all at once, {_evidence(row)}" for row in together]
        ),
    )


def _clarity(row: AuditRow) -> tuple[int, str]:
    """Sort first what disagrees with the rules in most trials."""
    against = row.as_predicted if row.legal else row.trials - row.as_predicted
    return against, f"{row.action}/{row.context}"


def _evidence(row: AuditRow) -> str:
    did = f"{row.action}/{row.context}: {row.as_predicted} of {row.trials} as predicted"
    return f"{did}; {row.reason}" if row.reason else did
