"""Check the rules: ``craftsim audit``, ``audit margins``, ``audit clearance`` and ``conformance``."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from cyclopts import Group, Parameter

from craftsim.cli.app import CONFIG, command_again
from craftsim.cli.options import Dir, File, OptionalDir, PlayedChoice, Shown
from craftsim.cli.progress import counting, counting_kinds, without_error, working
from craftsim.discrete.kinds import RuleSetName
from craftsim.errors import CraftsimError, InputError, suggestion
from craftsim.experiments.ranges import RUNS, SUCCESS_RATE
from craftsim.reports.publishing import publish
from craftsim.reports.report import (
    Column,
    DataTable,
    Headline,
    KeyFigure,
    Report,
    Section,
    Tone,
    count,
    numbers,
)
from craftsim.storage.folders import output_directory, owning
from craftsim.storage.paths import exists
from craftsim.validation.options import (
    Physics,
    Randomization,
    RulesChoice,
    RulesName,
    TrialCount,
    Trials,
    number,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from craftsim.audit.conformance import Checker
    from craftsim.experiments.experiment import TrialRecord

Actions = Annotated[tuple[str, ...], Parameter(metavar="ACTION")]
Situations = Annotated[str, Parameter(metavar="PATTERN")]
_QUICK: Final = ("lippage", "unevenness", "position-bias", "heading-bias", "delay", "motor-lag")
"""The imperfections of a quick look."""
_LEARNING: Final = Group("Learned rules", sort_key=2)
_LEARN: Final = "learn rules for these machines, and write them into this YAML file"
_SHARE: Final = "share of actions as predicted that ends learning once it is certain"
_MOST_ACTIONS: Final = "actions in physics after which no further round begins"
_HELD_OUT: Final = "actions of play in worlds that were never seen, at the end"
_COMPARE: Final = "rule set to compare with: how much of what it allows, and works, is forbidden"
_SHOWN: Final = 3
"""Mismatches with CraftEnv that are drawn."""


@dataclass(frozen=True, kw_only=True)
class AuditPhysics(Physics):
    """The physics of an audit, which by default is of CraftEnv's own rule set."""

    rules: RulesChoice = "published"


@dataclass(frozen=True, kw_only=True)
class AuditTrials(Trials):
    """The trials of an audit, by default enough for a final verdict of each row."""

    trials: TrialCount = 20


@Parameter(name="*", group=_LEARNING)
@dataclass(frozen=True, kw_only=True)
class LearningOptions:
    """How rules are learned."""

    learn: Annotated[Path | None, Parameter(metavar="FILE", help=_LEARN)] = None
    share: Annotated[float, number(SUCCESS_RATE, help=_SHARE)] = 0.999
    most_actions: Annotated[int, number(RUNS, help=_MOST_ACTIONS)] = 40_000
    held_out: Annotated[int, number(RUNS, help=_HELD_OUT)] = 5_000
    compare: Annotated[RuleSetName | None, Parameter(help=_COMPARE)] = None


@dataclass(frozen=True, kw_only=True)
class MarginPhysics(Physics):
    """The physics of a search of margins, by default without noise but that which is searched."""

    randomize: Randomization = "none"


@dataclass(frozen=True, kw_only=True)
class MarginTrials(Trials):
    """The trials of a search of margins: if all of 59 succeed, 95 % of all worlds do, with 95 % confidence."""

    trials: TrialCount = 59


