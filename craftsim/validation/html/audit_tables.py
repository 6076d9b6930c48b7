"""The tables of an audit's page that tell of suspects and corrections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from craftsim.validation.audit.corrections import rows_by_switch
from craftsim.validation.audit.suspects import SuspectFinding
from craftsim.validation.html.disagreements import TONES
from craftsim.validation.html.page import Cell, Column, Table, Tone
from craftsim.validation.statistics.audit_rows import Judgement


def suspects_table(found: Sequence[SuspectFinding]) -> Table:
    """Return the table of the suspects."""
    return Table(
        (
            Column("suspect"),
            Column("verdict"),
            Column("evidence"),
            Column("rows", number=True),
            Column("trials", number=True),
        ),
        tuple(
            (
                Cell(f"{f.number}. {f.question}", wide=True),
                Cell(f.verdict, _tone(f)),
                Cell(f.evidence, path=True, wide=True),
                str(f.rows),
                f"{f.trials:,}",
            )
            for f in found
        ),
        note="Evidence is the clearest row of the gravest verdict.",
    )


def corrections_table(corrected: Mapping[str, Sequence[str]]) -> Table:
    """Return the table of the switches of the rules that correct the unsound rows."""
    uncorrected = sum(not switches for switches in corrected.values())
    rows = [*rows_by_switch(corrected).items(), *([("no switch", uncorrected)] if uncorrected else [])]
    return Table(
        (Column("correction"), Column("unsound rows", number=True)),
        tuple((Cell(switch, path=True), f"{count:,}") for switch, count in rows),
        caption="The rules that these come of",
        note="A correction is a switch that the physical rules have on; docs/rules.md says what each one asks for.",
    )


def _tone(finding: SuspectFinding) -> Tone:
    """Return the tone of the gravest verdict; verdicts are told in that order."""
    gravest = next((j for j in Judgement if finding.verdict.split(", ")[0].endswith(f" {j}")), None)
    return TONES[gravest] if gravest else Tone.MUTED
