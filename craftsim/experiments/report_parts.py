"""Sections that the reports of experiments share: results, errors, durations, survival, comparisons and provenance."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from craftsim.checking.attempt import Verdict, capped_text
from craftsim.checking.measurements import LABELLED
from craftsim.experiments import statistics
from craftsim.experiments.intervals import Estimate, Proportion
from craftsim.reports import plots
from craftsim.reports.json_file import json_value, versions
from craftsim.reports.report import (
    SHARE_COLUMNS,
    Block,
    Column,
    DataTable,
    Drawing,
    Headline,
    Section,
    TableCell,
    Tone,
    Value,
    numbers,
    share_cells,
)
from craftsim.storage.limits import shorten

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

    from craftsim.experiments.compare import Comparison, ControlArm, PairedActions, PairedTrials

RESULT_COLUMNS: Final = (
    Column("trials", "number"),
    Column("as predicted", "number", "the predicted effect and no other"),
    Column("retried", "number", "of these, with a second try of the skill"),
    Column("failed", "number", "the intended effect is missing or outside its limits"),
    Column("side effect", "number", "the predicted effect, and something else moved or changed"),
    Column("unsafe", "number", "something tipped or fell, or a contact force exceeded its limit"),
    Column("numerics", "number", "the solver did not converge: inconclusive"),
)
"""The columns of :func:`result_cells`."""
TONES: Final = dict(
    zip(
        Verdict,
        (Tone.GOOD, Tone.GOOD, Tone.CAUTION, Tone.CAUTION, Tone.BAD, Tone.MUTED),
        strict=True,
    )
)
"""By verdict."""
_MARKERS: Final = "os^DvPX*"
_QUANTILES: Final = np.linspace(0, 1, 201)
_MOST_ERRORS: Final = 20


def result_cells(row: Any) -> list[Value]:
    """Return the number of trials and of each result, zeros muted."""
    cells: list[Value] = [row.trials]
    for verdict, tone in TONES.items():
        number = getattr(row, verdict.name.lower())
        if not number:
            tone = Tone.MUTED
        cells.append(TableCell(f"{number:,}", tone))
    return cells


def results_table(title: str, name: str, rows: Mapping[str, statistics.MatrixRow]) -> DataTable:
    """Return a table of results by kind of attempt."""
    return DataTable(
        (Column(name), *RESULT_COLUMNS, *SHARE_COLUMNS),
        [
            (key, *result_cells(row), *share_cells(row.success))
            for key, row in rows.items()
            if row.trials
        ],
        title,
    )


def legality_table(matrix: Mapping[str, statistics.MatrixRow]) -> DataTable:
    """Return the results of legal attempts, and of forbidden ones tried on purpose."""
    rows = {
        "allowed by the rules": matrix["legal"],
        "forbidden, tried on purpose": matrix["forbidden"],
    }
    return results_table("Legality and result", "attempts", rows)


def success_drawing(by_verb: Mapping[str, statistics.MatrixRow]) -> Drawing:
    """Return a drawing of the success of each verb with its interval."""
    shares = {verb: row.success for verb, row in by_verb.items() if row.trials}
    rows = {verb: (p.rate or 0.0, p.low, p.high) for verb, p in shares.items()}

    def draw(axes: Axes) -> None:
        plots.interval_rows(axes, rows)
        low = min((low for _, low, _ in rows.values()), default=0.0)
        axes.set_xlim(math.floor(10 * low) / 10 - 0.02, 1.02)
        axes.xaxis.set_major_formatter(plots.percent_ticks)

    caption = "Share of legal actions as predicted, with 95 % interval."
    label = "success by action, with intervals"
    return Drawing.of_axes(draw, plots.rows_height_in(len(rows)), caption, label)


def error_tables(errors: Mapping[str, int]) -> list[Block]:
    """Return a table of the errors of unfinished trials; empty without any."""
    if not errors:
        return []
    note = "They count in no other metric."
    hidden_kinds = len(errors) - _MOST_ERRORS
    if hidden_kinds > 0:
        note += f" {hidden_kinds} more kinds of error are in trials.jsonl."
    rows = list(errors.items())[:_MOST_ERRORS]
    return [DataTable(numbers("error", "trials"), rows, "Unfinished trials", note)]


def precision_table(distributions: Mapping[str, statistics.Distribution | None]) -> DataTable:
    """Return a table of errors."""
    named = {}
    for row in LABELLED:
        named[row.shown_label] = distributions[row.shown_name]
    named["duration against the median of its kind, s"] = distributions["duration_error_s"]
    named["peak contact force, N (all attempts)"] = distributions["peak_force_n"]
    rows = []
    for name, distribution in named.items():
        if distribution is not None:
            rows.append(
                (
                    name,
                    distribution.n,
                    _figure(distribution.median),
                    _figure(distribution.p95),
                    _figure(distribution.p99),
                    _figure(distribution.max),
                )
            )
    return DataTable(
        numbers("error", "n", "median", "95th percentile", "99th percentile", "largest"),
        rows,
        "Errors",
        "Of the legal attempts as predicted, unless marked (all attempts).",
    )


def _figure(value: float) -> str:
    if value >= 100:
        return f"{value:,.0f}"
    return f"{value:.3f}"


def error_drawing(attempts: DataFrame) -> Drawing:
    """Return a drawing of the error distributions of the attempts as predicted."""
    errors_of_fields = statistics.errors(attempts)
    kinds = (
        ("car_error_m", "car", plots.ACCENT),
        ("placed_error_m", "what is placed", plots.GOOD),
        ("height_error_m", "height", plots.CAUTION),
        ("bystander_displacement_m", "others moved", plots.SOFT),
    )

    def draw(axes: Axes) -> None:
        for field, label, colour in kinds:
            values = errors_of_fields[field]
            if len(values):
                axes.plot(
                    np.quantile(values, _QUANTILES), _QUANTILES, color=colour, lw=1.8, label=label
                )
        axes.set_xscale("symlog", linthresh=0.1, linscale=0.4)
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.set_xlim(left=0)
        axes.yaxis.set_major_formatter(plots.percent_ticks)
        axes.set_xlabel("error, mm")
        if axes.lines:
            axes.legend(loc="lower right")

    caption = "Cumulative distribution of the errors of the attempts as predicted."
    return Drawing.of_axes(draw, 2.9, caption, "distribution of errors")


def duration_blocks(table: Sequence[Mapping[str, Any]]) -> list[Block]:
    """Return the durations of each kind of action, as a drawing and a table."""
    named = {}
    for row in table:
        load = ""
        if row["load"] != "none":
            load = f" with {row['load']}"
        ground = "flat"
        if row["slope"]:
            ground = "slope"
        named[f"{row['verb']}{load}, {ground}, level {row['level']}"] = row
    rows = {name: (row["median_s"], row["p05_s"], row["p95_s"]) for name, row in named.items()}

    def draw(axes: Axes) -> None:
        plots.interval_rows(axes, rows, 5)
        axes.set_xlim(left=0)
        axes.set_xlabel("seconds")

    caption = "Durations of the actions as predicted: median, and 5th to 95th percentile."
    columns = {
        "mean, s": "mean_s",
        "5th percentile, s": "p05_s",
        "median, s": "median_s",
        "95th percentile, s": "p95_s",
        "longest, s": "max_s",
    }
    return [
        Drawing.of_axes(
            draw, plots.rows_height_in(len(rows), 0.23), caption, "durations by kind of action"
        ),
        DataTable(
            numbers("kind of action", "n", *columns),
            [
                (name, row["n"], *(f"{row[key]:.2f}" for key in columns.values()))
                for name, row in named.items()
            ],
            "Durations",
            "The same table is in durations.csv.",
            folded=True,
        ),
    ]


def survival_section(curves: Mapping[str, Mapping[str, Any]]) -> Section:
    """Return a section on the survival of plans."""

    def draw(axes: Axes) -> None:
        for name, colour, label in (
            ("with_resync", plots.GOOD, "closed loop"),
            ("without_resync", plots.ACCENT, "open loop"),
        ):
            curve = curves[name]
            steps = [0, *curve["actions"]]
            axes.step(
                steps, [1.0, *curve["share"]], where="post", color=colour, lw=1.8, label=label
            )
            low = np.array([1.0, *curve["low"]], dtype=float)
            high = np.array([1.0, *curve["high"]], dtype=float)
            axes.fill_between(steps, low, high, step="post", color=colour, alpha=0.16, lw=0)
        axes.set_ylim(-0.02, 1.04)
        axes.set_xlim(left=0)
        axes.yaxis.set_major_formatter(plots.percent_ticks)
        axes.set_xlabel("actions carried out")
        axes.legend(loc="lower left")

    caption = (
        "Share of runs that survive so many actions (Kaplan-Meier, 95 % band). Open loop, a run ends with its first "
        "disagreement; closed loop, with the first action that is forbidden in the world as read, or unsafe."
    )
    drawing = Drawing.of_axes(draw, 2.9, caption, "plan survival")
    return Section("survival", "Survival", "Number of actions until a plan fails.", [drawing])


def policies_section(figures: statistics.Figures) -> list[Section]:
    """Return a section on the success of policies in the grid world and in physics; empty without policies."""
    scores = figures.policies
    if not scores:
        return []
    rows = []
    for score in scores:
        n = score["episodes"]
        grid = Proportion.of(round(score["grid"] * n), n)
        physics = Proportion.of(round(score["physics"] * n), n)
        rows.append((score["policy"], n, *share_cells(grid), *share_cells(physics)))
    heads = ("episodes", "grid world", "95 % interval", "physics", "95 % interval")
    table = DataTable(numbers("policy", *heads), rows, "Success")

    def draw(axes: Axes) -> None:
        axes.plot((0, 1), (0, 1), color=plots.GRID, lw=1.2, zorder=1)
        look: dict[str, Any] = {"color": plots.ACCENT, "ms": 8, "mec": plots.PAPER}
        look |= {"clip_on": False, "zorder": 3}
        for score, marker in zip(scores, cycle(_MARKERS)):
            label = shorten(score["policy"], plots.LONGEST_NAME)
            axes.plot(score["grid"], score["physics"], marker, label=label, **look)
        axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5), handletextpad=0.1)
        axes.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03), aspect="equal")
        axes.set(xlabel="success in the grid world", ylabel="success in physics")
        axes.xaxis.set_major_formatter(plots.percent_ticks)
        axes.yaxis.set_major_formatter(plots.percent_ticks)

    caption = "Success of each policy in both worlds; on the line they agree."
    label = "success of policies in the grid world and in physics"
    blocks: list[Block] = [Drawing.of_axes(draw, 3.4, caption, label), table]
    agreement = figures.rank_agreement
    if agreement is not None:
        agreement_rows: list[tuple[Value, ...]] = [
            ("Pearson correlation", *_estimate_cells(agreement.pearson)),
            ("Spearman correlation", *_estimate_cells(agreement.spearman)),
            ("mean maximum rank violation", f"{agreement.mmrv:.3f}", None),
        ]
        note = (
            "Intervals by bootstrap over policies. A rank violation is the difference in physics of two policies that "
            "the two worlds rank differently."
        )
        title = f"Agreement over {agreement.policies} policies"
        blocks.append(
            DataTable(numbers("figure", "value", "95 % interval"), agreement_rows, title, note)
        )
    lead = "Does a policy that does better in the grid world also do better in physics?"
    return [Section("policies", "Policies in both worlds", lead, blocks)]


def _estimate_cells(estimate: Estimate) -> tuple[Value, Value]:
    if estimate.value is None:
        return "not defined", None
    return f"{estimate.value:.3f}", bounds_text(estimate, 3)


def bounds_text(estimate: Estimate, digits: int = 2) -> str:
    """Return the bounds of an estimate's interval."""
    texts = []
    for bound in (estimate.low, estimate.high):
        if bound is None:
            texts.append("?")
        else:
            texts.append(f"{bound:.{digits}f}")
    return " to ".join(texts)


