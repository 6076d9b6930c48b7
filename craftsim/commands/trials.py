"""``craftsim trials``: every action in every context, in physics."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import tyro
from rich.console import Console
from rich.table import Table

from craftsim.commands.campaigning import CampaignCommand
from craftsim.discrete.errors import InputError
from craftsim.validation.campaign import Engine

if TYPE_CHECKING:
    from craftsim.validation.campaign import TrialRecord
    from craftsim.validation.contexts.figures import Quantiles, Summary
    from craftsim.validation.contexts.survey import Survey

ActionName = Literal["LIFT", "DROP", "FOLD", "UNFOLD", "ROTATE_LEFT", "ROTATE_RIGHT", "MOVE", "STOP"]

BAR: Final = {False: 0.999, True: 0.99}
"""The success rate that is asked for, without and with noise."""
_SHOWN_FAILURES: Final = 20


def trials(
    trials: int = 2000,
    seed: int = 0,
    workers: int = 1,
    engine: Engine = "local",
    noise: bool = False,
    actions: tuple[ActionName, ...] = (),
    contexts: Annotated[str, tyro.conf.arg(metavar="PATTERN")] = "*",
    at_least: float | None = None,
    resume: bool = False,
    out: Path = Path("out/trials"),
) -> int:
    """Try each action in physics in every situation where the rules allow it.

    Exit status 0 when the success rate reaches the bar, 1 when not, 2 for wrong input.

    Args:
        trials: how many trials to spread over the contexts.
        seed: decides the places, and with noise the physics and the noise, of all trials.
        workers: processes to share the work; results do not depend on it.
        engine: processes of this machine, or an existing Ray cluster to which the output folder is shared.
        noise: randomise the physics, and give the cars noisy sensors.
        actions: only these actions.
        contexts: only contexts whose name matches, such as '*load=block*room=tight'.
        at_least: the success rate to reach; 0.999, or 0.99 with noise, unless given.
        resume: go on with what an interrupted run has left in the output folder.
        out: folder for report.json and trials.jsonl.
    """
    if trials < 1:
        raise InputError(f"--trials must be at least 1, not {trials}")
    bar = BAR[noise] if at_least is None else at_least
    if not 0 <= bar <= 1:
        raise InputError(f"--at-least is a share from 0 to 1, not {bar}")
    command = CampaignCommand("trials", seed, out, workers, engine, resume)
    console = command.console

    from craftsim.skills.gains import load_gains
    from craftsim.validation.contexts.figures import campaign_figures
    from craftsim.validation.contexts.survey import survey
    from craftsim.validation.contexts.trials import (
        BATCH,
        NOMINAL,
        TIMEOUT_S,
        WITH_NOISE,
        do_trial,
        items_of,
        plan_trials,
    )

    found = survey()
    _print_survey(console, found)
    chosen = [c for c in found.contexts if (not actions or c.verb in actions) and fnmatchcase(c.id, contexts)]
    if not chosen:
        raise InputError(
            f"no context matches '{contexts}'; 'craftsim trials' writes their names to trials.jsonl"
        )
    settings = WITH_NOISE if noise else NOMINAL
    config = {
        "settings": settings,
        "gains": load_gains(),
        "trials": trials,
        "noise": noise,
        "actions": actions,
        "contexts": contexts,
        "at_least": bar,
    }
    items = items_of(plan_trials(chosen, trials, seed), seed)
    work = partial(do_trial, seed=seed, settings=settings)
    records = command.run("trials", items, work, config, timeout_s=TIMEOUT_S, batch=BATCH)
    figures = campaign_figures(records, {context.id: context for context in chosen}, found)
    _print_figures(console, figures)
    _print_failures(console, records)
    report = command.report(figures, config)
    console.print(f"Report: {report}", soft_wrap=True)
    return _conclude(console, figures["all"], bar)


def _print_survey(console: Console, survey: Survey) -> None:
    impossible, forbidden = (sum(n for _, n in part) for part in (survey.impossible, survey.forbidden))
    console.print(
        f"{len(survey.contexts)} contexts. Of {survey.n_combinations} combinations, {impossible} cannot exist and "
        f"{forbidden} are forbidden by the rules:",
        soft_wrap=True,
    )
    for reason, count in [*survey.impossible[:6], *survey.forbidden[:6]]:
        console.print(f"  {count:>7}  {reason}", highlight=False)
    console.print("  the other reasons are in report.json")


def _print_figures(console: Console, figures: dict[str, Any]) -> None:
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("", no_wrap=True)
    for heading in ("trials", "good", "Wilson", "car mm", "mrad", "placed mm", "s"):
        table.add_column(heading, justify="right", no_wrap=True)
    for group, rows in (figures["by"] | {"all": {"": figures["all"]}}).items():
        table.add_row(f"[bold]{group}[/]")
        for name, row in rows.items():
            table.add_row(
                name,
                str(row.trials),
                str(row.successes),
                f"{row.wilson_low:.4f}",
                _pair(row.car_error_mm),
                _pair(row.heading_error_mrad),
                _pair(row.placed_error_mm),
                _pair(row.duration_s),
            )
    console.print(table)
    console.print("Wilson: lower bound of the 95 % interval. Others: median and 99th percentile.")


def _pair(quantiles: Quantiles | None) -> str:
    return "-" if quantiles is None else f"{quantiles.p50:.2f} {quantiles.p99:.2f}"


def _print_failures(console: Console, records: Sequence[TrialRecord]) -> None:
    from craftsim.validation.contexts.figures import reason

    failures = [record for record in records if not record["agrees"]]
    for record in failures[:_SHOWN_FAILURES]:
        told = f"trial {record['index']} {record['context']}: {reason(record)}"
        if record["error"] is None:
            told += f" ({'; '.join((record['extra']['outcome'], *record['extra']['differences']))})"
        console.print(told, soft_wrap=True, markup=False, highlight=False)
    if len(failures) > _SHOWN_FAILURES:
        console.print(f"and {len(failures) - _SHOWN_FAILURES} more failures in trials.jsonl")


def _conclude(console: Console, summary: Summary, bar: float) -> int:
    enough = summary.trials == 0 or summary.rate >= bar
    verdict = "reaches" if enough else "does NOT reach"
    console.print(
        f"{summary.successes} of {summary.trials} trials succeeded ({100 * summary.rate:.2f} %, at least "
        f"{100 * summary.wilson_low:.2f} % with 95 % confidence): {verdict} the bar of {100 * bar:.2f} %.",
        soft_wrap=True,
    )
    return 0 if enough else 1