@owning
def audit(
    *,
    actions: Actions = (),
    situations: Situations = "*",
    only: Literal["all", "legal", "forbidden"] = "all",
    quick: bool = False,
    stop: bool = True,
    physics: AuditPhysics = AuditPhysics(),
    campaign: AuditTrials = AuditTrials(),
    record: PlayedChoice = "none",
    video: Shown = False,
    minimize: Shown = False,
    learning: LearningOptions = LearningOptions(),
    out: Dir = Path("out/audit"),
) -> int:
    """Try every action in every situation in physics, both where the rules allow it and where they forbid it.

    A rule is unsound if it allows an action that fails in physics, and conservative if it forbids one that works. The
    default is CraftEnv's own rule set. A row has at most 20 trials, enough for a final verdict; fewer if it certainly
    fails, or works without exception. Exit status: 0 if no rule is unsound, every trial finished, the solver gave up in
    none of what the rules allow, and a row got a verdict, 1 if not, 2 for invalid input.

    With --learn RULES.yaml it finds the preconditions that the rules lack for these machines instead: random legal play
    searches for failures, further trials tell what they depend on. Exit status then: 0 if at least --share of the
    actions in worlds never seen are as predicted, 1 if not.

    Args:
        actions: only these actions.
        situations: only rows whose name matches this pattern, such as `*load=block*room=tight`.
        only: rows that the rules allow, rows that they forbid, or both.
        quick: one trial of each row at a boundary of the rules: two minutes on two cores.
        stop: end the trials of a row when its verdict is settled; --no-stop runs all.
        video: film the disagreements.
        record: write the trajectories of the disagreements, for 'craftsim render' and 'view'; 3d also lets report.html
            replay them in 3D.
        minimize: reduce the first failure of each kind to the smallest world in which it occurs.
        out: folder for report.html, report.json, trials.jsonl, durations.csv and replay bundles.
    """
    if learning.learn is not None:
        of_an_audit = {
            "--actions": actions != (),
            "--situations": situations != "*",
            "--only": only != "all",
            "--quick": quick,
            "--no-stop": not stop,
            "--record": record != "none",
            "--minimize": minimize,
            "--trials": campaign.trials != AuditTrials().trials,
            "--baseline": campaign.baseline is not None,
        }
        for name, is_given in of_an_audit.items():
            if is_given:
                raise InputError(f"--learn chooses what it tries; leave {name} out")
        return _learn(learning, physics, campaign, video, out)
    if learning != LearningOptions():
        raise InputError(
            "--share, --most-actions, --held-out and --compare are for --learn; name its file, or leave them out"
        )
    _check_actions(actions)
    from craftsim.audit.audit import TRIALS_PER_BATCH, run_audit
    from craftsim.audit.audit_report import audit_report
    from craftsim.audit.plan import audit_plan, quick_rows
    from craftsim.cli.films import record_failures, rendering_works

    setup = physics.setup()  # says what is wrong with its files before contexts are looked for
    filming = video and rendering_works()
    rows = audit_plan(setup.rules, actions)
    kinds = {"all": (True, False), "legal": (True,), "forbidden": (False,)}[only]
    plan = [row for row in rows if row.legal in kinds and fnmatchcase(row.name, situations)]
    if not plan:
        raise InputError(
            f"no row matches '{situations}' with these actions; a row's name is such as '{rows[0].name}'"
        )
    trials = campaign.trials
    if quick:
        plan = quick_rows(plan, setup.rules)
        trials = 1
    RUNS.check("--trials times rows", trials * len(plan))
    result = run_audit(
        plan,
        setup,
        trials,
        physics.seed,
        out,
        selection={
            "actions": actions,
            "contexts": situations,
            "only": only,
            "quick": quick,
            "randomize": physics.randomize,
        },
        options=campaign.run(counting("trials", without_error)),
        batch=1 if quick else TRIALS_PER_BATCH,
        stop=stop,
        minimize=counting_kinds() if minimize else None,
    )
    if filming or record != "none":
        played = record == "3d"
        record_failures(out, result.records, campaign.workers, filming, played)
    return publish(audit_report(result, command_again()), out)


