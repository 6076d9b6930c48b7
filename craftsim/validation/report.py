"""The reports of a validation, of buildings with re-planning among them, and of a demonstration."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from craftsim.checking.attempt import AGREEING, Attempt, Verdict
from craftsim.checking.measurements import MEASUREMENTS, METRES, SUMMARIZED
from craftsim.experiments import report_parts as shared
from craftsim.experiments.bundle import FILM, RECORDING_FILE, TRAJECTORY_FILE
from craftsim.experiments.certificate import REPETITIONS, Certificate, Decision, plan_of_actions
from craftsim.experiments.experiment import TrialRecord
from craftsim.experiments.intervals import Proportion
from craftsim.experiments.minimize import ACTIONS_FILE, BLUEPRINT, Counterexample
from craftsim.experiments.report_parts import TONES
from craftsim.experiments.statistics import Figures, legal_attempts
from craftsim.mjcf.machines import Machines
from craftsim.rendering.trajectory import SUFFIX
from craftsim.reports.report import (
    SHARE_COLUMNS,
    Block,
    Case,
    Cases,
    Column,
    DataTable,
    Group,
    Headline,
    KeyFigure,
    Report,
    Section,
    TableCell,
    Tone,
    Value,
    count,
    interval,
    numbers,
    percent,
    share_cells,
)
from craftsim.validation.play import ALL, NEIGHBOURS

if TYPE_CHECKING:
    from pandas import DataFrame

    from craftsim.validation.episode import Episode
    from craftsim.validation.validation import Validation

_RENDER: Final = (
    "To watch it, from the folder of this report: craftsim render FILE, or craftsim view FILE."
)
_LEAD: Final = "Each action is predicted by the rules, carried out by motors, and judged on the poses afterwards."
MOST_FAILURES: Final = 1000
MOST_PLANS: Final = 20
_ON_TERMINAL: Final = 20

REPLAY: Final = (
    "Replay, from the folder of this report: craftsim replay BUNDLE. The first failure of a run, of an action that the "
    "rules allow, has a bundle; what fails after it starts from the world that it left."
)

_DEMONSTRATED: Final = ("car_error_m", "placed_error_m")
"""Of the largest errors of a demonstration, those that the terminal shows."""
_LENGTHS: Final = [row.name for row in SUMMARIZED if row.unit is METRES]
"""Of these the table of failures has the largest."""


def validation_report(result: Validation, command: str) -> Report:
    """Return the report of a validation; ``command`` is how it can be run again."""
    figures = result.figures
    records = result.records
    sections = _sections(result, command)
    notes = [
        *shared.identical_notes(figures.identical),
        *shared.run_notes(figures.capped_steps, figures.retried),
        *shared.comparison_notes(result.comparison),
        *_recovery_notes(result.recovery),
    ]
    if result.builds is not None and not result.certificates:
        return Report(
            "Building with re-planning",
            str(records[0]["context"]),
            _built(result.builds, len(records)),
            list(_build_figures(result.builds)),
            sections,
            notes,
            exit_code=int(not result.all_built),
        )
    worlds = ", ".join(result.config["worlds"])
    if result.certificates:
        return Report(
            "Certificate",
            worlds,
            _certified(result.certificates),
            list(_key_figures(figures)),
            sections,
            notes,
            exit_code=int(not result.all_certified),
        )
    sources = ", ".join(result.config["by"])
    return Report(
        "Validation in physics",
        f"{worlds}: {sources}",
        _headline(figures, records),
        list(_key_figures(figures)),
        sections,
        notes,
        exit_code=int(not result.agrees),
    )


def _sections(result: Validation, command: str) -> list[Section]:
    """Return the sections of a validation, what matters most first."""
    figures = result.figures
    records = result.records
    sections = []
    if result.certificates:
        sections.append(_certificates(result.certificates, result.config))
    if result.builds is not None:
        sections.append(_builds(records))
    else:
        sections.append(_results(figures, records, result.config))
    sections += _coverage(result.coverage)
    sections += shared.paired_sections(result.comparison)
    sections += smallest_section(result.smallest)
    if records:
        runs = ((record["key"], [*map(Attempt.of, record["attempts"])]) for record in records)
        sections.append(actions_section(runs, len(records)))
    sections.append(failures_section(failures_of(records), shared.error_tables(figures.errors)))
    if result.builds is None:
        sections.append(shared.survival_section(figures.survival))
        sections += shared.policies_section(figures)
    sections += [
        Section(
            "errors",
            "Errors and forces",
            "Where physics agrees with the rules, how far it is from them in numbers.",
            [
                shared.precision_table(figures.precision),
                *_thirds_tables(figures),
                shared.error_drawing(legal_attempts(records)),
            ],
        ),
        Section(
            "durations",
            "Durations",
            "What a planner can count on; by action, load, ground and level.",
            shared.duration_blocks(figures.durations),
        ),
        shared.provenance_section(command, result.seed, result.config),
    ]
    return sections


_DECISION_TONES: Final = {
    Decision.YES: Tone.GOOD,
    Decision.NO: Tone.BAD,
    Decision.UNDECIDED: Tone.CAUTION,
}


def _certified(certificates: Sequence[Certificate]) -> Headline:
    """Return how many plans and policies succeed as often as asked for."""
    first = certificates[0]
    decisions = Counter(certificate.decision for certificate in certificates)
    goal = f"{percent(first.required_rate)} of runs ({percent(first.confidence)} confidence)"
    n_yes = decisions[Decision.YES]
    if n_yes == len(certificates):
        subjects = "The plan or policy succeeds"
        if n_yes > 1:
            subjects = f"All {n_yes} plans or policies succeed"
        sentence = f"{subjects} in at least {goal}."
        return Headline("Certified", Tone.GOOD, sentence)
    sentence = (
        f"Success in at least {goal}: {n_yes} do, {decisions[Decision.NO]} do not, "
        f"{decisions[Decision.UNDECIDED]} undecided after all trials; --trials allows more."
    )
    if decisions[Decision.NO]:
        return Headline("Refused", Tone.BAD, sentence)
    return Headline("Undecided", Tone.CAUTION, sentence)


def _certificates(certificates: Sequence[Certificate], config: Mapping[str, Any]) -> Section:
    """Return the answers with their trials, what they assume, and what follows for repetitions."""
    rows: list[tuple[Value, ...]] = []
    for certificate in certificates:
        repeated = [f"{p:.3f}" for p in certificate.repetitions.values()]
        rows.append(
            (
                certificate.subject,
                TableCell(certificate.decision, _DECISION_TONES[Decision(certificate.decision)]),
                certificate.trials,
                certificate.successes,
                *repeated,
            )
        )
    repetitions = ["one run", *(f"{n} runs" for n in REPETITIONS[1:])]
    columns = (
        Column("world: plan or policy", "path"),
        Column("answer"),
        Column("runs", "number"),
        Column("successes", "number"),
        *(Column(name, "number") for name in repetitions),
    )
    first = certificates[0]
    note = (
        f"Each answer is wrong with a probability of at most {percent(1 - first.confidence)}, however often one looks. "
        "Last columns: the probability that so many independent runs all succeed, at least."
    )
    lead = (
        f"Do at least {percent(first.required_rate)} of runs succeed? It holds for runs drawn as these were: with the "
        f"randomization '{config['randomize']}', and starts as the world draws them."
    )
    return Section(
        "certificates", "Certificates", lead, [DataTable(columns, rows, note=note)], terminal=True
    )


def _thirds_tables(figures: Figures) -> list[DataTable]:
    """Return a table of how far off objects are set down in each third of the runs; nothing if a third has none."""
    rows: list[tuple[Value, ...]] = []
    for name, placed in figures.drift.items():
        if placed is None:
            return []
        rows.append((name, placed.n, f"{placed.median:.2f}", f"{placed.max:.2f}"))
    columns = numbers("third of the runs", "objects", "median, mm", "largest, mm")
    return [DataTable(columns, rows, "Objects set down, distance from their places")]


def _plan_length_table(figures: Figures) -> DataTable:
    """Return a table of how probable plans of several lengths are, if actions fail independently of each other."""
    legal = figures.matrix["legal"]
    rows = []
    for length in REPETITIONS:
        share = plan_of_actions(legal.as_predicted, legal.trials, length)
        rows.append((count(length, "action"), f"{100 * share:.3g}"))
    columns = numbers("length of a plan", "all as predicted: at least, %")
    note = (
        f"95 % confidence, of {legal.as_predicted:,} of {legal.trials:,} actions as predicted, if actions fail "
        "independently of each other."
    )
    return DataTable(columns, rows, "Longer plans", note)


def _headline(figures: Figures, records: Sequence[TrialRecord]) -> Headline:
    actions = figures.matrix["legal"]
    runs = figures.all["runs"]
    missed = actions.trials - actions.as_predicted
    errors = sum(figures.errors.values())
    lost = ""
    if errors:
        lost = f" {count(errors, 'more trial')} did not finish."
    if figures.not_standing:
        lost += f" {count(figures.not_standing, 'more world')} cannot stand, and nothing was tried there."
    if figures.without_actions:
        lost += f" {count(figures.without_actions, 'more run')} had no action to judge."
    if not runs.trials:
        return Headline("Nothing to judge", Tone.CAUTION, "No action was judged." + lost)
    if runs.successes == runs.trials:
        subject = f"All {runs.trials:,} runs"
        if runs.trials == 1:
            subject = "The run"
        sentence = f"{subject} did in physics what the rules predict."
        if errors:
            return Headline("Agrees", Tone.CAUTION, sentence + lost)
        return Headline("Agrees", Tone.GOOD, sentence + lost)
    with_forbidden = 0
    for record in records:
        with_forbidden += any(not a["legal"] for a in record["attempts"])
    if with_forbidden:
        lost += (
            f" {count(with_forbidden, 'run')} asked for what the rules forbid, which was not tried."
        )
    if not missed:
        sentence = f"The plan or policy breaks a rule.{lost} All else went as predicted."
        return Headline("Forbidden by the rules", Tone.CAUTION, sentence)
    refused = 0
    for record in records:
        refused += any(a["legal"] and _disagrees(a) for a in record["attempts"])
    sentence = (
        f"In {refused:,} of {count(runs.trials, 'run')} physics disagrees with the rules; "
        f"of {count(actions.trials, 'action')} that the rules allow, {missed:,} did not do what they predict."
    )
    return Headline("Disagrees", Tone.BAD, sentence + lost)


def _disagrees(attempt: Mapping[str, Any]) -> bool:
    return attempt["result"] not in AGREEING


def _key_figures(figures: Figures) -> Iterator[KeyFigure]:
    yield _share("runs that agree", figures.all["runs"])
    yield _share("actions as predicted", figures.all["actions"])
    car = figures.precision["car_error_mm"]
    if car:
        yield KeyFigure(
            f"{car.median:.2g} mm", "car's error, median", f"95 % within {car.p95:.2g} mm"
        )
    force = figures.precision["peak_force_n"]
    if force:
        yield KeyFigure(f"{force.max:.0f} N", "peak contact force", f"median {force.median:.0f} N")
    if figures.rank_agreement:
        yield KeyFigure(
            f"{figures.rank_agreement.mmrv:.2f}", "rank violation (MMRV)", "0 best, 1 worst"
        )


def _share(label: str, p: Proportion) -> KeyFigure:
    note = f"{p.successes:,} of {p.trials:,}; {interval(p.low, p.high)}"
    return KeyFigure(percent(p.rate), label, note)


def _results(
    figures: Figures, records: Sequence[TrialRecord], config: Mapping[str, Any]
) -> Section:
    blocks: list[Block] = [runs_table(records, _physics_note(config))]
    if len(figures.by_group) > 1:
        blocks.append(_group_table(figures))
    legality = shared.legality_table(figures.matrix)
    by_action = shared.results_table("By action", "action", figures.by_verb)
    # On the terminal, tables of runs and of failures say enough.
    blocks += [
        replace(legality, most=0),
        replace(by_action, most=0),
        replace(_plan_length_table(figures), most=0),
        shared.success_drawing(figures.by_verb),
    ]
    return Section("results", "Results", _LEAD, blocks, terminal=True)


def _group_table(figures: Figures) -> DataTable:
    """Return a table with a row for each plan or policy."""
    names = (
        "runs",
        "runs that agree",
        SHARE_COLUMNS[1].name,
        "actions",
        "actions as predicted",
        SHARE_COLUMNS[1].name,
    )
    columns = (Column("plan or policy", "path"), *(Column(name, "number") for name in names))
    rows = []
    for group, shares in figures.by_group.items():
        runs = shares["runs"]
        actions = shares["actions"]
        rows.append((group, runs.trials, *share_cells(runs), actions.trials, *share_cells(actions)))
    return DataTable(columns, rows, "By plan or policy", most=0)


def _physics_note(config: Mapping[str, Any]) -> str:
    """Return what the runs were carried out with, as a note below their table."""
    drive = config["setup"].machines.drive
    return f"Randomization '{config['randomize']}', drive '{drive}'; makespan: median, in simulated seconds."


def runs_table(records: Sequence[TrialRecord], note: str = "") -> DataTable:
    """Return a table with a row for each world and each plan or policy."""
    from pandas import DataFrame

    groups: Iterable[Any] = ()
    if records:
        frame = DataFrame(map(_run_figures, records))
        groups = frame.groupby(["world", "by"], sort=False)
    rows: list[tuple[Value, ...]] = []
    for (world, source), runs in groups:
        done = runs[runs.done]
        makespan = None
        if len(done):
            makespan = f"{done.makespan_s.median():.1f}"
        actions = int(done.actions.sum())
        rows.append((world, source, len(runs), actions, _verdict(runs, done), makespan))
    columns = (
        Column("world"),
        Column("plan or policy"),
        Column("runs", "number"),
        Column("actions", "number"),
        Column("verdict", "wide"),
        Column("makespan, s", "number"),
    )
    return DataTable(columns, rows, "Runs", note)


def _verdict(runs: DataFrame, done: DataFrame) -> TableCell:
    """Return what came of runs: as predicted or not, whether the goal is built, and what has no result."""
    lost = len(runs) - len(done)
    empty = int(done["empty"].sum())
    judged = len(done) - empty
    agree = int(done.agree.sum())
    broken = int(done.broken.sum())
    words = []
    tone = Tone.CAUTION
    if judged and agree == judged:
        words.append("as predicted")
        tone = Tone.GOOD
    elif judged and agree + broken == judged:
        words.append(f"rules broken in {broken} of {judged}")
    elif judged:
        words.append(f"{agree} of {judged} as predicted")
        tone = Tone.BAD
    if len(done):
        words += _goal_words(done)
    if empty:
        words.append(f"{empty} without an action to judge")
    if lost:
        words.append(f"{lost} without a result")
        tone = Tone.BAD
    return TableCell(", ".join(words), tone)


def _goal_words(done: DataFrame) -> list[str]:
    """Return whether runs have built their goal, in physics and, where that differs, by the rules."""
    reached = done.physics_success
    if reached.isna().any():
        return []
    built = int(reached.sum())
    if built == len(done):
        words = "goal built"
    elif built:
        words = f"goal built in {built}"
    else:
        words = "goal not built"
    by_rules = int(done.grid_success.sum())
    if by_rules != built:
        words += f" (by the rules in {by_rules})"
    return [words]


def _run_figures(record: TrialRecord) -> dict[str, Any]:
    attempts = record["attempts"]
    extra = record["extra"]
    done = record["error"] is None
    return {
        "world": record["context"] or "",
        "by": record["group"],
        "done": done,
        "agree": record["agrees"] and bool(attempts),
        "empty": done and not attempts,
        "broken": _breaks_rules_alone(attempts),
        "actions": len(attempts),
        "makespan_s": extra.get("makespan_s", 0.0),
        "physics_success": extra.get("physics_success"),
        "grid_success": extra.get("grid_success"),
    }


def _breaks_rules_alone(attempts: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether something did not go as predicted, and all of that is what the rules forbid."""
    wrong = [attempt for attempt in attempts if _disagrees(attempt)]
    return bool(wrong) and not any(attempt["legal"] for attempt in wrong)


