"""The results of a tuning: its report, and the file of gains with its provenance."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from craftsim.experiments.intervals import least_detectable
from craftsim.experiments.sections import provenance_section
from craftsim.reports.json_file import document, versions
from craftsim.reports.plots import ACCENT, BAD, GOOD, MUTED, SOFT, rows_height_in
from craftsim.reports.report import (
    Block,
    Cell,
    Column,
    DataTable,
    Drawing,
    Headline,
    KeyFigure,
    Report,
    Section,
    Tone,
    count,
)
from craftsim.skills.gains import SECTIONS
from craftsim.storage.writing import write_whole
from craftsim.tuning.goal import OBJECTIVES
from craftsim.tuning.tunable import FIXED
from craftsim.tuning.tune import COMMAND, GAINS_FILE, Ratio, Tuned

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_OF_THREE = ("before", "after", "shipped")


def tune_report(tuned: Tuned, gains: Path, command: str, workers: int) -> Report:
    """Return the report of a tuning.

    Args:
        tuned: its result.
        gains: the file of gains that it wrote.
        command: how it can be run again.
        workers: how many it took.
    """
    return Report(
        "Tuning of gains",
        f"{tuned.config['subject']}: {tuned.goal}",
        _headline(tuned),
        [*_key_figures(tuned)],
        [
            _gains(tuned),
            _verdict(tuned),
            _search(tuned),
            provenance_section(command, tuned.seed, tuned.config),
        ],
        files={"Gains": gains},
        document=document(
            figures(tuned),
            command=COMMAND,
            seed=tuned.seed,
            config=tuned.config,
            wall={"total_s": tuned.wall_s, "workers": workers},
        ),
        exit_code=0 if tuned.verdict.improved else 1,
    )


def figures(tuned: Tuned) -> dict[str, Any]:
    """Return what ``report.json`` holds of a tuning."""
    return {
        "verdict": tuned.verdict,
        "gains": {
            gain.name: {
                "before": gain.start,
                "after": gain.of(tuned.gains),
                "least": gain.least,
                "most": gain.most,
                "sensitivity": dict(zip(("down", "up"), tuned.sensitivity[gain.name], strict=True)),
            }
            for gain in tuned.tunable
        },
        "finalists": [{"values": values, "score": score} for values, score in tuned.finalists],
        "convergence": convergence(tuned),
        "kept": FIXED,
    }


def convergence(tuned: Tuned) -> list[float]:
    """Return the best product so far after each candidate, as a factor of the start's, on the search's seeds."""
    costs = [score.log_cost(tuned.goal.weights) for _, score in tuned.searched]
    return [math.exp(best - costs[0]) for best in accumulate(costs, min)]


def _change(factor: float) -> str:
    return f"{100 * (factor - 1):+.1f} %"


def _interval(ratio: Ratio) -> str:
    return f"95 % interval {_change(ratio.low)[:-2]} to {_change(ratio.high)}"


def _detectable(ratio: Ratio) -> str:
    """Return the least change for the better that as many trials would tell from none."""
    return _change(math.exp(-least_detectable(math.log(ratio.low), math.log(ratio.high))))


def _headline(tuned: Tuned) -> Headline:
    verdict = tuned.verdict
    ratio, seeds = verdict.against_start, f"on {count(verdict.before.trials, 'action')} of held-out seeds"
    failed = f"{verdict.after.failed} failed, and {verdict.before.failed} before."
    if not verdict.improved:
        sentence = f"Nothing better than the start was found, {seeds}; gains.yaml holds the start's gains."
        return Headline("Not better", Tone.CAUTION, sentence)
    if ratio.high < 1:
        sentence = f"The product of the objectives changes by {_change(ratio.factor)} from the start "
        sentence += f"({_interval(ratio)}), "
        return Headline("Better", Tone.GOOD, f"{sentence}{seeds}; {failed}")
    sentence = (
        f"No difference from the start shows, {seeds}: the product of the objectives changes by "
        f"{_change(ratio.factor)}, {_interval(ratio)}, and the least detectable change is {_detectable(ratio)}. "
        f"{failed} gains.yaml holds the gains that did better here."
    )
    return Headline("Not shown to be better", Tone.CAUTION, sentence)


def _key_figures(tuned: Tuned) -> Iterator[KeyFigure]:
    verdict = tuned.verdict
    before, after = verdict.before, verdict.after
    for ratio, what in (
        (verdict.against_start, "against the start"),
        (verdict.against_shipped, "against the shipped gains"),
    ):
        yield KeyFigure(_change(ratio.factor), what, _interval(ratio))
    yield KeyFigure(
        _detectable(verdict.against_start), "least detectable change", "in four of five repetitions"
    )
    time, was = after.values["time"], before.values["time"]
    yield KeyFigure(f"{time:.2f} s", "an action", f"{was:.2f} s before")
    left, had = 100 * after.margin_left, 100 * before.margin_left
    yield KeyFigure(f"{left:.0f} %", "margin left at the worst trial", f"{had:.0f} % before")


def _verdict(tuned: Tuned) -> Section:
    verdict = tuned.verdict
    scores = (verdict.before, verdict.after, verdict.shipped)
    note = "; ".join(
        f"from {what} {_change(ratio.factor)}, {_interval(ratio)}, least detectable change {_detectable(ratio)}"
        for what, ratio in (
            ("the start", verdict.against_start),
            ("the shipped gains", verdict.against_shipped),
        )
    )
    table = DataTable(
        (Column("objective"), *(Column(name, "number") for name in _OF_THREE)),
        [
            *(
                (f"{name}: {what}", *(f"{score.values[name]:.4g}" for score in scores))
                for name, what in OBJECTIVES.items()
            ),
            ("failed", *(Cell(f"{one.failed}", Tone.BAD if one.failed else Tone.PLAIN) for one in scores)),
        ],
        f"On held-out seeds, {verdict.before.trials:,} actions each",
        f"Product of the objectives: {note}.",
    )
    rows = [(name, one["situation"], str(one["block"])) for name, one in tuned.failures]
    failures = DataTable(
        (Column("gains"), Column("situation", "path"), Column("block", "number")),
        rows,
        f"Failures: {len(rows)}",
        "A block is one trial of every situation: its own place, physics and noise, drawn by the seed.",
    )
    blocks: list[Block] = [table, *([failures] if rows else [])]
    lead = "On seeds that had no part in the search or the choice; the same ones for all three."
    return Section("verdict", "Verdict", lead, blocks, terminal=True)


def _gains(tuned: Tuned) -> Section:
    effects = [tuned.sensitivity[gain.name] for gain in tuned.tunable]
    names = ("before", "after", "least", "most", "down", "up")
    table = DataTable(
        (Column("gain", "path"), *(Column(name, "number") for name in names)),
        [
            (
                gain.name,
                *(f"{value:.4g}" for value in (gain.start, gain.of(tuned.gains), gain.least, gain.most)),
                *map(_change, effect),
            )
            for gain, effect in zip(tuned.tunable, effects, strict=True)
        ],
        "Tuned",
        "down, up: change of the product of the objectives where a gain of the result is turned",
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
    drawing = Drawing.of_axes(draw, rows_height_in(len(effects)), caption, "sensitivity of each gain")
    columns = (Column("gain", "path"), Column("why it is not tuned"))
    kept = DataTable(columns, list(FIXED.items()), "Not tuned", folded=True, most=0)
    lead = (
        "Before and after, the bounds of the search, and by how many per cent the product of the objectives changes "
        "where a gain of the result is turned by a tenth of its range in logarithms."
    )
    return Section("gains", "Gains", lead, [table, drawing, kept], terminal=True)


def _search(tuned: Tuned) -> Section:
    caption = "Each candidate's product, and the best so far."
    blocks: list[Block] = [
        Drawing.of_axes(lambda axes: _converging(tuned, axes), 2.9, caption, "convergence of the search")
    ]
    if tuned.goal.front:
        first, second = tuned.goal.objectives[:2]
        caption = "The first two objectives of candidates that never failed, and the finalists' front on fresh seeds."
        label = f"front of {first} and {second}"
        blocks.append(Drawing.of_axes(lambda axes: _front(tuned, axes), 3.4, caption, label))
    blocks.append(
        DataTable(
            (Column("finalist"), *(Column(name, "number") for name in (*OBJECTIVES, "failed"))),
            [
                (str(number), *(f"{score.values[name]:.4g}" for name in OBJECTIVES), score.failed)
                for number, (_, score) in enumerate(tuned.finalists, start=1)
            ],
            "Finalists on fresh seeds, the chosen one first",
        )
    )
    lead = "Candidates on the search's seeds, as factors of the start; failures included."
    return Section("search", "Search", lead, blocks)


def _converging(tuned: Tuned, axes: Axes) -> None:
    """Draw what each candidate cost, and the best so far, as factors of the start."""
    weights = tuned.goal.weights
    costs = [score.log_cost(weights) for _, score in tuned.searched]
    each = [math.exp(cost - costs[0]) for cost in costs]
    best = convergence(tuned)
    top = max(1.2, 2 - min(best))
    shown = [min(one, top) for one in each]
    axes.plot(range(len(each)), shown, ".", color=MUTED, ms=3, label="candidate")
    axes.step(range(len(best)), best, where="post", color=ACCENT, lw=1.8, label="best so far")
    axes.axhline(1.0, color=SOFT, lw=0.8)
    axes.set_ylim(min(best) - 0.05, top + 0.02)
    axes.set_xlabel("candidates")
    axes.set_ylabel("product, start = 1")
    axes.legend(loc="upper right")


def _front(tuned: Tuned, axes: Axes) -> None:
    """Draw the first two objectives of all candidates, and of the finalists on fresh seeds."""
    first, second = tuned.goal.objectives[:2]
    good = [score.values for _, score in tuned.searched if not score.failed]
    finals = [score.values for _, score in tuned.finalists]
    ordered = sorted((values[first], values[second]) for values in finals)
    axes.plot([v[first] for v in good], [v[second] for v in good], ".", color=MUTED, ms=3, label="candidate")
    axes.plot(*zip(*ordered, strict=True), "o-", color=ACCENT, ms=5, lw=1, label="front, fresh seeds")
    axes.plot(finals[0][first], finals[0][second], "D", color=GOOD, ms=8, label="chosen")
    axes.set_xlabel(OBJECTIVES[first])
    axes.set_ylabel(OBJECTIVES[second])
    axes.legend(loc="upper right")


def write_gains(out: Path, tuned: Tuned, command: str) -> Path:
    """Write ``gains.yaml`` into a folder and return its path.

    It holds all gains, and in comments what they come from: command, seed, budget, versions, and the verdict.

    Raises InputError where the disk does not take it.
    """
    comments = "".join(f"# {line}\n" for line in _provenance(tuned, command))
    sections = {name: asdict(getattr(tuned.gains, name)) for name in SECTIONS}
    return write_whole(out / GAINS_FILE, comments + yaml.safe_dump(sections, sort_keys=False))


def _provenance(tuned: Tuned, command: str) -> Iterator[str]:
    verdict, config = tuned.verdict, tuned.config
    yield "Gains of the skills. Units are in craftsim/skills/gains.py."
    yield f"Command: {json.dumps(command)}"
    if not verdict.improved:
        yield "Nothing better than the start was found: these are the gains that it began with."
    yield f"Start: {json.dumps(config['setup'].gains.source)}, digest {config['digests']['gains']}"
    yield f"Goal: {tuned.goal}; seed {tuned.seed}; {config['evaluations']} candidates"
    installed = ", ".join(f"{name} {version}" for name, version in versions().items())
    yield f"Versions: {installed}"
    yield f"On seeds held out ({verdict.before.trials} actions each), before and after:"
    for name in verdict.before.values:
        yield f"  {name}: {verdict.before.values[name]:.4g}, {verdict.after.values[name]:.4g}"
    yield f"  failed: {verdict.before.failed}, {verdict.after.failed}"
    yield f"  product of the goal: {verdict.against_start.factor:.4f} times that of the start"
