"""``craftsim audit``: which rules does physics keep?"""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from craftsim.choices import RuleSet
from craftsim.cli.again import command_again
from craftsim.cli.options import RESULTS, Actions, Dir, Shown, check_actions
from craftsim.errors import InputError
from craftsim.options import Physics, Trials, number
from craftsim.storage.folders import owning
from craftsim.storage.limits import RUNS, TRIAL_COUNT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from craftsim.audit.plan import PlanRow


@dataclass(frozen=True, kw_only=True)
class AuditedPhysics(Physics):
    """Physics in which CraftEnv's own rules are audited."""

    rules: RuleSet = "published"


@dataclass(frozen=True, kw_only=True)
class AuditTrials(Trials):
    """The trials of a row that make its verdict final."""

    trials: Annotated[int, number(TRIAL_COUNT)] = 20


@owning
def audit(
    *,
    actions: Actions = (),
    situations: Annotated[str, Parameter(metavar="PATTERN")] = "*",
    only: Literal["all", "legal", "forbidden"] = "all",
    quick: bool = False,
    physics: AuditedPhysics = AuditedPhysics(),
    campaign: AuditTrials = AuditTrials(),
    record: Annotated[Literal["none", "trajectory"], Parameter(group=RESULTS)] = "none",
    video: Shown = False,
    minimize: Shown = False,
    out: Dir = Path("out/audit"),
) -> int:
    """Try every action in every situation in physics, where the rules allow it and where they forbid it.

    A rule that allows what physics refuses is unsound; one that forbids what would have worked is conservative. By
    default CraftEnv's own rules are audited, with the 20 trials a row that make a verdict final. Exit status 0 when no
    rule is unsound and every trial came to an end, 1 when not, 2 for wrong input.

    Args:
        actions: only these actions.
        situations: only rows whose name matches, such as '*load=block*room=tight'.
        only: where the rules allow the action, where they forbid it, or both.
        quick: try the rows that cover the boundaries of the rules, once each, instead of all: two minutes on two cores.
        video: films of the disagreements, a few seconds of work each.
        record: write the trajectories of the disagreements, for 'craftsim render' and 'view'.
        minimize: find the smallest world in which the first failure of each kind still happens.
        out: folder for report.html, report.json, trials.jsonl, durations.csv and the bundles of the disagreements.
    """
    check_actions(actions)
    from craftsim.audit.plan import audit_plan
    from craftsim.audit.quick import quick_rows
    from craftsim.cli.films import record_failures, rendering_works
    from craftsim.cli.progress import counting, shrinking
    from craftsim.reports.terminal import Terminal
    from craftsim.validation.audit import BATCH, run_audit
    from craftsim.validation.audit_report import audit_report

    console = Terminal()
    setup = physics.setup()  # says what is wrong with its files before contexts are looked for
    filming = video and rendering_works(console)
    plan = _chosen(audit_plan(physics.rules, actions), situations, only)
    trials = campaign.trials
    if quick:
        plan = quick_rows(plan, physics.rules)
        trials = 1
    RUNS.check("--trials times rows", trials * len(plan))
    result = run_audit(
        plan,
        setup,
        trials,
        physics.seed,
        out,
        asked={
            "actions": actions,
            "contexts": situations,
            "only": only,
            "quick": quick,
            "randomize": physics.randomize,
        },
        options=campaign.run(
            lambda total: counting(console, "trials", total, lambda record: record["error"] is None)
        ),
        batch=1 if quick else BATCH,
        shrink=shrinking(console) if minimize else None,
    )
    if filming or record == "trajectory":
        record_failures(console, out, result.records, campaign.workers, filming)
    return audit_report(result, out, command_again()).publish(out, console)


def _chosen(plan: Sequence[PlanRow], contexts: str, only: str) -> list[PlanRow]:
    """Return the rows that are asked for, by patterns of their names."""
    wanted = [
        row
        for row in plan
        if fnmatchcase(row.name, contexts) and only in ("all", "legal" if row.legal else "forbidden")
    ]
    if not wanted:
        raise InputError(
            f"no row matches '{contexts}' with these actions; a row's name is such as '{plan[0].name}'"
        )
    return wanted