def _coverage(coverage: Mapping[str, Any] | None) -> list[Section]:
    """Return what random play did, and how often beside what."""
    if coverage is None:
        return []
    totals = ", ".join(f"{n:,} {name}" for name, n in coverage["totals"].items())
    note = f"{coverage['actions']:,} actions in {coverage['worlds']:,} worlds: {totals}"
    if coverage["do_not_stand"]:
        note += f"; {coverage['do_not_stand']:,} more worlds cannot be, and nothing was tried there"
    names = (Column(name, "number", terminal=name == ALL) for name in (ALL, *NEIGHBOURS))
    rows = [
        (name, *(n or None for n in counts.values())) for name, counts in coverage["rows"].items()
    ]
    table = DataTable((Column("action, level, load"), *names), rows, "Coverage", note, tall=True)
    lead = "What random play has done, and how often beside what."
    return [Section("coverage", "Coverage", lead, [table], terminal=True)]


def _recovery_notes(recovery: Mapping[str, int] | None) -> list[str]:
    """Return what policies needed with recovery, as notes."""
    if recovery is None:
        return []
    runs = f"in {recovery['planner_runs']:,} of {count(recovery['runs'], 'run')}"
    plans = f"with {count(recovery['plans'], 'plan')}"
    went_back = f"cars went back {count(recovery['went_back'], 'time')}"
    seated = f"{count(recovery['seated'], 'load')} seated again"
    return [f"With recovery: the planner went on {runs}, {plans}; {went_back}; {seated}."]