def difference_text(paired: PairedTrials, first: str, second: str) -> str:
    """Return the difference of the shares of trials that agree, with the least detectable difference."""
    difference = paired.difference
    if difference.value is None or difference.low is None or difference.high is None:
        return "There are no pairs."
    text = (
        f"Share of trials that agree, {second} minus {first}: {100 * difference.value:+.1f} points (95 % interval "
        f"{100 * difference.low:+.1f} to {100 * difference.high:+.1f}); the least detectable difference is "
        f"{100 * paired.least_detectable:.1f} points."
    )
    if paired.differ:
        return text
    return f"{text} The difference is not significant."


def arms_table(
    changed: PairedTrials, actions: PairedActions, control: ControlArm | None
) -> DataTable:
    """Return what differs between two runs beside what differs by chance, in the control arm."""
    rows = [("changed", *_arm_cells(changed, actions))]
    note = (
        "Difference: of the share of trials that agree; detectable: the least one; then the medians of by how much "
        "durations, errors and peak forces differ. "
    )
    if control is None:
        note += (
            "There is no control arm with --no-control, nor of a run whose trials are alike, single or ended by their "
            "outcomes."
        )
    else:
        rows.append(("nothing changed", *_arm_cells(control.trials, control.actions)))
        note += "Nothing changed: each trial of the first run beside its next one of the same plan or policy and world."
        if control.trials.differ:
            note += " They differ significantly, so that trials are no independent draws, and no interval holds."
    columns = (
        "arm",
        "pairs",
        "difference, % (95 %)",
        "detectable, %",
        "durations, %",
        "errors, %",
        "forces, %",
    )
    return DataTable(numbers(*columns), rows, "Control arm", note)


