"""The results of a tuning: its report, and the file of gains with its provenance."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from craftsim.experiments.intervals import least_detectable
from craftsim.experiments.report_parts import provenance_section
from craftsim.reports.json_file import document, versions
from craftsim.reports.plots import ACCENT, BAD, GOOD, MUTED, SOFT, rows_height_in
from craftsim.reports.report import (
    Block,
    Column,
    DataTable,
    Drawing,
    Headline,
    KeyFigure,
    Report,
    Section,
    TableCell,
    Tone,
    count,
)
from craftsim.skills.gains import SECTIONS
from craftsim.storage.writing import write_whole
from craftsim.tuning.goal import OBJECTIVES, TuningObjective, TuningScore
from craftsim.tuning.tunable import FIXED
from craftsim.tuning.tune import GAINS_FILE, PLANS, TUNE_COMMAND, Ratio, Tuning

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def tune_report(tuned: Tuning, gains: Path, command: str, workers: int) -> Report:
    """Return the report of a tuning, by a command and some workers, that wrote a file of ``gains``."""
    gain_figures = {}
    for gain in tuned.tunable:
        down, up = tuned.sensitivity[gain.name]
        gain_figures[gain.name] = {
            "before": gain.start,
            "after": gain.of(tuned.gains),
            "least": gain.low,
            "most": gain.high,
            "sensitivity": {"down": down, "up": up},
        }
    figures = {
        "verdict": tuned.verdict,
        "gains": gain_figures,
        "plans": [{"values": check.values, "failed": check.failed} for check in tuned.plans],
        "refused": len(tuned.refused),
        "candidates_needed": tuned.n_needed,
        "finalists": [{"values": values, "score": score} for values, score in tuned.finalists],
        "convergence": convergence(tuned),
        "kept": FIXED,
    }
    wall = {"total_s": tuned.wall_s, "workers": workers}
    provenance = provenance_section(command, tuned.seed, tuned.config)
    return Report(
        "Tuning of gains",
        f"{tuned.config['subject']}: {tuned.goal}",
        _headline(tuned),
        _key_figures(tuned),
        [_gains(tuned), _verdict(tuned), _search(tuned), provenance],
        files={"Gains": gains},
        document=document(
            figures, command=TUNE_COMMAND, seed=tuned.seed, config=tuned.config, wall=wall
        ),
        exit_code=0 if tuned.verdict.improved else 1,
    )


def _factors(tuned: Tuning) -> list[float]:
    """Return each candidate's product on the search's seeds, as a factor of the start's."""
    costs = [score.log_cost(tuned.goal.weights) for _, score in tuned.searched]
    return [math.exp(cost - costs[0]) for cost in costs]


def convergence(tuned: Tuning) -> list[float]:
    """Return the best product so far after each candidate, as a factor of the start's, on the search's seeds."""
    return [*accumulate(_factors(tuned), min)]


def _change(factor: float) -> str:
    return f"{100 * (factor - 1):+.1f} %"


def _interval(ratio: Ratio) -> str:
    return f"95 % interval {_change(ratio.low)[:-2]} to {_change(ratio.high)}"


def _detectable(ratio: Ratio) -> str:
    """Return the least change for the better that as many trials would tell from none."""
    return _change(math.exp(-least_detectable(math.log(ratio.low), math.log(ratio.high))))


def _headline(tuned: Tuning) -> Headline:
    verdict = tuned.verdict
    ratio = verdict.against_start
    seeds = f"on {count(verdict.before.trials, 'action')} of held-out seeds"
    failed = f"{verdict.after.failed} failed, and {verdict.before.failed} before."
    change = f"the product of the objectives changes by {_change(ratio.factor)}"
    if not verdict.improved:
        sentence = (
            f"Nothing better than the start was found, {seeds}; gains.yaml holds the start's gains."
        )
        if tuned.refused:
            failed_plans: list[str] = []
            for check in tuned.refused:
                failed_plans += check.failed
            plans = ", ".join(dict.fromkeys(failed_plans))
            sentence += f" {count(len(tuned.refused), 'finalist')} failed in whole plans: {plans}."
        if 2 * tuned.n_search < tuned.n_needed:
            sentence += f" A search in {len(tuned.tunable)} dimensions needs about {tuned.n_needed} candidates."
        return Headline("Not better", Tone.CAUTION, sentence)
    if ratio.high < 1:
        sentence = f"{change.capitalize()} from the start ({_interval(ratio)}), {seeds}; {failed}"
        return Headline("Better", Tone.GOOD, sentence)
    sentence = (
        f"No difference from the start shows, {seeds}: {change}, {_interval(ratio)}, and the least detectable change "
        f"is {_detectable(ratio)}. {failed} gains.yaml holds the gains that did better here."
    )
    return Headline("Not shown to be better", Tone.CAUTION, sentence)