def _built(builds: Mapping[str, Any], n: int) -> Headline:
    built = builds["endings"].get("built", 0)
    sentence = f"{built} of {n} buildings stand"
    if builds["replans"]:
        sentence += f"; {builds['replans']} further plans were made."
    else:
        sentence += "."
    if built == n:
        return Headline("Built", Tone.GOOD, sentence)
    if built:
        return Headline("Not all built", Tone.CAUTION, sentence)
    return Headline("Not all built", Tone.BAD, sentence)


def _build_figures(builds: Mapping[str, Any]) -> Iterator[KeyFigure]:
    yield _share("built", builds["built"])
    disturbed = f"{count(builds['disturbed'], 'building')} disturbed"
    went_back = f"cars went back {count(builds['went_back'], 'time')}"
    seated = f"{count(builds['seated'], 'load')} seated again"
    note = f"{disturbed}; {went_back}; {seated}"
    yield KeyFigure(f"{builds['replans']:,}", "further plans", note)
    for name, label in (("planned_s", "first plan's makespan"), ("real_s", "real makespan")):
        if builds[name] is not None:
            yield KeyFigure(f"{builds[name]:.1f} s", label, "median")


def _builds(records: Iterable[TrialRecord]) -> Section:
    rows: list[tuple[Value, ...]] = []
    for record in records:
        if record["error"] is not None:
            rows.append((record["key"], *[None] * 5, TableCell(record["error"], Tone.MUTED)))
            continue
        extra = record["extra"]
        attempts = record["attempts"]
        as_predicted = sum(not _disagrees(attempt) for attempt in attempts)
        ended = "; ".join(filter(None, (extra["ended"], extra["why"], extra["disturbed"])))
        if extra["ended"] == "built":
            tone = Tone.GOOD
        else:
            tone = Tone.BAD
        times = [f"{extra[key]:.1f}" for key in ("planned_s", "makespan_s")]
        rows.append(
            (
                record["key"],
                len(attempts),
                as_predicted,
                extra["replans"],
                *times,
                TableCell(ended, tone),
            )
        )
    columns = (
        *numbers("building", "actions", "as predicted", "replans", "planned, s", "in physics, s"),
        Column("verdict"),
    )
    note = "Simulated seconds: makespan of the first plan, and that in physics."
    table = DataTable(columns, rows, "Buildings", note)
    return Section("buildings", "Buildings", "One row for each building.", [table], terminal=True)