def _arm_cells(paired: PairedTrials, actions: PairedActions) -> tuple[Value, ...]:
    difference = paired.difference
    if difference.value is None or difference.low is None or difference.high is None:
        return (0, *["-"] * 5)
    bounds = f"{100 * difference.low:+.1f} to {100 * difference.high:+.1f}"
    changes = []
    for ratio in (actions.duration_ratio, actions.error_ratio, actions.peak_force_ratio):
        if ratio is None:
            changes.append("-")
        else:
            changes.append(f"{100 * (ratio - 1):+.1f}")
    return (
        paired.pairs,
        f"{100 * difference.value:+.1f} ({bounds})",
        f"{100 * paired.least_detectable:.1f}",
        *changes,
    )


def paired_sections(comparison: Comparison | None) -> list[Section]:
    """Return the paired comparison with a baseline run; empty without one."""
    if comparison is None:
        return []
    trials = comparison.trials
    blocks: list[Block] = [
        DataTable(
            numbers("agrees with the rules in", "trials"),
            [
                ("both runs", trials.both),
                ("the earlier run alone", trials.only_first),
                ("this run alone", trials.only_second),
                ("neither", trials.neither),
            ],
            f"{trials.pairs:,} pairs",
            f"McNemar's exact test, two-sided: p = {trials.p_value:.3g}. {trials.unpaired:,} trials of only one of the "
            "runs are left out.",
        ),
        DataTable(
            (Column("run"), *SHARE_COLUMNS),
            [
                ("earlier run", *share_cells(trials.first)),
                ("this run", *share_cells(trials.second)),
            ],
            "Trials that agree",
            difference_text(trials, "the earlier run", "this run"),
        ),
        arms_table(trials, comparison.actions, comparison.control),
        changes_table(comparison.changed, "earlier run", "this run"),
    ]
    lead = f"The same trials under other settings, in {comparison.against}."
    return [Section("paired", "Two settings", lead, [*blocks, str(comparison.actions)])]


