"""Judge the same trials with several releases of MuJoCo, and compare the verdicts trial by trial.

    python scripts/engines.py                        # the releases of RELEASES
    python scripts/engines.py 3.17.0 4.0.0 --rows 5  # some, with five trials a row

Each release has a virtual environment in the output folder that takes every other package from this one. With each,
``craftsim audit --rules physical --only legal`` and ``craftsim validate`` of the six tasks run with mild randomization,
from the same seed; what has run is not run again, and what was interrupted goes on. Every release is compared with the
first one, which is the one of ``constraints.txt``. ``--store`` writes craftsim/data/engines.json, from which
``craftsim doctor`` and docs/explanation/engines.md take what they say.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import sysconfig
import venv
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from craftsim.experiments.compare import RealityGap, compare_with_reality
from craftsim.experiments.intervals import least_detectable
from craftsim.reports.json_file import document, plain
from craftsim.reports.report import Column, DataTable, Headline, Report, Section, Tone
from craftsim.validation.forms import read_run

ROOT: Final = Path(__file__).parents[1]
STORED: Final = ROOT / "craftsim" / "data" / "engines.json"
RELEASES: Final = ("3.17.0", "4.0.0", "3.16.0", "3.14.0", "3.12.0", "3.10.0", "3.9.0")
"""The reference, the next one with its known fault, and older ones down to the last that does not load."""
COLUMNS: Final = (
    Column("MuJoCo"),
    *(Column(name, "number") for name in ("rows unsound", "trials of rows", "actions of tasks")),
    *(Column(name, "number") for name in ("differing trials", "p", "least detectable")),
)


def main() -> int:
    """Run, compare, print and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("releases", nargs="*", default=RELEASES, metavar="RELEASE")
    parser.add_argument("--rows", type=int, default=2, help="trials of each row of the audit")
    parser.add_argument("--trials", type=int, default=10, help="trials of each of the six tasks")
    parser.add_argument("--drive", choices=("reduced", "rollers"), default="reduced")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "engines")
    parser.add_argument("--store", action="store_true", help=f"write {STORED.relative_to(ROOT)}")
    asked = parser.parse_args()
    judged = {"drive": asked.drive, "randomize": "mild", "rows": asked.rows, "trials": asked.trials}
    found = {name: _judge(name, asked.out / name, judged) for name in asked.releases}
    first = asked.releases[0]
    for name, release in found.items():
        if name != first and not (release["why"] or found[first]["why"]):
            release["against"] = {
                run: _difference(asked.out / first / run, asked.out / name / run)
                for run in ("audit", "tasks")
            }
    figures = {"reference": first, "releases": found}
    if asked.store:
        STORED.write_text(json.dumps(plain({"config": judged, **figures}), indent=1, sort_keys=True) + "\n")
    unlike = [name for name, one in found.items() if any(of["differing"] for of in one["against"].values())]
    table = DataTable(COLUMNS, [row(name, one) for name, one in found.items()])
    lead = "As predicted, of all; differing and least detectable: audit, tasks."
    text = f"Trials with other verdicts than {first}: {', '.join(unlike) or 'none'}."
    return Report(
        "Releases of MuJoCo",
        f"compared with {first}",
        Headline("Differs" if unlike else "No difference", Tone.CAUTION if unlike else Tone.GOOD, text),
        sections=[Section("releases", "Releases", lead, [table], terminal=True)],
        notes=[f"{name}: {one['why']}" for name, one in found.items() if one["why"]],
        document=document(figures, command="engines", seed=0, config=judged),
        exit_code=int(bool(unlike)),
    ).publish(asked.out)


def _judge(release: str, folder: Path, judged: dict[str, Any]) -> dict[str, Any]:
    """Return what a release comes to, and ``why`` where it comes to nothing."""
    found: dict[str, Any] = {"why": "", "against": {}}
    common = f"--drive {judged['drive']} --randomize {judged['randomize']} --seed 0"
    commands = {
        "audit": f"audit --rules physical --only legal {common} --trials {judged['rows']}",
        "tasks": f"validate {common} --trials {judged['trials']} --video none",
    }
    try:
        python = _environment(release, folder / "environment")
        for name, command in commands.items():
            found[name] = _figures(name, _run(python, command, folder / name))
    except RuntimeError as error:
        found["why"] = str(error)
    return found