def demo_report(
    episodes: Sequence[Episode],
    command: str,
    document: Mapping[str, Any],
    films: Mapping[str, Path],
) -> Report:
    """Return the report of a demonstration; ``document`` is the content of ``report.json``, ``films`` are those of
    episodes, by the names of their tasks.
    """
    figures = [episode.figures for episode in episodes]
    agree = sum(episode.n_agree for episode in episodes)
    total = sum(episode.n_planned for episode in episodes)
    good = all(episode.succeeded for episode in episodes)
    endings = [episode.ending for episode in episodes if episode.ending is not None]
    if good:
        badge = "Built" if endings else "Agrees"
        tone = Tone.GOOD
    else:
        badge = "Disagrees"
        if endings or agree == total:
            badge = "Goal missed"
        tone = Tone.BAD
    key_figures = [_share("actions as predicted", Proportion.of(agree, total))]
    makespan_s = sum(measured["makespan_s"] for measured in figures)
    key_figures.append(KeyFigure(f"{makespan_s:.1f} s", "makespan, simulated"))
    for name, label in (
        ("car_error_m", "car's error, at worst"),
        ("placed_error_m", "set down off, at worst"),
    ):
        values = [measured[MEASUREMENTS[name].largest_name] for measured in figures]
        known_values = [value for value in values if value is not None]
        if known_values:
            key_figures.append(KeyFigure(f"{max(known_values):.2f} mm", label))
    sections = [
        _summary(episodes, figures),
        actions_section(((episode.name, episode.attempts) for episode in episodes), len(episodes)),
    ]
    failures = list(_failures_in(episodes))
    if failures:
        sections.append(failures_section(iter(failures), note=_RENDER))
    if films:
        cases = [_film(episode, films[episode.name]) for episode in episodes]
        sections.append(Section("films", "Films", "From the start to the end.", [Cases(cases)]))
    sections.append(shared.provenance_section(command, document["seed"], document["config"]))
    capped_steps = sum(measured["capped_steps"] for measured in figures)
    retried = sum(measured["retried"] for measured in figures)
    files: dict[str, str | Path] = {}
    for name, path in films.items():
        if len(films) > 1:
            files[f"Film of {name}"] = path
        else:
            files["Film"] = path
    return Report(
        "Demonstration",
        ", ".join(episode.name for episode in episodes),
        Headline(
            badge,
            tone,
            f"{agree} of {total} actions agree with the rules; {_goals_text(episodes)}.",
        ),
        key_figures,
        sections,
        [*shared.run_notes(capped_steps, retried), *map(_ending_note, endings)],
        files,
        document,
        int(not good),
    )