def changes_table(changed: Mapping[str, tuple[Any, Any]], first: str, second: str) -> DataTable:
    """Return a table of the settings that differ between two runs."""
    return DataTable(
        (Column("setting", "path"), Column(first, "path"), Column(second, "path")),
        [(name, _text(before), _text(after)) for name, (before, after) in changed.items()],
        "What differs",
        folded=True,
    )


def comparison_notes(comparison: Comparison | None) -> list[str]:
    """Return the paired comparison in short."""
    if comparison is None:
        return []
    notes = [str(comparison), difference_text(comparison.trials, "there", "here")]
    if comparison.control is not None:
        chance = difference_text(comparison.control.trials, "the first of a pair", "the second")
        notes.append(f"Control arm, pairs between which nothing is changed: {chance}")
    return notes


def identical_notes(identical: int) -> list[str]:
    """Return a note on trials that repeat another one, if any."""
    if not identical:
        return []
    trials = "1 trial repeats another one"
    if identical != 1:
        trials = f"{identical:,} trials repeat another one"
    return [
        f"Note: {trials}, as nothing is drawn at random; identical trials are run and counted once."
    ]


def run_notes(capped_steps: int, retried: int) -> list[str]:
    """Return notes on unconverged physics steps and repeated actions, if any."""
    notes = []
    if capped_steps:
        notes.append(f"Note: {capped_text(capped_steps)}; failures there are reported as numerics.")
    if retried:
        actions = "1 action was"
        if retried != 1:
            actions = f"{retried} actions were"
        notes.append(f"Note: {actions} tried again; the last try counts.")
    return notes