def _environment(release: str, folder: Path) -> str:
    """Return the Python of an environment with a release of MuJoCo, made if there is none.

    Raises RuntimeError where it does not install, or where the physics of craftsim does not load with it.
    """
    if version("mujoco") == release:
        return sys.executable
    python = folder / "bin" / "python"
    if not (folder / "installed").exists():
        venv.create(folder, clear=True, symlinks=True)
        own = Path(sysconfig.get_path("purelib", "venv", {"base": str(folder)}))
        (own / "shared.pth").write_text(f"import site; site.addsitedir({sysconfig.get_path('purelib')!r})\n")
        pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "--python", str(python)]
        _call([*pip, "install", "--only-binary", ":all:", f"mujoco=={release}"])
        (folder / "installed").touch()
    _call([str(python), "-P", "-c", "import craftsim.models.world"])
    return str(python)


def _call(command: list[str]) -> None:
    """Run a command. Raises RuntimeError with the last line of its errors where it fails."""
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.strip()] or [
            f"exit status {done.returncode}"
        ]
        raise RuntimeError(lines[-1])


def _run(python: str, command: str, out: Path) -> dict[str, Any]:
    """Return the report of a run, made or resumed if there is none of this command."""
    report, note = out / "report.json", out.with_suffix(".command")
    if not report.exists() or not note.exists() or note.read_text() != command:
        print(f"{out.parent.name}: craftsim {command}", flush=True)
        resume = ["--resume"] if note.exists() and note.read_text() == command else []
        out.parent.mkdir(parents=True, exist_ok=True)
        note.write_text(command)
        done = subprocess.run(
            [python, "-P", "-m", "craftsim", *command.split(), *resume, "--out", str(out)],
            cwd=ROOT,
            stdout=subprocess.DEVNULL,
            check=False,
        )
        if done.returncode not in (0, 1):
            raise RuntimeError(f"craftsim {command.split()[0]} ended with status {done.returncode}")
    found: dict[str, Any] = json.loads(report.read_text(encoding="utf-8"))
    return found


def _figures(name: str, report: dict[str, Any]) -> dict[str, Any]:
    """Return what the table needs of a report."""
    figures = report["figures"]
    found: dict[str, Any] = dict(figures["validation"]["all"])
    kept = {of: {key: found[of][key] for key in ("successes", "trials")} for of in ("actions", "runs")}
    return kept | ({"verdicts": figures["audit"]["verdicts"]} if name == "audit" else {})


def _difference(first: Path, other: Path) -> dict[str, Any]:
    """Return how the verdicts of the same trials differ in two runs, as ``craftsim compare`` counts them."""
    gap: RealityGap = compare_with_reality(read_run(first), read_run(other))
    trials, difference = gap.trials, gap.trials.difference
    assert difference.low is not None
    assert difference.high is not None
    return {
        "pairs": trials.pairs,
        "differing": trials.only_first + trials.only_second,
        "only_first": trials.only_first,
        "p_value": trials.p_value,
        "least_detectable": least_detectable(difference.low, difference.high),
        "kinds": [f"{one.actions} {one.kind}: such as {one.example}" for one in gap.actions.differences],
    }


def row(name: str, found: dict[str, Any]) -> tuple[str, ...]:
    """Return the cells of a release, as :data:`COLUMNS` names them."""
    if found["why"]:
        return name, found["why"], *[""] * (len(COLUMNS) - 2)
    verdicts, against = found["audit"]["verdicts"], found["against"].values()
    counts = [
        f"{one['successes']:,} of {one['trials']:,}"
        for one in (found["audit"]["runs"], found["tasks"]["actions"])
    ]
    return (
        name,
        f"{verdicts['unsound']} of {verdicts['sound'] + verdicts['unsound']}",
        *counts,
        ", ".join(f"{one['differing']} of {one['pairs']}" for one in against) or "reference",
        ", ".join(f"{one['p_value']:.2g}" for one in against),
        ", ".join(f"{100 * one['least_detectable']:.1f} points" for one in against),
    )


if __name__ == "__main__":
    sys.exit(main())