def _ending_note(ending: Mapping[str, str | float]) -> str:
    """Return how a building with replanning ended, and what that took."""
    ended = "; ".join(str(ending[key]) for key in ("ended", "why", "disturbed") if ending[key])
    plans = count(int(ending["replans"]), "further plan")
    return f"Replanning: {ended}; {plans}, {count(int(ending['seated']), 'load')} seated again."


def _goals_text(episodes: Sequence[Episode]) -> str:
    """Return whether the goals of episodes are reached, as a clause."""
    reached = [episode.reached for episode in episodes]
    if len(episodes) > 1:
        return f"{reached.count(True)} of {len(episodes)} goals are reached"
    words = {
        None: "no goal was given",
        True: "the goal is reached",
        False: "the goal is NOT reached",
    }
    return words[reached[0]]


def _failures_in(episodes: Iterable[Episode]) -> Iterator[tuple[_Row, Case]]:
    for episode in episodes:
        for attempt in episode.attempts:
            if not attempt.agrees:
                yield _failure(episode.name, asdict(attempt), file=f"{episode.name}{SUFFIX}")


def _summary(episodes: Sequence[Episode], figures: Sequence[Mapping[str, Any]]) -> Section:
    """Return a section with a row for each building."""
    goals = {None: "", True: ", goal built", False: ", goal not built"}
    rows = []
    for episode, measured in zip(episodes, figures, strict=True):
        if episode.succeeded:
            tone = Tone.GOOD
        else:
            tone = Tone.BAD
        verdict = f"{episode.n_agree} of {episode.n_planned} as predicted{goals[episode.reached]}"
        worst = []
        for row in SUMMARIZED:
            largest = measured[row.largest_name]
            if largest is not None:
                largest = f"{largest:.2f}"
            worst.append(largest)
        rows.append(
            (
                episode.name,
                measured["ticks"],
                TableCell(verdict, tone),
                f"{measured['makespan_s']:.1f}",
                *worst,
            )
        )
    note = "The largest errors."
    columns = [
        Column("task"),
        Column("ticks", "number"),
        Column("verdict"),
        Column("makespan, s", "number"),
    ]
    for row in SUMMARIZED:
        columns.append(Column(row.column, "number", terminal=row.name in _DEMONSTRATED))
    table = DataTable(columns, rows, "Built in physics, checked by the rules", note)
    return Section("buildings", "Buildings", _LEAD, [table], terminal=True)


