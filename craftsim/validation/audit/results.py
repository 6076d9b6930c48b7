"""What an audit found: rows, the trials that show the disagreements, and figures for its reports."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Final

from craftsim.audit.plan import PlanRow, corrections, rows_by_flag
from craftsim.discrete.rules import RuleSet
from craftsim.experiments.bundle import write_bundles
from craftsim.experiments.experiment import TrialRecord
from craftsim.experiments.records import select
from craftsim.experiments.session import Session
from craftsim.validation.audit.suspects import SuspectFinding, find
from craftsim.validation.audit.trial import recipe_of
from craftsim.validation.audit.verdicts import AuditRow, Judgement, audit_rows, verdict_counts

AT_ONCE: Final = "order=at-once"
"""How the names of rows end that are evidence only."""

DISAGREEMENTS: Final = (Judgement.UNSOUND, Judgement.CONSERVATIVE)


@dataclass(frozen=True)
class Results:
    """An audit's rows, and its verdicts on the suspects."""

    rows: tuple[AuditRow, ...]
    """Of actions as the rules have them: one after the other, or by the schedule that keeps them apart."""
    at_once: tuple[AuditRow, ...]
    """Of ticks whose actions were all begun together, which the rules do not claim to work."""
    suspects: tuple[SuspectFinding, ...]

    @classmethod
    def of(cls, records: Iterable[TrialRecord]) -> Results:
        """Return what the records of an audit say."""
        rows = audit_rows(records)
        together = tuple(row for row in rows if row.context.endswith(AT_ONCE))
        apart = tuple(row for row in rows if row not in together)
        return cls(apart, together, tuple(find(apart, together)))

    def of_kind(self, judgement: Judgement) -> list[AuditRow]:
        """Return the rows with a verdict."""
        return [row for row in self.rows if row.verdict == judgement]

    def corrected(self, plan: Sequence[PlanRow], rules: RuleSet) -> dict[str, tuple[str, ...]]:
        """Return the flags that would each correct an unsound row, by its name."""
        unsound = {name_of(row) for row in self.of_kind(Judgement.UNSOUND)}
        return corrections((row for row in plan if row.name in unsound), rules)

    def figures(self, plan: Sequence[PlanRow], corrected: Mapping[str, Sequence[str]]) -> dict[str, Any]:
        """Return what ``report.json`` holds; ``plan`` gives the contexts of each row."""
        planned = {row.name: row for row in plan}
        return {
            "verdicts": verdict_counts(self.rows),
            "provisional": sum(row.provisional for row in self.rows),
            "contexts": sum(len(row.members) for row in plan),
            "corrections": rows_by_flag(corrected),
            "rows": [
                {
                    **asdict(row),
                    "contexts": len(planned[name_of(row)].members),
                    "clearance_mm": planned[name_of(row)].clearance_mm,
                    "corrections": corrected.get(name_of(row), ()),
                }
                for row in self.rows
            ],
            "at_once": self.at_once,
            "suspects": self.suspects,
        }


def judged_by_rules(records: Iterable[TrialRecord]) -> Iterable[TrialRecord]:
    """Return the records without those of what is begun all at once: the rules say nothing of it."""
    return select(records, lambda record: not record["group"].endswith(AT_ONCE))


def name_of(row: AuditRow) -> str:
    """Return the name of a row, as in the plan of the audit."""
    return f"{row.action}/{row.context}"


def bundle_disagreements(session: Session, records: Sequence[TrialRecord]) -> dict[int, str]:
    """Write the replay bundle of the first disagreement of each unsound or conservative row.

    Returns the folders of the bundles, relative to the run's, by the number of their record.

    Raises:
        InputError: a bundle cannot be written; those that are finished are kept.
    """
    shown = {name_of(row) for row in Results.of(records).rows if row.verdict in DISAGREEMENTS}
    first: dict[str, int] = {}
    for index, record in enumerate(records):
        if record["group"] in shown and record["attempts"] and not record["agrees"]:
            first.setdefault(record["group"], index)
    items = session.experiment.items
    return write_bundles(session, {index: partial(recipe_of, items[index].job) for index in first.values()})
