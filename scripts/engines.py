"""Judge the same trials with another release of MuJoCo, drive, physics step or solver, and compare the verdicts.

    python scripts/engines.py                         # RELEASES, rollers and SETTINGS: hours
    python scripts/engines.py 4.0.0 rollers --rows 5  # with five trials a row

Each is compared, trial by trial, with the release that is installed and the reduced drive: ``craftsim audit --rules
physical --only legal`` and, for releases, ``craftsim validate`` of the six tasks, with mild randomization from one
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
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from craftsim.experiments.compare import compare_with_reality
from craftsim.experiments.intervals import least_detectable
from craftsim.reports.json_file import document, plain, versions
from craftsim.reports.report import DataTable, Headline, Report, Section, Tone, numbers
from craftsim.validation.forms import read_run

ROOT: Final = Path(__file__).parents[1]
STORED: Final = ROOT / "craftsim" / "data" / "engines.json"
REFERENCE: Final = version("mujoco")
RELEASES: Final = ("4.0.0", "3.16.0", "3.14.0", "3.12.0", "3.10.0", "3.9.0")
"""The next one with its known fault, and older ones down to the newest that does not load."""
SETTINGS: Final[dict[str, dict[str, Any]]] = {
    "1ms": {"timestep_s": 0.001},
    "2ms": {"timestep_s": 0.002},
    "5ms": {"timestep_s": 0.005},
    "pgs": {"solver": "pgs"},
}
"""Steps and a solver; of the audit alone."""


def main() -> int:
    """Run, compare, print and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument(
        "changes", nargs="*", metavar="CHANGE", help=f"releases, or of rollers, {', '.join(SETTINGS)}"
    )
    parser.add_argument(
        "--quick", action="store_true", help="one trial of the rows of a quick audit, four of each task"
    )
    parser.add_argument("--rows", type=int, default=20, help="trials of each row of the audit")
    parser.add_argument("--trials", type=int, default=10, help="trials of each task")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "engines")
    parser.add_argument("--store", action="store_true", help=f"write {STORED.relative_to(ROOT)}")
    asked = parser.parse_args()
    counts = {
        "quick": asked.quick,
        "rows": 1 if asked.quick else asked.rows,
        "trials": 4 if asked.quick else asked.trials,
    }
    found = {}
    for name in dict.fromkeys((REFERENCE, *(asked.changes or (*RELEASES, "rollers", *SETTINGS)))):
        folder = asked.out / name
        try:
            found[name] = _runs(name, folder, counts)
            if name != REFERENCE:
                found[name]["against"] = {
                    run: _difference(asked.out / REFERENCE / run, folder / run) for run in found[name]
                }
        except RuntimeError as error:
            found[name] = {"why": str(error)}
    stored = {"config": counts, "reference": REFERENCE, "versions": versions(), "found": found}
    if asked.store:
        STORED.write_text(json.dumps(plain(stored), indent=1, sort_keys=True) + "\n", encoding="utf-8")
    unlike = [
        name for name, one in found.items() if any(of["differing"] for of in one.get("against", {}).values())
    ]
    text = f"Trials with other verdicts than MuJoCo {REFERENCE} on the reduced drive: {', '.join(unlike) or 'none'}."
    head, *rows = table_of(stored)
    return Report(
        "Engines",
        f"MuJoCo {REFERENCE}, reduced drive, with one change at a time",
        Headline("Differs" if unlike else "No difference", Tone.CAUTION if unlike else Tone.GOOD, text),
        sections=[
            Section("engines", "Engines", "Audit; tasks.", [DataTable(numbers(*head), rows)], terminal=True)
        ],
        document=document(stored, command="engines", seed=0, config=counts),
        exit_code=int(bool(unlike)),
    ).publish(asked.out)


def _runs(name: str, folder: Path, counts: dict[str, int]) -> dict[str, Any]:
    """Return what the runs with a change come to. Raises RuntimeError where they cannot be made."""
    if name in SETTINGS:
        _audit(name, folder / "audit", counts)
        return {"audit": _figures(folder / "audit")}
    is_release = name not in (REFERENCE, "rollers")
    python = _environment(name, folder / "environment") if is_release else sys.executable
    common = f"--drive {'rollers' if name == 'rollers' else 'reduced'} --randomize mild --seed 0"
    commands = {
        "audit": (
            f"audit --rules physical --only legal {'--quick ' * counts['quick']}{common}",
            counts["rows"],
        ),
        "tasks": (f"validate --video none {common}", counts["trials"]),
    }
    for run, (words, trials) in commands.items():
        if not _has_run(folder / run, trials):
            command = f"{words} --trials {trials}"
            print(f"{name}: craftsim {command}", flush=True)
            _call(
                [python, "-P", "-m", "craftsim", *command.split(), "--resume", "--out", str(folder / run)],
                (0, 1),
            )
    return {run: _figures(folder / run) for run in commands}