def measurement_headline(sentence: str, lost: int) -> Headline:
    """Return the headline of a measurement; ``lost`` trials have no result."""
    if not lost:
        return Headline("Measured", Tone.PLAIN, f"{sentence}.")
    sentence += f"; {lost} without a result, which --resume tries again."
    return Headline("Measured", Tone.CAUTION, sentence)


def provenance_section(command: str, seed: int, config: Mapping[str, Any]) -> Section:
    """Return a section with thresholds, configuration (with the ``setup`` of the physics) and versions."""
    setup = config["setup"]
    brief = {key: value for key, value in config.items() if key not in ("setup", "thresholds")}
    run = {
        "command": command,
        "seed": seed,
        **brief,
        "gains": setup.gains,
        "machines": setup.machines,
    }
    described = {("Thresholds", "threshold"): setup.thresholds, ("Run", "setting"): run}
    described[("Versions", "package")] = versions()
    data_tables = []
    for (title, name), values in described.items():
        data_tables.append(
            DataTable(
                (Column(name, "path"), Column("value", "path")),
                list(flattened(json_value(values))),
                title,
            )
        )
    return Section(
        "provenance",
        "Thresholds and provenance",
        "The thresholds were fixed before the run. On one machine the same seed, configuration and versions give "
        "the same page, byte for byte.",
        data_tables,
    )


def flattened(value: Any, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the leaves of nested mappings with dotted names."""
    if isinstance(value, list) and value and isinstance(value[0], Mapping):
        value = dict(enumerate(value))
    if isinstance(value, Mapping) and value:
        for key, item in value.items():
            name = str(key)
            if prefix:
                name = f"{prefix}.{key}"
            yield from flattened(item, name)
    elif isinstance(value, list):
        yield prefix, ", ".join(map(_text, value)) or "none"
    elif value == {}:
        yield prefix, "none"
    else:
        yield prefix, _text(value)


def _text(value: Any) -> str:
    if value is None:
        return "none"
    return str(value)
