"""Judge the same trials with another release of MuJoCo, drive, physics step or solver, and compare the verdicts.

    python scripts/engines.py                         # RELEASES, rollers and SETTINGS: hours
    python scripts/engines.py 4.0.0 rollers --rows 5  # some, with five trials a row of the audit

Each is compared, trial by trial, with the installed release: ``craftsim audit --rules physical
--only legal`` and, for releases and drives, ``craftsim validate`` of the six tasks, with mild randomization from one
seed. A release has a virtual environment in the output folder, which takes all other packages from this one. What has
run is not run again, and what was interrupted goes on. ``--store`` writes craftsim/data/engines.json, from which
``craftsim doctor`` and docs/explanation/drives.md take what they say.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import sysconfig
import venv
from collections import Counter, defaultdict
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from measure_results import revision

from craftsim.audit.audit import judged_by_rules, run_audit
from craftsim.audit.plan import audit_plan, quick_rows
from craftsim.checking.attempt import AGREEING
from craftsim.checking.setup import setup_of
from craftsim.experiments.compare import compare_actions, compare_trials
from craftsim.experiments.experiment import RunOptions
from craftsim.experiments.intervals import least_detectable
from craftsim.reports.json_file import document, json_value, versions
from craftsim.reports.publishing import publish
from craftsim.reports.report import DataTable, Headline, Report, Section, Tone, numbers
from craftsim.validation.record_schemas import read_run

ROOT: Final = Path(__file__).parents[1]
STORED: Final = ROOT / "craftsim" / "data" / "engines.json"
REFERENCE: Final = version("mujoco")
_COMMAND: Final = (
    "import sys; from craftsim import cli; cli.check_mujoco = lambda: None; sys.exit(cli.main())"
)
"""The command line, for releases too that it does not allow."""
RELEASES: Final = ("4.0.0", "3.16.0", "3.14.0", "3.12.0", "3.11.0")
SETTINGS: Final[dict[str, dict[str, Any]]] = {
    "1ms": {"timestep_s": 0.001},
    "2ms": {"timestep_s": 0.002},
    "5ms": {"timestep_s": 0.005},
    "pgs": {"solver": "pgs"},
}


def main() -> int:
    """Run, compare, print and store."""
    known = (*RELEASES, "rollers", *SETTINGS)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument(
        "changes", nargs="*", metavar="CHANGE", help=f"any release, or of {', '.join(known)}"
    )
    parser.add_argument("--quick", action="store_true", help="the rows of a quick audit, once each")
    parser.add_argument("--rows", type=int, default=20, help="trials of each row of the audit")
    parser.add_argument("--trials", type=int, default=10, help="trials of each task")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "engines")
    parser.add_argument("--store", action="store_true", help=f"write {STORED.relative_to(ROOT)}")
    asked = parser.parse_args()
    asked.rows = 1 if asked.quick else asked.rows
    found = {}
    for name in dict.fromkeys((REFERENCE, *(asked.changes or known))):
        try:
            found[name] = _runs(name, asked)
        except RuntimeError as error:
            found[name] = {"why": str(error)}
    counts = {"quick": asked.quick, "rows": asked.rows, "trials": asked.trials}
    stored = {"config": counts, "reference": REFERENCE, "versions": versions()}
    stored |= {"revision": revision(), "found": found}
    if asked.store:
        STORED.write_text(json.dumps(json_value(stored), indent=1) + "\n", encoding="utf-8")
    unlike = [
        k for k, v in found.items() if any(of["differing"] for of in v.get("against", {}).values())
    ]
    text = f"Trials with other verdicts than MuJoCo {REFERENCE}: {', '.join(unlike) or 'none'}."
    head, *rows = table_of(stored)
    report = Report(
        "Engines",
        f"MuJoCo {REFERENCE}, with one change at a time",
        Headline(
            "Differs" if unlike else "No difference", Tone.CAUTION if unlike else Tone.GOOD, text
        ),
        sections=[
            Section("engines", "Engines", "Audit; tasks.", [DataTable(numbers(*head), rows)], True)
        ],
        notes=[f"{name}: {one['why']}" for name, one in found.items() if "why" in one],
        document=document(stored, command="engines", seed=0, config=counts),
        exit_code=int(bool(unlike)),
    )
    return publish(report, asked.out)


def _runs(name: str, asked: argparse.Namespace) -> dict[str, Any]:
    """Return what the runs with a change come to. Raises RuntimeError where they cannot be made."""
    folder = asked.out / name
    audit, tasks = (
        "audit --rules physical --only legal" + " --quick" * asked.quick,
        "validate --video none",
    )
    if name in SETTINGS:
        trials = {"audit": asked.rows}
        _audit(name, folder / "audit", asked)
    else:
        trials = {"audit": asked.rows, "tasks": asked.trials}
        installed = name in (REFERENCE, "rollers")
        python = sys.executable if installed else environment(name, folder / "environment")
        common = f"--drive {'rollers' if name == 'rollers' else 'wheels'} --randomize mild --seed 0"
        for command, (run, number) in zip((audit, tasks), trials.items(), strict=True):
            if not _has_run(folder / run, number):
                words = f"{command} {common} --trials {number} --resume --out {folder / run}"
                print(f"{name}: craftsim {words}", flush=True)
                _call([python, "-P", "-c", _COMMAND, *words.split()], (0, 1))
    found = {run: _figures(folder / run) for run in trials}
    if name == REFERENCE:
        return found
    return {
        **found,
        "against": {run: _difference(asked.out / REFERENCE / run, folder / run) for run in trials},
    }


def _has_run(out: Path, trials: int) -> bool:
    report = out / "report.json"
    return (
        report.exists()
        and json.loads(report.read_text(encoding="utf-8"))["config"]["trials"] == trials
    )


def environment(release: str, folder: Path) -> str:
    """Return the Python of an environment with a release. Raises RuntimeError where it does not install or load."""
    python = str(folder / "bin" / "python")
    if not (folder / "installed").exists():
        venv.create(folder, clear=True, symlinks=True)
        own = Path(sysconfig.get_path("purelib", "venv", {"base": str(folder)}))
        (own / "shared.pth").write_text(
            f"import site; site.addsitedir({sysconfig.get_path('purelib')!r})\n"
        )
        pip = [
            sys.executable,
            "-m",
            "pip",
            "--quiet",
            "--disable-pip-version-check",
            "--python",
            python,
        ]
        _call([*pip, "install", "--only-binary", ":all:", f"mujoco=={release}"])
        (folder / "installed").touch()
    _call([python, "-P", "-c", "import craftsim.models.world"])
    return python


def _call(command: list[str], good: tuple[int, ...] = (0,)) -> None:
    """Run a command. Raises RuntimeError with the last line of its errors where it fails."""
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode not in good:
        raise RuntimeError(
            [f"exit status {done.returncode}", *done.stderr.strip().splitlines()][-1]
        )


def _audit(name: str, out: Path, asked: argparse.Namespace) -> None:
    """Run the audit of the reference with other settings of the simulation, if it has not run."""
    if _has_run(out, asked.rows):
        return
    print(f"{name}: audit", flush=True)
    setup = setup_of("mild", drive="wheels")
    setup = replace(setup, simulation=replace(setup.simulation, **SETTINGS[name]))
    legal = [row for row in audit_plan("physical") if row.legal]
    plan = quick_rows(legal, "physical") if asked.quick else legal
    run_audit(
        plan, setup, asked.rows, 0, out, selection={"change": name}, options=RunOptions(resume=True)
    )


def _figures(out: Path) -> dict[str, Any]:
    """Return what the tables need of a run."""
    figures = json.loads((out / "report.json").read_text(encoding="utf-8"))["figures"]
    every = figures["validation"]["all"]
    if "audit" in figures:
        return {"runs": every["runs"], "verdicts": figures["audit"]["verdicts"]}
    by_task: defaultdict[str, Counter[str]] = defaultdict(Counter)
    for record in read_run(out).records:
        good = sum(attempt["result"] in AGREEING for attempt in record["attempts"])
        by_task[str(record["context"])].update(runs=1, actions=len(record["attempts"]), good=good)
    return {"actions": every["actions"], "by_task": by_task}


def _difference(first: Path, other: Path) -> dict[str, Any]:
    """Return how the verdicts of the same trials differ in two runs, where the rules allow what is tried."""
    one, two = (judged_by_rules(read_run(folder).records) for folder in (first, other))
    trials = compare_trials(one, two)
    return {
        "pairs": trials.pairs,
        "differing": trials.only_first + trials.only_second,
        "p_value": trials.p_value,
        "least_detectable": least_detectable(
            trials.difference.low or 0.0, trials.difference.high or 0.0
        ),
        "kinds": [
            "{actions} {kind}: such as {example}".format(**found)
            for found in compare_actions(one, two).differences
        ],
    }


def table_of(stored: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return the table of what is stored, its head first."""
    parts = "rows unsound", "rows' trials", "tasks' actions", "differing", "p", "detectable"
    rows: list[tuple[str, ...]] = [("with", *parts)]
    for name, found in stored["found"].items():
        if "why" in found:
            rows.append((name, "does not load", *[""] * (len(parts) - 1)))
            continue
        verdicts, against = found["audit"]["verdicts"], found.get("against", {}).values()
        row = (
            f"{verdicts['unsound']}/{verdicts['sound'] + verdicts['unsound']}",
            "{successes}/{trials}".format(**found["audit"]["runs"]),
            "{successes}/{trials}".format(**found["tasks"]["actions"]) if "tasks" in found else "",
            "; ".join(f"{one['differing']}/{one['pairs']}" for one in against),
            "; ".join(f"{one['p_value']:.2g}" for one in against),
            "; ".join(f"{100 * one['least_detectable']:.1f} %" for one in against),
        )
        rows.append((name, *row))
    return rows


if __name__ == "__main__":
    sys.exit(main())
