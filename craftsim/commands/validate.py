"""``craftsim validate``: do plans, actions and policies do in physics what the rules predict?"""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from craftsim.commands.campaigning import CampaignCommand
from craftsim.commands.comparing import compare, print_comparison, read_against
from craftsim.commands.filming import rendering_works
from craftsim.discrete.errors import InputError
from craftsim.discrete.tasks import TASK_NAMES
from craftsim.validation.campaign import Engine

if TYPE_CHECKING:
    from craftsim.validation.html.run_description import RunDescription

Video = Literal["none", "failures", "all"]


def validate(
    blueprints: Annotated[
        tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[BLUEPRINT ...]")
    ] = (),
    plan: Path | None = None,
    actions: Path | None = None,
    policy: tuple[str, ...] = (),
    trials: int = 10,
    randomize: Literal["none", "mild", "strong"] = "mild",
    rules: Literal["published", "physical"] = "physical",
    workers: int = 1,
    engine: Engine = "local",
    timeout: float = 600.0,
    video: Video = "failures",
    against: Path | None = None,
    resume: bool = False,
    seed: int = 0,
    out: Path = Path("out/validate"),
) -> int:
    """Run plans, lists of actions or policies in physics, check each action on poses, and report.

    After each step the prediction goes on from what was read. Exit status 0 when everything went as predicted, 1 when
    something did not or a trial came to no end, 2 for wrong input.

    Args:
        blueprints: files, or names of shipped tasks; all six tasks unless given.
        plan: plan file to carry out, 'tick car ACTION' a line; the cars of one tick act at the same time.
        actions: file with one 'car ACTION' a line, tried one after the other.
        policy: 'random', 'planner' (the shipped plan), 'module:function', or a file that 'craftsim train' wrote;
            several are compared with each other. The planner unless given.
        trials: how many runs of each.
        randomize: how noisy the sensors and how random the physics are.
        rules: the rule set that predicts, and by which policies may act.
        workers: processes to share the work; results do not depend on it.
        engine: processes of this machine, or an existing Ray cluster to which the output folder is shared.
        timeout: seconds after which a run counts as hanging.
        video: films of the failures, or besides of every run from its start to its end.
        against: folder of an earlier run under other settings, to compare run by run.
        resume: go on with what an interrupted run has left in the output folder.
        seed: decides all that is drawn; the same for every plan and policy.
        out: folder for report.html, report.json, trials.jsonl, durations.csv and the bundles of the disagreements.
    """
    if trials < 1 or not timeout > 0:
        raise InputError("--trials must be at least 1, --timeout above 0")
    given = [name for name, value in (("plan", plan), ("actions", actions), ("policy", policy)) if value]
    if len(given) > 1:
        raise InputError(f"--{given[0]} and --{given[1]} exclude each other")
    if given and given[0] != "policy" and len(blueprints) != 1:
        raise InputError(f"--{given[0]} needs the one blueprint that it is for")
    command = CampaignCommand("validate", seed, out, workers, engine, resume)
    console = command.console
    filming = video != "none" and rendering_works(console)
    # Workers find the modules of policies where this process finds them.
    sys.path.insert(0, os.getcwd())

    # MuJoCo must not be imported before the rendering backend is chosen.
    from craftsim.checking.settings import SETTINGS
    from craftsim.commands.validate_films import film_failures, film_runs
    from craftsim.commands.validate_text import print_disagreements, runs_table
    from craftsim.skills.gains import load_gains
    from craftsim.validation.html.validate import validate_page
    from craftsim.validation.html.writing import write_html
    from craftsim.validation.runs.choice import (
        PLANNER,
        actions_pilot,
        items_of,
        plan_pilot,
        policy_pilot,
        subjects_of,
    )
    from craftsim.validation.runs.run import Terms, do_run
    from craftsim.validation.statistics.durations import write_durations
    from craftsim.validation.statistics.figures import campaign_figures

    subjects = subjects_of(blueprints or TASK_NAMES)
    if plan is not None:
        pilots = [plan_pilot(plan, subjects[0])]
    elif actions is not None:
        pilots = [actions_pilot(actions, subjects[0])]
    else:
        pilots = [policy_pilot(name, subjects) for name in dict.fromkeys(policy or (PLANNER,))]
    terms = Terms(seed, SETTINGS[randomize], rules, out.resolve())
    config: dict[str, Any] = {
        "blueprints": {subject.name: subject.digest for subject in subjects},
        "by": {pilot.name: pilot.digest for pilot in pilots},
        "trials": trials,
        "randomize": randomize,
        "rules": rules,
        "settings": terms.settings,
        "gains": load_gains(),
    }
    items = list(items_of(subjects, pilots, trials, terms))
    earlier = read_against(command, against, items)
    records = command.run("runs", items, do_run, config, timeout_s=timeout)
    figures = campaign_figures(records, seed)
    comparison = compare(command, earlier, records)
    report = command.report({"validation": figures, "paired": comparison}, config | {"against": against})
    write_durations(out, figures.durations)
    if filming:
        film_failures(console, out, records)
    if filming and video == "all":
        film_runs(console, out, items, records)
    provenance = _provenance(config, seed, against)
    subject = f"{', '.join(config['blueprints'])}: {', '.join(config['by'])}"
    page = write_html(out, validate_page(records, figures, provenance, subject, comparison))
    console.print(runs_table(records))
    print_disagreements(console, out, records)
    print_comparison(console, comparison)
    console.print(f"Report: {report}\nPage:   {page}", soft_wrap=True)
    agree = sum(record["agrees"] for record in records)
    console.print(f"{agree} of {len(records)} runs did in physics what the rules predict.")
    return 0 if agree == len(records) else 1


def _provenance(config: dict[str, Any], seed: int, against: Path | None) -> RunDescription:
    from craftsim.report import plain
    from craftsim.validation.html.run_description import RunDescription

    words = ["craftsim", "validate", *config["blueprints"], "--trials", str(config["trials"])]
    words += ["--randomize", config["randomize"], "--rules", config["rules"], "--seed", str(seed)]
    words += ["--against", str(against)] if against else []
    told = {key: value for key, value in plain(config).items() if key != "settings"}
    return RunDescription(shlex.join(words), seed, told, plain(config["settings"].thresholds))