def _has_run(out: Path, trials: int) -> bool:
    report = out / "report.json"
    return report.exists() and json.loads(report.read_text(encoding="utf-8"))["config"]["trials"] == trials


def _environment(release: str, folder: Path) -> str:
    """Return the Python of an environment with a release of MuJoCo, made if there is none.

    Raises RuntimeError where it does not install, or where the physics of craftsim does not load with it.
    """
    python = str(folder / "bin" / "python")
    if not (folder / "installed").exists():
        venv.create(folder, clear=True, symlinks=True)
        own = Path(sysconfig.get_path("purelib", "venv", {"base": str(folder)}))
        (own / "shared.pth").write_text(f"import site; site.addsitedir({sysconfig.get_path('purelib')!r})\n")
        pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "--python", python]
        _call([*pip, "install", "--only-binary", ":all:", f"mujoco=={release}"])
        (folder / "installed").touch()
    _call([python, "-P", "-c", "import craftsim.models.world"])
    return python


def _call(command: list[str], good: tuple[int, ...] = (0,)) -> None:
    """Run a command. Raises RuntimeError with the last line of its errors where it fails."""
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode not in good:
        raise RuntimeError(
            [f"exit status {done.returncode}", *filter(None, done.stderr.splitlines())][-1].strip()
        )


def _audit(name: str, out: Path, counts: dict[str, int]) -> None:
    """Run the same audit as that of the reference with other settings, which no option of the command has."""
    from craftsim.audit.plan import audit_plan
    from craftsim.audit.quick import quick_rows
    from craftsim.checking.setup import setup_of
    from craftsim.experiments.experiment import RunOptions
    from craftsim.validation.audit import run_audit

    if not _has_run(out, counts["rows"]):
        print(f"{name}: audit", flush=True)
        setup = setup_of("mild", drive="reduced")
        setup = replace(setup, simulation=replace(setup.simulation, **SETTINGS[name]))
        plan = [row for row in audit_plan("physical") if row.legal]
        plan = quick_rows(plan, "physical") if counts["quick"] else plan
        options = RunOptions(resume=True)
        run_audit(plan, setup, counts["rows"], 0, out, asked={"change": name}, options=options)


def _figures(out: Path) -> dict[str, Any]:
    """Return what the table needs of a run's report."""
    figures = json.loads((out / "report.json").read_text(encoding="utf-8"))["figures"]
    every = figures["validation"]["all"]
    kept = {of: {key: every[of][key] for key in ("successes", "trials")} for of in ("actions", "runs")}
    return kept | ({"verdicts": figures["audit"]["verdicts"]} if "audit" in figures else {})


def _difference(first: Path, other: Path) -> dict[str, Any]:
    """Return how the verdicts of the same trials differ in two runs, as ``craftsim compare`` counts them."""
    gap = compare_with_reality(read_run(first), read_run(other))
    trials, bounds = gap.trials, gap.trials.difference
    return {
        "pairs": trials.pairs,
        "differing": trials.only_first + trials.only_second,
        "only_reference": trials.only_first,
        "p_value": trials.p_value,
        "least_detectable": least_detectable(bounds.low or 0.0, bounds.high or 0.0),
        "duration_ratio": gap.actions.duration_ratio,
        "kinds": [f"{one.actions} {one.kind}: such as {one.example}" for one in gap.actions.differences],
    }


def table_of(stored: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return the table of what is stored, its head first; a change that could not be tried says why."""
    parts = "rows unsound", "trials of rows", "actions of tasks", "differing trials", "p", "least detectable"
    rows: list[tuple[str, ...]] = [("reference, or what differs from it", *parts)]
    for name, found in stored["found"].items():
        if "why" in found:
            rows.append((name, found["why"], *[""] * (len(parts) - 1)))
            continue
        verdicts, against = found["audit"]["verdicts"], found.get("against", {}).values()
        row = [
            f"{verdicts['unsound']} of {verdicts['sound'] + verdicts['unsound']}",
            _of(found["audit"]["runs"]),
            _of(found["tasks"]["actions"]) if "tasks" in found else "",
            "; ".join(f"{one['differing']} of {one['pairs']}" for one in against),
            "; ".join(f"{one['p_value']:.2g}" for one in against),
            "; ".join(f"{100 * one['least_detectable']:.1f} points" for one in against),
        ]
        rows.append((name, *row))
    return rows


def _of(share: dict[str, int]) -> str:
    return f"{share['successes']:,} of {share['trials']:,}"


if __name__ == "__main__":
    sys.exit(main())