def _learn(
    learning: LearningOptions, physics: AuditPhysics, campaign: AuditTrials, video: bool, out: Path
) -> int:
    """Learn rules, and write them into a file beside the report."""
    from craftsim.audit.learning import Budget, RuleLearner
    from craftsim.audit.learning_report import learning_report
    from craftsim.audit.learning_result import run_learning
    from craftsim.cli.films import record_failures, rendering_works
    from craftsim.discrete.learned import rules_text
    from craftsim.discrete.rules import LearnedRules
    from craftsim.reports.terminal import Terminal
    from craftsim.storage.writing import write_whole

    assert learning.learn is not None
    path = learning.learn
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(f"--learn: '{path}' is no YAML file; give a name such as mycar.rules.yaml")
    if path.absolute() == (out / CONFIG).absolute():
        raise InputError(f"--learn: {path} is the run's own file of options; choose another name")
    setup = physics.setup()
    _check_rules_file(path, campaign.resume, setup.machines.digest, physics.seed)
    if isinstance(setup.rules, LearnedRules):
        raise InputError("--rules is a learned rule set; --learn begins with published or physical")
    filming = video and rendering_works()
    budget = Budget(learning.share, learning.most_actions, learning.held_out)
    learner = RuleLearner(
        setup,
        setup.rules,
        physics.seed,
        out,
        campaign.run(counting("trials", without_error)),
        budget,
        lambda learned: Terminal().print_safe(str(learned)),
    )
    result = run_learning(learner, path.stem, learning.compare)
    write_whole(path, rules_text(result.rules))
    if filming:
        record_failures(out, [_bundled(folder) for folder in result.bundles], campaign.workers)
    return publish(learning_report(result, command_again(), learning.share), out)


def _check_rules_file(path: Path, resumes: bool, machines: str, seed: int) -> None:
    """Raise InputError for a path at which rules of these machines cannot be written, or would replace another file."""
    from craftsim.discrete.learned import LearnedRules, read_rules

    try:
        LearnedRules(path.stem)
    except InputError as error:
        raise InputError(f"--learn: the file's name is that of the rules: {error}") from None
    if path.is_symlink() or exists(path):
        if not resumes:
            raise InputError(f"--learn: {path} is there already; choose another name, or remove it")
        origin = read_rules(path).origin
        if (origin.machines, origin.seed) != (machines, seed):
            raise InputError(
                f"--learn: {path} has rules of other machines or of another seed; choose another name, or remove it"
            )
    output_directory(path.parent)


def _bundled(folder: str) -> TrialRecord:
    """Return the record of a replay bundle, to be filmed."""
    return {
        "key": folder,
        "index": 0,
        "group": folder,
        "seed": 0,
        "context": None,
        "episode": None,
        "attempts": [],
        "agrees": False,
        "error": None,
        "bundle": folder,
        "extra": {},
    }


def _check_actions(actions: Iterable[str]) -> None:
    from craftsim.discrete.actions import verbs

    for action in actions:
        if action not in verbs():
            raise InputError(
                f"--actions: no action '{action}'{suggestion(action, verbs())} (actions: {', '.join(verbs())})"
            )


@owning
def margins(
    imperfections: Annotated[tuple[str, ...], Parameter(metavar="IMPERFECTION")] = (),
    *,
    situations: Situations = "*",
    pair: Annotated[tuple[str, str] | None, Parameter(name="--map", metavar="A B")] = None,
    quick: bool = False,
    physics: MarginPhysics = MarginPhysics(),
    campaign: MarginTrials = MarginTrials(),
    out: Dir = Path("out/margins"),
) -> int:
    """Search the largest value of each imperfection at which every action still works.

    An imperfection is one parameter of --randomize, varied alone. Its margin is the largest value at which all trials
    succeed; with 59 trials at least 95 % of all worlds pass it, with 95 % confidence. Exit status: 0 if all actions
    work at --randomize itself and every search finished, 1 if not, 2 for invalid input.

    Args:
        imperfections: names such as lippage, position-bias or delay, or 'all'; default: a selection of eighteen.
        situations: only scenarios whose name matches this pattern, such as `lift*` or `*between*`.
        pair: draw a map of two imperfections; unless others are named, only these two are searched.
        quick: six imperfections in the first scenario of each action, with 20 trials: two minutes on two cores.
        out: folder for report.html, report.json, trials.jsonl and the replay bundles of the first failures.
    """
    from craftsim.audit.imperfections import DEFAULT_IMPERFECTIONS, imperfections_of
    from craftsim.audit.margins import run_margins, scenarios
    from craftsim.audit.margins_report import margins_report

    over = imperfections_of(pair or ())
    if pair is not None and len(over) != len(pair):
        raise InputError(f"--map is {' '.join(pair)}; allowed: two different imperfections")
    chosen = imperfections_of(imperfections or pair or (_QUICK if quick else DEFAULT_IMPERFECTIONS))
    rows = scenarios(situations, quick)
    result = run_margins(
        rows,
        chosen,
        physics.setup(),
        20 if quick else campaign.trials,
        physics.seed,
        out,
        selection={
            "axes": imperfections,
            "scenarios": situations,
            "pair": pair,
            "quick": quick,
            "randomize": physics.randomize,
        },
        options=campaign.run(counting("searches", without_error)),
        pair=over,
    )
    return publish(margins_report(result, command_again()), out)