def _film(episode: Episode, film: Path) -> Case:
    text = (
        f"{episode.makespan_s:.1f} s, {episode.n_agree} of {episode.n_planned} actions as predicted"
    )
    if episode.succeeded:
        result = ("built", Tone.GOOD)
    else:
        result = ("not as planned", Tone.BAD)
    return Case(episode.name, *result, text, film=film.name, trajectory=f"{episode.name}{SUFFIX}")


def case_of(
    title: str,
    result: str,
    tone: Tone,
    reason: str,
    bundle: str = "",
    differences: Iterable[str] = (),
) -> Case:
    """Return a failure with the files of its replay bundle, if it has one."""
    case = Case(title, result, tone, reason, tuple(differences))
    if not bundle:
        return case
    return replace(
        case,
        again=("craftsim", "replay", Path(bundle)),
        film=f"{bundle}/{FILM}",
        trajectory=f"{bundle}/{TRAJECTORY_FILE}",
        recording=f"{bundle}/{RECORDING_FILE}",
    )


_Row = tuple[Value, ...]


def _failure(
    run: str, attempt: Mapping[str, Any] | None, error: str = "", file: str = ""
) -> tuple[_Row, Case]:
    """Return a failed action, or a run that did not finish, as a row of :func:`failures_section` and in detail.

    There is no ``attempt`` if the run as a whole failed, with an ``error``. ``file`` is the one that shows it, relative
    to the report's folder: the replay bundle of a run's first failure of a legal action, or the trajectory of a
    demonstration.
    """
    row: _Row
    if attempt is None:
        row = (run, None, None, None, TableCell("error", Tone.MUTED), None, error, file or None)
        return row, case_of(run, "error", Tone.MUTED, error)
    result = "not tried"
    if attempt["legal"]:
        result = str(attempt["result"])
    tick = str(attempt["tick"])
    car = str(attempt["car"])
    action = attempt["action"]
    reason = attempt["reason"]
    tone = TONES[Verdict(attempt["result"])]
    title = f"{run}: tick {tick}, car {car} {action}"
    if file.endswith(SUFFIX):
        film = str(Path(file).with_suffix(".mp4"))
        case = case_of(title, result, tone, reason, differences=attempt["differences"])
        case = replace(case, again=("craftsim", "render", Path(file)), film=film)
    else:
        case = case_of(title, result, tone, reason, file, attempt["differences"])
    row = (
        run,
        tick,
        car,
        action,
        TableCell(result, tone),
        _error_mm(attempt),
        reason,
        file or None,
    )
    return row, case


