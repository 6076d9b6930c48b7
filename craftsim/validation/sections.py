"""Sections that reports on runs and trials share: every failure, what each action did, smallest worlds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any, Final

from craftsim.checking.attempt import Attempt, Verdict
from craftsim.experiments.bundle import FILM, TRAJECTORY
from craftsim.experiments.experiment import TrialRecord
from craftsim.experiments.sections import TONES
from craftsim.rendering.trajectory import SUFFIX
from craftsim.reports.report import (
    Block,
    Case,
    Cases,
    Cell,
    Column,
    DataTable,
    Group,
    Section,
    Tone,
    Value,
    count,
)
from craftsim.validation.minimize import ACTIONS, BLUEPRINT, Counterexample

MOST_FAILURES: Final = 1000
MOST_PLANS: Final = 20
_ON_TERMINAL: Final = 20

REPLAY: Final = (
    "Replay, from the folder of this report: craftsim replay BUNDLE. The first failure of a run, of an action that the "
    "rules allow, has a bundle; what fails after it starts from the world that it left."
)

_LENGTHS: Final = ("car_error_m", "placed_error_m", "bystander_displacement_m")


def case_of(
    title: str, result: str, tone: Tone, reason: str, bundle: str = "", differences: Any = ()
) -> Case:
    """Return a failure with the files of its replay bundle."""
    film, trajectory = ((f"{bundle}/{name}" if bundle else "") for name in (FILM, TRAJECTORY))
    again = ("craftsim", "replay", Path(bundle)) if bundle else ()
    return Case(title, result, tone, reason, tuple(differences), again, film, trajectory)


Row = tuple[Value, ...]


def failure(run: str, attempt: Mapping[str, Any] | None, error: str = "", kept: str = "") -> tuple[Row, Case]:
    """Return a failed action, or a run that did not finish, as a row of :func:`failures_section` and in detail.

    There is no ``attempt`` if the run as a whole failed, with an ``error``. ``kept`` is the file that shows it,
    relative to the report's folder: the replay bundle of a run's first failure of a legal action, or the trajectory of
    a demonstration.
    """
    if attempt is None:
        row = (run, None, None, None, Cell("error", Tone.MUTED), None, error, kept or None)
        return row, case_of(run, "error", Tone.MUTED, error)
    result = str(attempt["result"]) if attempt["legal"] else "not tried"
    tone, reason = TONES[Verdict(attempt["result"])], attempt["reason"]
    known = [attempt[name] for name in _LENGTHS if attempt[name] is not None]
    off = f"{1e3 * max(known):.2f}" if attempt["performed"] and known else None
    tick, car, action = str(attempt["tick"]), str(attempt["car"]), attempt["action"]
    title = f"{run}: tick {tick}, car {car} {action}"
    case = case_of(title, result, tone, reason, kept, attempt["differences"])
    if kept.endswith(SUFFIX):
        again = ("craftsim", "render", Path(kept))
        case = replace(case, again=again, film=str(Path(kept).with_suffix(".mp4")), trajectory="")
    return (run, tick, car, action, Cell(result, tone), off, reason, kept or None), case


def failures_of(records: Iterable[TrialRecord]) -> Iterator[tuple[Row, Case]]:
    """Yield all that failed, in the order of the records."""
    for record in records:
        if record["error"] is not None:
            yield failure(record["key"], None, record["error"])
            continue
        bundle = record["bundle"] or ""
        for attempt in record["attempts"]:
            if attempt["result"] != Verdict.AS_PREDICTED:
                own = bundle if attempt["legal"] else ""
                yield failure(record["key"], attempt, kept=own)
                bundle = "" if own else bundle


def failures_section(
    found: Iterator[tuple[Row, Case]], errors: Sequence[Block] = (), note: str = REPLAY
) -> Section:
    """Return a section of every failure: the first in detail, then all in a table; ``errors`` come after it."""
    listed = list(islice(found, MOST_FAILURES))
    more = sum(1 for _ in found)
    columns = (
        *(Column("run", "path"), Column("tick", "number"), Column("car", "number")),
        *(Column("action"), Column("result")),
        Column("mm off", "number", "of the car, of what it set down, or of what it does not concern"),
        *(Column("cause", "wide"), Column("replay", "path", "what shows it again")),
    )
    note += f" {count(more, 'more failure')}: in trials.jsonl." if more else ""
    filmed = [case for number, (row, case) in enumerate(listed) if not number or row[-1]]
    rows = [row for row, _ in listed]
    table = DataTable(columns, rows, "All failures", note, tall=True, most=_ON_TERMINAL)
    blocks: list[Block] = [Cases(filmed, unfilmed=1), table if listed else "None.", *errors]
    title = f"Failures: {len(listed) + more:,}" if listed else "Failures"
    lead = "Each action that did not go as predicted, and each run that did not finish; the first in detail."
    return Section("failures", title, lead, blocks, terminal=bool(listed))


def actions_table(attempts: Iterable[Attempt], title: str = "Action by action") -> DataTable:
    """Return a table with a row for each action: what the rules predict, and what was read from poses."""
    columns = (
        *(Column("tick", "number"), Column("car", "number"), Column("action"), Column("predicted")),
        *(Column("read"), Column("result")),
        *(Column(unit, "number") for unit in ("s", "mm", "mrad")),
        Column("reason", "wide", terminal=False),
    )
    rows: list[tuple[Value, ...]] = []
    for one in attempts:
        result = "agrees" if one.agrees else one.result if one.legal else "not tried"
        errors = (one.duration_s, 1e3 * one.car_error_m, 1e3 * one.heading_error_rad)
        read = "same" if one.read == one.predicted else one.read
        cell, shown = Cell(result, TONES[Verdict(one.result)]), (f"{error:.2f}" for error in errors)
        rows.append((str(one.tick), str(one.car), one.action, one.predicted, read, cell, *shown, one.reason))
    note = "Predicted by the rules, read from poses: cell, heading, load, low or high on a slope; mm, mrad: of the car."
    return DataTable(columns, rows, title, note, tall=True, most=400)


def actions_section(runs: Iterable[tuple[str, Sequence[Attempt]]], total: int) -> Section:
    """Return a section of what each action did; ``runs`` are names and attempts, and only one alone is printed."""
    title = "Action by action"
    lead = "What the rules predict of each action, and what was read from poses after it."
    if total == 1:
        tables = [actions_table(attempts) for _, attempts in runs]
        return Section("actions", title, lead, tables, terminal=True)
    blocks: list[Block] = []
    for name, attempts in islice(runs, MOST_PLANS):
        wrong = sum(not attempt.agrees for attempt in attempts)
        badge = (count(wrong, "failure"), Tone.CAUTION) if wrong else ("", Tone.PLAIN)
        blocks.append(Group(name, [actions_table(attempts, "")], *badge))
    blocks += [f"{count(total - MOST_PLANS, 'more run')}: in trials.jsonl."] if total > MOST_PLANS else []
    return Section("actions", title, lead, blocks)


def smallest_section(found: Sequence[Counterexample]) -> list[Section]:
    """Return failures in their smallest worlds; nothing where none was shrunk."""
    if not found:
        return []
    title = f"Smallest worlds: {count(len(found), 'kind')} of failure"
    lead = "The first failure of each kind, with all taken away that it does not need. Try it again from this folder."
    return [Section("smallest", title, lead, [Cases([*map(_smallest, found)], most=40)], terminal=True)]


def _smallest(one: Counterexample) -> Case:
    if one.folder is None or one.cells is None:
        return Case(one.key, "not made smaller", Tone.MUTED, one.sentence)
    left = "" if one.minimal else "; perhaps not the smallest: the trials were used up"
    size = " x ".join(map(str, one.cells))
    folder, rules = Path(one.folder), ("--rules", one.rules) if one.rules != "physical" else ()
    again = ("craftsim", "validate", folder / BLUEPRINT, "--actions", folder / ACTIONS, *rules)
    reason = f"{size} cells, of {one.key}; {one.trials} trials{left}"
    return Case(one.sentence, "smallest world", Tone.CAUTION, reason, again=again)