@owning
def clearance(
    *,
    actions: Actions = (),
    rules: RulesName = "physical",
    machines: File = None,
    out: Dir = Path("out/clearance"),
) -> int:
    """Compare the volume that each action sweeps with its possible neighbours and with the rules.

    This is geometry alone: the swept solids of the machines against one neighbour at a time; about a minute. Exit
    status: 0 if the rules forbid every collision, 1 if not, 2 for invalid input.

    Args:
        actions: only these actions.
        rules: the rule set to compare with.
        machines: YAML file of machine parameters.
        out: folder for report.json, with every neighbour within reach.
    """
    from craftsim.audit.neighbours import neighbours
    from craftsim.discrete.rules import Rules
    from craftsim.mjcf.machines import NOMINAL, load_machines, machine_file
    from craftsim.reports.json_file import document

    _check_actions(actions)
    parameters = NOMINAL
    if machines is not None:
        parameters = load_machines(machine_file(machines))
    judge = Rules(rules)
    judged: list[dict[str, Any]] = []
    listed: list[dict[str, Any]] = []
    in_reach: list[dict[str, Any]] = []
    unexplained: list[dict[str, Any]] = []
    for neighbour in neighbours(parameters, actions):
        legal, legal_alone = neighbour.legal(judge)
        row: dict[str, Any] = {
            "situation": neighbour.situation.id,
            "occupant": neighbour.occupant.name,
            "at": neighbour.at,
            "clearance_mm": None,
            "closest": neighbour.closest,
            "legal": legal,
            "legal_alone": legal_alone,
        }
        judged.append(row)
        if neighbour.clearance is not None:
            row["clearance_mm"] = round(neighbour.clearance.distance_m * 1e3, 2)
            in_reach.append(row)
            listed.append(row)
        elif legal_alone and not legal:
            unexplained.append(row)
            listed.append(row)
    in_the_way = sorted(
        (row for row in in_reach if row["clearance_mm"] < 0.0), key=itemgetter("clearance_mm")
    )
    collisions = [row for row in in_the_way if row["legal"]]
    written = document(
        {"clearance": {"neighbours": len(judged), "rows": listed}},
        command="clearance",
        seed=0,
        config={"rules": rules, "actions": actions, "machines": parameters.digest},
    )
    groups = (judged, in_reach, in_the_way, collisions, unexplained)
    counts = [Counter(row["situation"] for row in group) for group in groups]
    rows: list[tuple[str | int, ...]] = []
    for name in counts[0]:
        rows.append((name, *[count_of[name] for count_of in counts]))
    heads = ("neighbours", "within reach", "in the way", "allowed", "unexplained")
    columns = (Column("situation", "path"), *(Column(name, "number") for name in heads))
    table = DataTable(columns, rows, "Situations", tall=True, most=100)
    findings = [
        _findings_table("Collisions that the rules allow", collisions),
        _findings_table("Forbidden although out of reach", unexplained),
    ]
    sentence = f"The {rules} rules allow {count(len(collisions), 'collision')} of {count(len(judged), 'neighbour')}."
    headline = Headline("Clear", Tone.GOOD, sentence)
    if collisions:
        headline = Headline("Collides", Tone.BAD, sentence)
    lead = "The volume that each action sweeps."
    report = Report(
        "Clearance of actions",
        f"rule set: {rules}",
        headline,
        [
            KeyFigure(f"{len(collisions):,}", "collisions allowed"),
            KeyFigure(f"{len(unexplained):,}", "forbidden out of reach"),
        ],
        [
            Section("situations", "Situations", lead, [table], terminal=True),
            Section("findings", "Findings", "The deepest first.", findings, terminal=True),
        ],
        document=written,
        exit_code=1 if collisions else 0,
    )
    return publish(report, out)