def _error_mm(attempt: Mapping[str, Any]) -> str | None:
    """Return the largest error of a place after an attempt, in mm; None where none was measured."""
    lengths_m = [attempt[name] for name in _LENGTHS if attempt[name] is not None]
    if attempt["performed"] and lengths_m:
        return f"{1e3 * max(lengths_m):.2f}"
    return None


def failures_of(records: Iterable[TrialRecord]) -> Iterator[tuple[_Row, Case]]:
    """Yield all that failed, in the order of the records."""
    for record in records:
        if record["error"] is not None:
            yield _failure(record["key"], None, record["error"])
            continue
        bundle = record["bundle"] or ""
        for attempt in record["attempts"]:
            if attempt["result"] not in AGREEING:
                file = ""
                if attempt["legal"]:
                    file = bundle
                yield _failure(record["key"], attempt, file=file)
                if file:
                    bundle = ""


def failures_section(
    failures: Iterator[tuple[_Row, Case]], errors: Sequence[Block] = (), note: str = REPLAY
) -> Section:
    """Return a section of every failure: the first in detail, then all in a table; ``errors`` come after it."""
    listed = list(islice(failures, MOST_FAILURES))
    n_unlisted = sum(1 for _ in failures)
    columns = (
        Column("run", "path"),
        Column("tick", "number"),
        Column("car", "number"),
        Column("action"),
        Column("result"),
        Column(
            "off, mm", "number", "of the car, of what it set down, or of what it does not concern"
        ),
        Column("cause", "wide"),
        Column("replay", "path", "what shows it again"),
    )
    if n_unlisted:
        note += f" {count(n_unlisted, 'more failure')}: in trials.jsonl."
    title = "Failures"
    blocks: list[Block] = []
    if listed:
        title = f"Failures: {len(listed) + n_unlisted:,}"
        rows = [row for row, _ in listed]
        # In detail the first, and all others that have a file.
        cases = [case for number, (row, case) in enumerate(listed) if number == 0 or row[-1]]
        blocks.append(Cases(cases, unfilmed=1))
        blocks.append(DataTable(columns, rows, "All failures", note, tall=True, most=_ON_TERMINAL))
    else:
        blocks += [Cases([], unfilmed=1), "None."]
    blocks += errors
    lead = "Each action that did not go as predicted, and each run that did not finish; the first in detail."
    return Section("failures", title, lead, blocks, terminal=bool(listed))