def _key_figures(tuned: Tuning) -> list[KeyFigure]:
    verdict = tuned.verdict
    before = verdict.before
    after = verdict.after
    ratio = verdict.against_start
    shipped = verdict.against_shipped
    margin_left = f"{100 * after.margin_left:.0f} %"
    had = f"{100 * before.margin_left:.0f} %"
    return [
        KeyFigure(_change(ratio.factor), "against the start", _interval(ratio)),
        KeyFigure(_change(shipped.factor), "against the shipped gains", _interval(shipped)),
        KeyFigure(_detectable(ratio), "least detectable change", "in four of five repetitions"),
        KeyFigure(
            f"{after.values['time']:.2f} s", "an action", f"{before.values['time']:.2f} s before"
        ),
        KeyFigure(margin_left, "margin left at the worst trial", f"{had} before"),
    ]


def _columns(first: Column, *numbers: str) -> tuple[Column, ...]:
    return first, *(Column(name, "number") for name in numbers)


def _verdict(tuned: Tuning) -> Section:
    verdict = tuned.verdict
    scores = (verdict.before, verdict.after, verdict.shipped)
    against = {"the start": verdict.against_start, "the shipped gains": verdict.against_shipped}
    differences = []
    for version, ratio in against.items():
        difference = f"from {version} {_change(ratio.factor)}, {_interval(ratio)}"
        differences.append(f"{difference}, least detectable change {_detectable(ratio)}")
    rows: list[tuple[Any, ...]] = []
    for name, meaning in OBJECTIVES.items():
        values = [f"{score.values[name]:.4g}" for score in scores]
        rows.append((f"{name}: {meaning}", *values))
    failed = []
    for score in scores:
        tone = Tone.PLAIN
        if score.failed:
            tone = Tone.BAD
        failed.append(TableCell(f"{score.failed}", tone))
    rows.append(("failed", *failed))
    blocks: list[Block] = [
        DataTable(
            _columns(Column("objective"), "before", "after", "shipped"),
            rows,
            f"On held-out seeds, {verdict.before.trials:,} actions each",
            f"Product of the objectives: {'; '.join(differences)}. Control arm, the start against itself on other "
            f"seeds: {_change(verdict.control.factor)}, {_interval(verdict.control)}.",
        )
    ]
    blocks.append(_plans(tuned))
    failures = []
    for version, failure in tuned.failures:
        failures.append((version, failure["situation"], str(failure["block"])))
    if failures:
        columns = Column("gains"), Column("situation", "path"), Column("block", "number")
        note = "A block is one trial of every situation: its own place, physics and noise, drawn by the seed."
        blocks.append(DataTable(columns, failures, f"Failures: {len(failures)}", note))
    lead = "On seeds that had no part in the search or the choice; the same ones for all three."
    return Section("verdict", "Verdict", lead, blocks, terminal=True)


def _plans(tuned: Tuning) -> DataTable:
    """Return which whole plans failed with the start and with the best finalists."""
    names = ["start", *(f"finalist {number}" for number in range(1, len(tuned.plans)))]
    rows = []
    for name, check in zip(names, tuned.plans, strict=True):
        failed = ", ".join(check.failed)
        rows.append((name, f"{len(PLANS) - len(check.failed)} of {len(PLANS)}", failed))
    columns = Column("gains"), Column("plans as predicted", "number"), Column("failed in")
    note = "A finalist that fails in a plan in which the start does not is refused."
    return DataTable(columns, rows, "Whole plans", note)


def _gains(tuned: Tuning) -> Section:
    effects = [tuned.sensitivity[gain.name] for gain in tuned.tunable]
    rows = []
    for gain, effect in zip(tuned.tunable, effects, strict=True):
        values = gain.start, gain.of(tuned.gains), gain.low, gain.high
        texts = [f"{value:.4g}" for value in values]
        rows.append((gain.name, *texts, *map(_change, effect)))
    table = DataTable(
        _columns(Column("gain", "path"), "before", "after", "least", "most", "down", "up"),
        rows,
        "Tuned",
        "Units: docs/reference/gains.md. Down, up: change of the product of the objectives where a gain is turned.",
    )

    def draw(axes: Axes) -> None:
        for y, (down, up) in enumerate(effects):
            for value, offset, colour in ((down, -0.16, SOFT), (up, 0.16, ACCENT)):
                # A failure costs far more than all else that is drawn.
                change = min(100 * (value - 1), 20.0)
                axes.barh(y + offset, change, height=0.3, color=colour if value < 1.2 else BAD)
        axes.set_yticks(range(len(effects)), [gain.name for gain in tuned.tunable])
        axes.invert_yaxis()
        axes.set_xlabel("change of the product in %: grey turned down, coloured turned up")

    caption = "What each gain does around the result, cut off at 20 %."
    drawing = Drawing.of_axes(
        draw, rows_height_in(len(effects)), caption, "sensitivity of each gain"
    )
    columns = (Column("gain", "path"), Column("why it is not tuned"))
    fixed = DataTable(columns, list(FIXED.items()), "Not tuned", folded=True, most=0)
    lead = (
        "Before and after, the bounds of the search, and by how many per cent the product of the objectives changes "
        "where a gain of the result is turned by a tenth of its range in logarithms."
    )
    return Section("gains", "Gains", lead, [table, drawing, fixed], terminal=True)