def _findings_table(title: str, findings: Sequence[Mapping[str, Any]]) -> DataTable:
    rows = []
    for finding in findings:
        cell = ",".join(map(str, finding["at"]))
        clearance_mm = finding["clearance_mm"]
        rows.append(
            (
                f"{finding['situation']}/near={finding['occupant']}@({cell})",
                None if clearance_mm is None else f"{clearance_mm:.1f}",
                finding["closest"] or None,
            )
        )
    columns = (
        Column("situation and neighbour", "path"),
        Column("clearance, mm", "number"),
        Column("closest"),
    )
    return DataTable(columns, rows, f"{title}: {len(findings)}", tall=True, most=30)


@owning
def conformance(
    files: Annotated[tuple[Path, ...], Parameter(metavar="FILE")] = (),
    *,
    rules: RulesName = "published",
    out: OptionalDir = None,
) -> int:
    """Replay recordings of CraftEnv and compare masks, effects, rewards and plans.

    With the physical rule set, records in which a correction changes the outcome are left out. Exit status: 0 if
    nothing differs, 1 if anything does or nothing was compared, 2 for invalid input.

    Args:
        files: recordings: gzip-compressed JSON lines.
        rules: the rule set to compare.
        out: folder for report.json.
    """
    from craftsim.audit.conformance import Checker, read_records
    from craftsim.discrete.rules import Rules
    from craftsim.reports.json_file import document

    if not files:
        raise InputError("no recordings given; name one or more .jsonl.gz files")
    begin_s = time.perf_counter()
    checker = Checker(Rules(rules), keep=_SHOWN)
    for file in files:
        with working(f"conformance {file.name}"):
            for line, record in read_records(file):
                try:
                    checker.check(line, record)
                except CraftsimError as error:
                    raise InputError(f"{file}:{line}: not a record: {error}") from error
    wall = {"seconds": time.perf_counter() - begin_s}
    config = {"files": [file.name for file in files], "rules": rules}
    written = document(checker.figures(), command="conformance", config=config, wall=wall)
    mismatches = checker.mismatches.total()
    sentence = (
        f"{checker.records} records, {checker.checks.total()} checks, {mismatches} mismatches"
    )
    headline = Headline("Agrees", Tone.GOOD, sentence)
    if mismatches:
        headline = Headline("Differs", Tone.BAD, sentence)
    elif not checker.checks.total():
        headline = Headline("Nothing to compare", Tone.CAUTION, f"{sentence}; nothing was compared")
    notes = []
    if checker.skipped:
        notes.append(f"{checker.skipped} records with a quirk were left out")
    if checker.corrected:
        notes.append(f"{checker.corrected} records that a correction changes were left out")
    report = Report(
        "Conformance with CraftEnv",
        f"rule set: {rules}",
        headline,
        sections=list(_compared(checker)),
        notes=notes,
        document=written,
        exit_code=0 if checker.checks.total() and not mismatches else 1,
    )
    return publish(report, out)


def _compared(checker: Checker) -> Iterable[Section]:
    """Yield what was compared, and the first mismatches if there are any."""
    from craftsim.discrete.drawing import LEGEND, world_text
    from craftsim.discrete.kinds import Action

    actions = []
    for action in Action:
        name = action.name
        counts = (checker.actions[name], checker.applied[name], checker.action_mismatches[name])
        if any(counts):
            actions.append((name, *counts))
    checks = [(name, n, checker.mismatches[name]) for name, n in checker.checks.items()]
    by_action = numbers("action", "taken", "legal", "mismatches")
    tables = [
        DataTable(by_action, actions, "By action"),
        DataTable(numbers("compared", "checks", "mismatches"), checks, "By check"),
    ]
    lead = "Recordings of CraftEnv, record by record."
    yield Section("compared", "What was compared", lead, tables, terminal=True)
    if checker.first:
        drawings = []
        for words, grids in checker.first:
            lines = [words]
            for title, grid in zip(("before", "expected after", "got after"), grids, strict=False):
                lines += [f"{title}:", world_text(grid).plain]
            drawings.append("\n".join(lines))
        yield Section("first", "First mismatches", "", [*drawings, str(LEGEND)], terminal=True)