def actions_table(attempts: Iterable[Attempt], title: str = "Action by action") -> DataTable:
    """Return a table with a row for each action: what the rules predict, and what was read from poses."""
    columns = (
        Column("tick", "number"),
        Column("car", "number"),
        Column("action"),
        Column("predicted"),
        Column("read"),
        Column("result"),
        Column("time, s", "number"),
        Column("off, mm", "number"),
        Column("turned, mrad", "number"),
        Column("reason", "wide", terminal=False),
    )
    rows: list[tuple[Value, ...]] = []
    for attempt in attempts:
        if attempt.agrees:
            result = "agrees"
        elif attempt.legal:
            result = attempt.result
        else:
            result = "not tried"
        read = "same"
        if attempt.read != attempt.predicted:
            read = attempt.read
        rows.append(
            (
                str(attempt.tick),
                str(attempt.car),
                attempt.action,
                attempt.predicted,
                read,
                TableCell(result, TONES[Verdict(attempt.result)]),
                f"{attempt.duration_s:.2f}",
                f"{1e3 * attempt.car_error_m:.2f}",
                f"{1e3 * attempt.heading_error_rad:.2f}",
                attempt.reason,
            )
        )
    note = "Cell, heading, load, low or high on a slope: predicted by the rules, read from poses. Off: the car."
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
        if wrong:
            badge = (count(wrong, "failure"), Tone.CAUTION)
        else:
            badge = ("", Tone.PLAIN)
        blocks.append(Group(name, [actions_table(attempts, "")], *badge))
    if total > MOST_PLANS:
        blocks += [f"{count(total - MOST_PLANS, 'more run')}: in trials.jsonl."]
    return Section("actions", title, lead, blocks)


def smallest_section(counterexamples: Sequence[Counterexample]) -> list[Section]:
    """Return failures in their smallest worlds; nothing where none was shrunk."""
    if not counterexamples:
        return []
    title = f"Smallest worlds: {count(len(counterexamples), 'kind')} of failure"
    lead = "The first failure of each kind, with all taken away that it does not need. Try it again from this folder."
    return [
        Section(
            "smallest",
            title,
            lead,
            [Cases([*map(_smallest, counterexamples)], most=40)],
            terminal=True,
        )
    ]


def _smallest(counterexample: Counterexample) -> Case:
    if counterexample.folder is None or counterexample.cells is None:
        return Case(counterexample.key, "not made smaller", Tone.MUTED, counterexample.sentence)
    if counterexample.minimal:
        doubt = ""
    else:
        doubt = "; perhaps not the smallest: the trials were used up"
    size = " x ".join(map(str, counterexample.cells))
    folder = Path(counterexample.folder)
    options: list[str | Path] = []
    if counterexample.rules != "physical":
        options = ["--rules", counterexample.rules]
    if counterexample.drive != Machines().drive:
        options += ["--drive", counterexample.drive]
    options += ["--randomize", "none", "--trials", "1"]
    command: tuple[str | Path, ...]
    command = (
        "craftsim",
        "validate",
        folder / BLUEPRINT,
        "--actions",
        folder / ACTIONS_FILE,
        *options,
    )
    if counterexample.bundle is not None:
        command = ("craftsim", "replay", Path(counterexample.bundle))
    reason = f"{size} cells, of {counterexample.key}; {counterexample.trials} trials{doubt}"
    return Case(counterexample.sentence, "smallest world", Tone.CAUTION, reason, again=command)
