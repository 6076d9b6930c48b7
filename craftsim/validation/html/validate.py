"""The page of a validation: do plans, actions and policies do in physics what the rules predict?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from craftsim.checking.attempt import Result
from craftsim.validation.html.page import (
    Block,
    Case,
    Cell,
    Column,
    Headline,
    KeyFigure,
    Page,
    Section,
    Table,
    Tone,
)
from craftsim.validation.html.paired import paired_section
from craftsim.validation.html.plots import (
    durations_plot,
    errors_plot,
    policies_plot,
    success_plot,
    survival_plot,
)
from craftsim.validation.html.run_description import RunDescription, provenance_section
from craftsim.validation.html.tables import (
    NONE,
    TONES,
    case_blocks,
    count,
    duration_rows,
    error_table,
    interval,
    matrix_table,
    percent,
    precision_table,
    share_cells,
    verb_table,
)
from craftsim.validation.statistics.figures import Figures
from craftsim.validation.statistics.paired import Comparison
from craftsim.validation.statistics.ranking import Estimate, RankAgreement
from craftsim.validation.statistics.records import Record, as_predicted, attempts_of, carried_out
from craftsim.validation.validation import Validation


def validate_page(result: Validation, command: str) -> Page:
    """Return the page of a validation; ``command`` is how it can be run again."""
    figures = result.figures
    description = RunDescription.of(command, result.seed, result.config)
    return Page(
        "Validation in physics",
        f"{', '.join(result.config['worlds'])}: {', '.join(result.config['by'])}",
        _headline(figures, result.records),
        tuple(_key_figures(figures)),
        tuple(_sections(result.records, figures, description, result.comparison)),
    )


def _headline(figures: Figures, records: Sequence[Record]) -> Headline:
    actions = figures.matrix.legal
    runs = figures.all.runs
    missed = actions.trials - actions.as_predicted
    errors = sum(figures.errors.values())
    lost = f" {count(errors, 'more trial')} did not come to an end." if errors else ""
    if not runs.trials:
        return Headline("Nothing to judge", Tone.CAUTION, "No trial was carried out to its end." + lost)
    if runs.successes == runs.trials:
        sentence = f"All {count(runs.trials, 'run')} did in physics what the rules predict."
        return Headline("Agrees", Tone.CAUTION if errors else Tone.GOOD, sentence + lost)
    asked = sum(any(not a["legal"] for a in record["attempts"]) for record in records)
    lost += f" {count(asked, 'run')} asked for what the rules forbid, which was not tried." if asked else ""
    if not missed:
        return Headline("Forbidden by the rules", Tone.CAUTION, "All that was tried did as predicted." + lost)
    refused = sum(any(a["legal"] and not as_predicted(a) for a in record["attempts"]) for record in records)
    sentence = (
        f"In {refused:,} of {count(runs.trials, 'run')} physics disagrees with the rules; "
        f"of {count(actions.trials, 'action')} that the rules allow, {missed:,} did not do what they predict."
    )
    return Headline("Disagrees", Tone.BAD, sentence + lost)


def _key_figures(figures: Figures) -> Iterator[KeyFigure]:
    for label, p in (
        ("runs that agree", figures.all.runs),
        ("actions as predicted", figures.all.actions),
    ):
        note = f"{p.successes:,} of {p.trials:,}; {interval(p.wilson_low, p.wilson_high)}"
        yield KeyFigure(percent(p.rate), label, note)
    if car := figures.precision.car_error_mm:
        yield KeyFigure(f"{car.median:.2g} mm", "car's error, median", f"95 % within {car.p95:.2g} mm")
    if force := figures.precision.peak_force_n:
        yield KeyFigure(f"{force.max:.0f} N", "peak contact force", f"median {force.median:.0f} N")
    if figures.rank_agreement:
        yield KeyFigure(f"{figures.rank_agreement.mmrv:.2f}", "rank violation (MMRV)", "0 best, 1 worst")


def _sections(
    records: Sequence[Record], figures: Figures, provenance: RunDescription, comparison: Comparison | None
) -> Iterator[Section]:
    blocks: list[Block] = [
        matrix_table(figures.matrix),
        verb_table(figures.by_verb),
        success_plot(figures.by_verb),
    ]
    if len(figures.by_group) > 1:
        blocks.insert(0, _group_table(figures))
    lead = "Each action is predicted by the rules, carried out by motors, and judged on the poses afterwards."
    yield Section("results", "Results", lead, tuple(blocks))
    if comparison is not None:
        yield paired_section(comparison)
    cases = [case for record in carried_out(records) if (case := _case(record))]
    yield Section(
        "disagreements",
        "Disagreements",
        "The first one of each run that disagrees. Replay them from the folder of this page.",
        (*case_blocks(cases), *((error_table(figures.errors),) if figures.errors else ())),
    )
    yield Section(
        "survival",
        "Survival",
        "How long a plan is good for.",
        (survival_plot(figures.survival),),
    )
    if figures.policies:
        yield _policies(figures)
    legal = [attempt for attempt in attempts_of(carried_out(records)) if attempt["legal"]]
    yield Section(
        "errors",
        "Errors and forces",
        "Where physics agrees with the rules, how far it is from them in numbers.",
        (precision_table(figures.precision), errors_plot(legal)),
    )
    yield Section(
        "durations",
        "Durations",
        "What a planner can count on; by action, load, ground and level.",
        (durations_plot(figures.durations), duration_rows(figures.durations)),
    )
    yield provenance_section(provenance)


def _group_table(figures: Figures) -> Table:
    rows = tuple(
        (
            Cell(name, path=True),
            f"{group.runs.trials:,}",
            *share_cells(group.runs),
            f"{group.actions.trials:,}",
            *share_cells(group.actions),
        )
        for name, group in figures.by_group.items()
    )
    numbers = ("runs", "runs that agree", "95 % interval", "actions", "actions as predicted", "95 % interval")
    return Table(
        (Column("plan or policy"), *(Column(title, number=True) for title in numbers)),
        rows,
        caption="By plan or policy",
    )


def _case(record: Record) -> Case | None:
    attempt = next((a for a in record["attempts"] if not as_predicted(a)), None)
    if attempt is None:
        return None
    result = Result(attempt["result"])
    return Case(
        title=f"{record['key']}: tick {attempt['tick']}, car {attempt['car']} {attempt['action']}",
        result=result.value,
        tone=TONES[result],
        reason=attempt["reason"],
        differences=tuple(attempt["differences"]),
        bundle=record["bundle"] or "",
    )


def _policies(figures: Figures) -> Section:
    scores = Table(
        (Column("policy"), *(Column(title, number=True) for title in ("episodes", "grid world", "physics"))),
        tuple((s.policy, f"{s.episodes:,}", percent(s.grid), percent(s.physics)) for s in figures.policies),
        caption="Success",
    )
    blocks: list[Block] = [policies_plot(figures.policies), scores]
    if figures.rank_agreement:
        blocks.append(_agreement_table(figures.rank_agreement))
    return Section(
        "policies",
        "Policies in both worlds",
        "Does a policy that does better in the grid world also do better in physics?",
        tuple(blocks),
    )


def _agreement_table(agreement: RankAgreement) -> Table:
    def row(name: str, e: Estimate) -> tuple[str, str, str]:
        if e.value is None or e.low is None or e.high is None:
            return (name, "not defined", NONE)
        return (name, f"{e.value:.3f}", f"{e.low:.3f} to {e.high:.3f}")

    return Table(
        (Column("figure"), Column("value", number=True), Column("95 % interval", number=True)),
        (
            row("Pearson correlation", agreement.pearson),
            row("Spearman correlation", agreement.spearman),
            ("mean maximum rank violation", f"{agreement.mmrv:.3f}", NONE),
        ),
        caption=f"Agreement over {agreement.policies} policies",
        note="Intervals by bootstrap over policies. A rank violation is the distance in physics of two policies "
        "that the worlds order differently.",
    )
