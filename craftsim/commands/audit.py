"""``craftsim audit``: which rules does physics keep?"""

from __future__ import annotations

import shlex
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import tyro

from craftsim.commands.campaigning import CampaignCommand
from craftsim.commands.comparing import compare, print_comparison, read_against
from craftsim.commands.filming import rendering_works
from craftsim.discrete.errors import InputError
from craftsim.validation.campaign import Engine

if TYPE_CHECKING:
    from craftsim.validation.audit.rows import Row
    from craftsim.validation.html.run_description import RunDescription

ActionName = Literal["LIFT", "DROP", "FOLD", "UNFOLD", "ROTATE_LEFT", "ROTATE_RIGHT", "MOVE", "STOP"]

QUICK_ROWS: Final = 60
"""About how many rows the quick mode tries, once each."""


def audit(
    actions: tuple[ActionName, ...] = (),
    contexts: Annotated[str, tyro.conf.arg(metavar="PATTERN")] = "*",
    trials: int = 20,
    randomize: Literal["none", "mild", "strong"] = "mild",
    rules: Literal["published", "physical"] = "published",
    quick: bool = False,
    workers: int = 1,
    engine: Engine = "local",
    video: bool = False,
    against: Path | None = None,
    resume: bool = False,
    seed: int = 0,
    out: Path = Path("out/audit"),
) -> int:
    """Try every action in every context in physics, where the rules allow it and where they forbid it.

    A rule that allows what physics refuses is unsound; one that forbids what would have worked is conservative. Exit
    status 0 when no rule is unsound and every trial came to an end, 1 when not, 2 for wrong input.

    Args:
        actions: only these actions.
        contexts: only rows whose name matches, such as '*load=block*room=tight'.
        trials: at least how many for each row; each of its contexts is tried at least once.
        randomize: how noisy the sensors and how random the physics are.
        rules: the rule set to audit.
        quick: try a small sample of the rows, once each.
        workers: processes to share the work; results do not depend on it.
        engine: processes of this machine, or an existing Ray cluster to which the output folder is shared.
        video: films of the disagreements, a few seconds of work each.
        against: folder of an earlier audit under other settings, to compare trial by trial.
        resume: go on with what an interrupted audit has left in the output folder.
        seed: decides the places, the physics and the noise of all trials.
        out: folder for report.html, report.json, trials.jsonl, durations.csv and the bundles of the disagreements.
    """
    if trials < 1:
        raise InputError(f"--trials must be at least 1, not {trials}")
    command = CampaignCommand("audit", seed, out, workers, engine, resume)
    console = command.console
    filming = video and rendering_works(console)

    # MuJoCo must not be imported before the rendering backend is chosen.
    from craftsim.checking.settings import SETTINGS
    from craftsim.commands.audit_text import conclude, print_results
    from craftsim.commands.validate_films import film_failures
    from craftsim.skills.gains import load_gains
    from craftsim.validation.audit.corrections import rows_by_switch
    from craftsim.validation.audit.results import Results, bundle_disagreements, judged_by_rules
    from craftsim.validation.audit.rows import audit_plan
    from craftsim.validation.audit.tables import corrections_table, suspects_table
    from craftsim.validation.audit.trial import BATCH, TIMEOUT_S, items_of, try_it
    from craftsim.validation.html.audit import audit_page
    from craftsim.validation.html.writing import write_html
    from craftsim.validation.statistics.durations import write_durations
    from craftsim.validation.statistics.figures import campaign_figures

    plan = _chosen(audit_plan(rules), actions, contexts)
    if quick:
        plan, trials = (
            [replace(row, members=row.members[:1]) for row in plan[:: 1 + len(plan) // QUICK_ROWS]],
            1,
        )
    settings = SETTINGS[randomize]
    config = {
        "actions": actions,
        "contexts": contexts,
        "trials": trials,
        "randomize": randomize,
        "rules": rules,
        "quick": quick,
        "settings": settings,
        "gains": load_gains(),
    }
    items = items_of(plan, trials, seed, rules, settings)
    earlier = read_against(command, against, items)
    records = command.run(
        "trials",
        items,
        try_it,
        config,
        timeout_s=TIMEOUT_S,
        batch=1 if quick else BATCH,
        good=lambda record: record["error"] is None,
    )
    bundle_disagreements(out, items, records, workers)
    if filming:
        film_failures(console, out, records)
    results = Results.of(records)
    corrected = results.corrected(plan, rules)
    judged = judged_by_rules(records)
    validation = campaign_figures(judged, seed)
    if earlier is not None:
        earlier = replace(earlier, records=judged_by_rules(earlier.records))
    comparison = compare(command, earlier, judged)
    audited = results.figures(plan, corrected)
    figures = {"audit": audited, "validation": validation, "paired": comparison}
    report = command.report(figures, config | {"against": against})
    write_durations(out, validation.durations)
    provenance = _provenance(config, seed, against)
    page = write_html(
        out,
        audit_page(
            results.rows,
            judged,
            validation,
            provenance,
            rules,
            suspects_table(results.suspects),
            corrections_table(corrected),
            comparison,
        ),
    )
    print_results(console, results)
    print_comparison(console, comparison)
    console.print(f"Report: {report}\nPage:   {page}", soft_wrap=True)
    return conclude(console, results, records, rules, rows_by_switch(corrected))


def _chosen(plan: list[Row], actions: tuple[ActionName, ...], contexts: str) -> list[Row]:
    """Return the rows that are asked for, by the action's name before a direction and the row's name."""
    wanted = [
        row
        for row in plan
        if (not actions or any(verb in row.name.split("/")[0].split("+") for verb in _verbs(actions)))
        and fnmatchcase(row.name, contexts)
    ]
    if not wanted:
        raise InputError(
            f"no row matches '{contexts}' with these actions; a row's name is such as '{plan[0].name}'"
        )
    return wanted


def _verbs(actions: tuple[ActionName, ...]) -> list[str]:
    moves = [f"MOVE-{way}" for way in ("forward", "left", "back", "right")]
    return [*actions, *(moves if "MOVE" in actions else [])]


def _provenance(config: dict[str, Any], seed: int, against: Path | None) -> RunDescription:
    from craftsim.report import plain
    from craftsim.validation.html.run_description import RunDescription

    words = ["craftsim", "audit", "--rules", config["rules"], "--randomize", config["randomize"]]
    words += ["--actions", *config["actions"]] if config["actions"] else []
    words += ["--contexts", config["contexts"]] if config["contexts"] != "*" else []
    words += ["--quick"] if config["quick"] else ["--trials", str(config["trials"])]
    words += ["--seed", str(seed)]
    words += ["--against", str(against)] if against else []
    told = {key: value for key, value in plain(config).items() if key != "settings"}
    return RunDescription(shlex.join(words), seed, told, plain(config["settings"].thresholds))