def _search(tuned: Tuning) -> Section:
    def converging(axes: Axes) -> None:
        best = convergence(tuned)
        top = max(1.2, 2 - min(best))
        factors = [min(factor, top) for factor in _factors(tuned)]
        axes.plot(range(len(factors)), factors, ".", color=MUTED, ms=3, label="candidate")
        axes.step(range(len(best)), best, where="post", color=ACCENT, lw=1.8, label="best so far")
        axes.axhline(1.0, color=SOFT, lw=0.8)
        axes.set_ylim(min(best) - 0.05, top + 0.02)
        axes.set_xlabel("candidates")
        axes.set_ylabel("product, start = 1")
        axes.legend(loc="upper right")

    first, second = (*tuned.goal.objectives, *OBJECTIVES)[:2]

    def front(axes: Axes) -> None:
        good = [score for _, score in tuned.searched if not score.failed]
        finals = [score for _, score in tuned.finalists]
        x, y = _plotted(good, first, second)
        axes.plot(x, y, ".", color=MUTED, ms=3, label="candidate")
        ordered = sorted(finals, key=lambda score: (score.values[first], score.values[second]))
        x, y = _plotted(ordered, first, second)
        axes.plot(x, y, "o-", color=ACCENT, ms=5, lw=1, label="front, fresh seeds")
        x, y = _plotted(finals[:1], first, second)
        axes.plot(x, y, "D", color=GOOD, ms=8, label="chosen")
        axes.set_xlabel(OBJECTIVES[first])
        axes.set_ylabel(OBJECTIVES[second])
        axes.legend(loc="upper right")

    caption = "Each candidate's product, and the best so far."
    blocks: list[Block] = [Drawing.of_axes(converging, 2.9, caption, "convergence of the search")]
    if tuned.goal.front:
        caption = "The first two objectives of candidates that never failed, and the finalists' front on fresh seeds."
        blocks.append(Drawing.of_axes(front, 3.4, caption, f"front of {first} and {second}"))
    rows: list[tuple[str | int, ...]] = []
    for number, (_, score) in enumerate(tuned.finalists, start=1):
        values = [f"{score.values[name]:.4g}" for name in OBJECTIVES]
        rows.append((str(number), *values, score.failed))
    title = "Finalists on fresh seeds, the chosen one first"
    blocks.append(DataTable(_columns(Column("finalist"), *OBJECTIVES, "failed"), rows, title))
    lead = "Candidates on the search's seeds, as factors of the start; failures included."
    return Section("search", "Search", lead, blocks)


def _plotted(
    scores: Sequence[TuningScore], first: TuningObjective, second: TuningObjective
) -> tuple[list[float], list[float]]:
    """Return the values of scores in two objectives."""
    x = [score.values[first] for score in scores]
    y = [score.values[second] for score in scores]
    return x, y


def write_gains(out: Path, tuned: Tuning, command: str) -> Path:
    """Write all gains, with comments on where they come from, as ``gains.yaml`` into a folder; return its path."""
    verdict = tuned.verdict
    config = tuned.config
    before = verdict.before
    after = verdict.after
    nothing = "Nothing better than the start was found: these are the gains that it began with."
    installed = ", ".join(f"{name} {version}" for name, version in versions().items())
    lines = [
        "Gains of the skills. Units are in craftsim/skills/gains.py.",
        f"Command: {json.dumps(command)}",
    ]
    if not verdict.improved:
        lines.append(nothing)
    lines += [
        f"Start: {json.dumps(config['setup'].gains.source)}, digest {config['digests']['gains']}",
        f"Goal: {tuned.goal}; seed {tuned.seed}; {config['evaluations']} candidates",
        f"Versions: {installed}",
        f"On seeds held out ({before.trials} actions each), before and after:",
    ]
    for name, value in before.values.items():
        lines.append(f"  {name}: {value:.4g}, {after.values[name]:.4g}")
    lines += [
        f"  failed: {before.failed}, {after.failed}",
        f"  product of the goal: {verdict.against_start.factor:.4f} times that of the start",
    ]
    sections = {name: asdict(getattr(tuned.gains, name)) for name in SECTIONS}
    comments = "".join(f"# {line}\n" for line in lines)
    return write_whole(out / GAINS_FILE, comments + yaml.safe_dump(sections, sort_keys=False))
