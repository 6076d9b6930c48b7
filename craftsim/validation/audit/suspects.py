"""Rules that were under suspicion before anything was tried, and what the audit's rows say of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, Final

from craftsim.audit.situation import shipped
from craftsim.validation.audit.verdicts import AuditRow, Judgement

SUSPECTS: Final[list[Mapping[str, Any]]] = shipped("suspects.yaml")
"""Those of ``craftsim/data/suspects.yaml``: a question, and the rows that decide on it as patterns of their names."""


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
    return [_finding(number, suspect, rows, at_once) for number, suspect in enumerate(SUSPECTS, start=1)]


def _concerned(suspect: Mapping[str, Any], rows: Iterable[AuditRow]) -> list[AuditRow]:
    """Return the rows that were tried and that a suspect is about."""
    patterns = suspect["rows"]
    return [r for r in rows if r.trials and any(fnmatchcase(f"{r.action}/{r.context}", p) for p in patterns)]


def _finding(
    number: int, suspect: Mapping[str, Any], rows: Iterable[AuditRow], at_once: Iterable[AuditRow]
) -> SuspectFinding:
    mine, together = _concerned(suspect, rows), _concerned(suspect, at_once)
    counts = Counter(row.verdict for row in mine)
    verdict = ", ".join(f"{counts[j]} {j}" for j in Judgement if counts[j])
    gravest = next((j for j in Judgement if counts[j]), None)
    clearest = min((r for r in mine if r.verdict == gravest), key=_clarity, default=None)
    return SuspectFinding(
        number,
        suspect["question"],
        len(mine),
        sum(row.trials for row in mine),
        verdict or "not tried",
        "; ".join(
            ([_evidence(clearest)] if clearest else [])
            + [f"begun all at once, {_evidence(row)}" for row in together]
        ),
    )


def _clarity(row: AuditRow) -> tuple[int, str]:
    """Sort first what disagrees with the rules in most trials."""
    against = row.as_predicted if row.legal else row.trials - row.as_predicted
    return against, f"{row.action}/{row.context}"


def _evidence(row: AuditRow) -> str:
    did = f"{row.action}/{row.context}: {row.as_predicted} of {row.trials} as predicted"
    return f"{did}; {row.reason}" if row.reason else did
