"""Insert faults one at a time, and see which instrument finds which, after how many trials.

    python scripts/plants.py                      # all that is not stored for this code: 35 minutes of CPU time
    python scripts/plants.py --faults hinge wheel --instruments validate compare
    python scripts/plants.py --data FOLDER --instruments reality    # recordings that are not part of the project
    python scripts/plants.py rules                # unsound rules, by a quick audit: some minutes each

An instrument is a command that judges: it looks at a copy of the package in which one place is changed, or at another
release of MuJoCo, and at the package as it is with another seed, where whatever it finds is a false alarm. Nothing
of the package exists for these faults. What is measured for the same code is not measured again: each cell of
docs/results/plants.json has its commands, versions, seed and CPU seconds.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import inspect
import json
import os
import re
import resource
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import engines
import numpy as np
from measure_results import MEASURED, revision

from craftsim.discrete.kinds import Correction
from craftsim.discrete.rules import REASONS
from craftsim.reports.json_file import versions

ROOT: Final = Path(__file__).parents[1]
STORED: Final = ROOT / "docs" / "results" / "plants.json"
OUT: Final = ROOT / "out" / "plants"
CODE: Final = (
    "import sys; from craftsim import cli; cli.check_mujoco = lambda: None; sys.exit(cli.main())"
)
"""The command line, for releases of MuJoCo too that it does not allow."""


# Unsound rules, which a quick audit has to find.


@dataclass(frozen=True)
class Plant:
    """What a rule set allows by mistake, and what is changed in the source to that end: a regular expression."""

    rule: str
    file: str
    old: str
    new: str
    places: int = 1
    """How many places match."""


def _without(correction: Correction) -> Plant:
    name = correction.name
    return Plant(
        f"{name} off",
        "discrete/rules.py",
        re.escape('"physical": ~Correction(0)'),
        f'"physical": ~Correction.{name}',
    )


def _never(rule: str, code: str, places: int = 1) -> Plant:
    """Return a plant in which the rules never give a reason."""
    old = rf"code\.{code} \| \w+ << code\.DETAIL_BITS|code\.{code}\b"
    return Plant(rule, "discrete/kernel/rules.py", old, "code.LEGAL", places)


UNFOLDING_ONTO_A_CAR: Final = Plant(
    "unfolding onto a car",
    "discrete/kernel/rules.py",
    re.escape("if car_in(w, me, fx, fy, car.z, False) >= 0 or "),
    "if ",
)
PLANTS: Final = (
    # Coming down a ramp under a block goes wrong in few of many trials: no quick look need find it. Gears that cross do
    # harm in starts in which a load has no room, and these an audit leaves out.
    *(
        _without(reason.correction)
        for reason in REASONS.values()
        if reason.correction not in (None, Correction.run_out, Correction.crossing_gear)
    ),
    _never("lifting or folding with something on top", "THING_ON_TOP", 2),
    _never("driving loaded under a block", "LOAD_NOT_UNDER"),
    _never("driving loaded through a gear", "LOAD_NOT_THROUGH_GEAR"),
    _never("turning under a slope", "TURN_UNDER_SLOPE"),
    _never("leaving a slope sideways", "FORWARD_ONLY"),
    UNFOLDING_ONTO_A_CAR,
    _never("folding with a car on the foot", "CAR_ON_OWN_FOOT"),
    _never("driving into a car's cell", "CAR_THERE"),
    # Standing on what has no top, and driving sideways under a block, are none: forbidden, and in physics they work.
)
SITUATIONS: Final = """
import json
from craftsim.audit.plan import audit_plan
plan = audit_plan("physical")
print(json.dumps({member.id: row.name for row in plan if row.legal for member in row.members}))"""
"""Prints the situations that the rules allow, with their rows."""


def copy_of(place: Path, plant: Plant) -> Path:
    """Copy the package with a plant in it into a folder, and return the file that was changed."""
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "craftsim", place / "craftsim", ignore=ignored)
    source = place / "craftsim" / plant.file
    source.write_text(re.sub(plant.old, plant.new, source.read_text("utf-8")), "utf-8")
    return source


def look(plant: Plant, allowed: dict[str, str]) -> tuple[set[str], set[str], list[str]]:
    """Audit a plant quickly; ``allowed`` has the situations that the rules allow without it.

    Returns the rows of a full audit that hold a situation that only the planted rules allow, those of them that the
    quick one tried, and those that it found unsound.
    """
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        copy_of(place, plant)
        command = "-m craftsim audit --rules physical --quick --workers 2 --out out"
        run = _python(place, *shlex.split(command))
        if run.returncode not in (0, 1) or not (place / "out" / "report.json").exists():
            raise RuntimeError(run.stdout + run.stderr)
        rows = json.loads((place / "out" / "report.json").read_text())["figures"]["audit"]["rows"]
        planted = situations(place)
    new = {row for situation, row in planted.items() if situation not in allowed}
    tried = set()
    unsound = []
    for row in rows:
        row_name = f"{row['action']}/{row['context']}"
        # Others fail now and then by these rules, too.
        if row["legal"] and row_name in new:
            tried.add(row_name)
            if row["verdict"] == "unsound":
                unsound.append(row_name)
    return new, tried, unsound


def situations(place: Path) -> dict[str, str]:
    """Return the situations that the rules of a copy allow, with the names of their rows."""
    return dict(json.loads(_python(place, "-c", SITUATIONS).stdout))


def _python(place: Path, *words: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(place)}
    command = [sys.executable, *words]
    return subprocess.run(
        command, cwd=place, env=environment, capture_output=True, text=True, check=False
    )


def look_at_rules(parts: list[str]) -> int:
    """Print for each plant what a quick audit finds; return 1 if one that changes a row goes unnoticed."""
    allowed = situations(ROOT)
    chosen = [plant for plant in PLANTS if not parts or any(part in plant.rule for part in parts)]
    missed = 0
    for plant in chosen:
        changed, tried, unsound = look(plant, allowed)
        result = "NOT FOUND"
        if unsound:
            result = f"found: {len(unsound)} unsound rows, such as {unsound[0]}"
        elif changed:
            missed += 1
        else:
            result += " (no row of a full audit changes)"
        print(
            f"{plant.rule}: {result}; {len(tried)} of {len(changed)} changed rows tried", flush=True
        )
    print(f"{len(chosen)} plants, {missed} that change a row not found")
    return int(missed > 0)


# Faults of all kinds, and every instrument.


class Fault(NamedTuple):
    """What is wrong: a changed place of the package, another release of MuJoCo, or nothing but another seed."""

    words: str
    plant: Plant | None = None
    release: str = ""
    seed: int = 0


_MODEL: Final = "self.model = compile_spec(self._spec(visual=False))"


def _in_every_world(name: str, *lines: str) -> Plant:
    """Return a plant that changes a world's model as soon as it is compiled."""
    indented = "".join(f"\n        {line}" for line in lines)
    return Plant(name, "models/world.py", re.escape(_MODEL), _MODEL + indented)


HEALTHY: Final = "nothing"
CONTROL: Final = "another seed"
FAULTS: Final = {
    HEALTHY: Fault("nothing"),
    CONTROL: Fault("nothing, with another seed", seed=1),
    "friction": Fault(
        "all tyres have half of their friction, 0.4",
        _in_every_world(
            "friction",
            "from craftsim.models.wheel_contacts import tyres_of",
            "self.model.geom_friction[tyres_of(self.model), 0] *= 0.5",
        ),
    ),
    "hinge": Fault(
        "the servos of all slopes' hinges have a tenth of their stiffness and damping",
        _in_every_world(
            "hinge",
            "for motor in range(self.model.nu):",
            '    if self.model.actuator(motor).name.endswith("hinge"):',
            "        self.model.actuator_gainprm[motor] *= 0.1",
            "        self.model.actuator_biasprm[motor] *= 0.1",
        ),
    ),
    "wheel": Fault(
        "the front left wheel of car 0 is 3 % smaller",
        _in_every_world(
            "wheel",
            "from craftsim.models.wheel_contacts import tyres_of",
            "for tyre in tyres_of(self.model):",
            '    if self.model.geom(tyre).name == "car0/tyre_fl":',
            "        self.model.geom_size[tyre, 0] *= 0.97",
        ),
    ),
    "motor": Fault(
        "the front left motor of car 0 sticks: four times the dry friction, 1.8 of its 2.5 Nm",
        _in_every_world(
            "motor", 'self.model.dof_frictionloss[self.model.joint("car0/wheel_fl").dofadr] *= 4'
        ),
    ),
    "solver": Fault(
        "the solver stops after 5 iterations",
        Plant("solver", "models/config.py", r"(solver_iterations: .* = )1000\b", r"\g<1>5"),
    ),
    "MuJoCo 4.0.0": Fault(
        "the release itself, which hands its solver a wrong Hessian", release="4.0.0"
    ),
    "rule": Fault("slopes may unfold onto a car: two rows", UNFOLDING_ONTO_A_CAR),
    "learner": Fault(
        "the target network never follows",
        Plant(
            "learner", "learning/networks.py", r"(\[\*online\.parameters\(\)\], )rate", r"\g<1>0.0"
        ),
    ),
    "pairing": Fault(
        "the trials of the second run have each other's names",
        Plant(
            "pairing",
            "experiments/compare.py",
            re.escape("return without_keys(all_first, keys), without_keys(all_second, keys)"),
            "seconds = list(without_keys(all_second, keys))\n"
            '    names = np.random.default_rng(0).permutation([each["key"] for each in seconds]).tolist()\n'
            '    seconds = [{**each, "key": name} for each, name in zip(seconds, names, strict=True)]\n'
            "    return without_keys(all_first, keys), seconds",
        ),
    ),
}
PHYSICAL: Final = ("friction", "hinge", "wheel", "motor", "solver", "MuJoCo 4.0.0")


class Reading(NamedTuple):
    """What an instrument says of a fault."""

    seen: bool
    at: int | None
    """Trials (pairs, seconds, steps) after which it says so, of ``of``."""
    of: int
    figure: str
    misses: str = ""
    """What it need not see, from its own numbers."""


class Bench:
    """Runs of the command line under each fault, kept in folders."""

    def __init__(self, out: Path, data: Path | None = None) -> None:
        """Take up what the folder has of this code; ``data`` is a folder with recordings."""
        self.out = out
        self.data = data
        self.cpu_s = 0.0
        """Of what ran or had run, since it was last set to 0."""
        self.commands: list[str] = []
        self.copied: set[str] = set()
        """Faults whose copies of the package are those of now."""

    def run(self, fault: str, name: str, command: str, program: str = "") -> Path:
        """Return the folder of a run, which is made unless it is there. Raises RuntimeError if it fails.

        ``program`` is the fault that the program has, where it is not the fault of what it looks at.
        """
        folder = self.out / folder_of(fault) / name
        stamp = folder.with_suffix(".json")
        words = command.format(seed=FAULTS[fault].seed, folder=folder_of(fault))
        self.commands.append(f"craftsim {words}")
        wanted = {
            "code": digest_of_code(words.split()[0]),
            "command": words,
            "fault": _text_of(fault),
        }
        if stamp.exists():
            kept = json.loads(stamp.read_text())
            if {key: kept[key] for key in wanted} == wanted:
                self.cpu_s += kept["cpu_s"]
                return folder
        shutil.rmtree(folder, ignore_errors=True)
        print(f"{fault}: craftsim {words}", flush=True)
        before = _cpu_s()
        done = self.call(program or fault, "-c", CODE, *shlex.split(words), "--out", str(folder))
        cpu_s = _cpu_s() - before
        if done.returncode not in (0, 1):
            raise RuntimeError(f"{fault}, {words}: {done.stdout}{done.stderr}")
        kept = {**wanted, "cpu_s": round(cpu_s, 1), "status": done.returncode}
        stamp.write_text(json.dumps(kept, indent=1) + "\n")
        self.cpu_s += cpu_s
        return folder

    def status(self, folder: Path) -> int:
        """Return the exit status of a run."""
        return int(json.loads(folder.with_suffix(".json").read_text())["status"])

    def call(self, fault: str, *words: str) -> subprocess.CompletedProcess[str]:
        """Run Python with the package that has the fault."""
        package, python = self.package(fault)
        environment = os.environ | {"PYTHONPATH": str(package), "OMP_NUM_THREADS": "1"}
        command = [python, "-P", *words]
        return subprocess.run(
            command, cwd=self.out, env=environment, capture_output=True, text=True, check=False
        )

    def package(self, fault: str) -> tuple[Path, str]:
        """Return the folder of the package with a fault, and the Python that runs it."""
        plant = FAULTS[fault].plant
        release = FAULTS[fault].release
        place = self.out / folder_of(fault)
        place.mkdir(parents=True, exist_ok=True)
        if release:
            return ROOT, engines.environment(release, place / "environment")
        if plant is None:
            return ROOT, sys.executable
        package = place / "package"
        if fault not in self.copied:
            shutil.rmtree(package, ignore_errors=True)
            copy_of(package, plant)
            self.copied.add(fault)
        return package, sys.executable


def folder_of(fault: str) -> str:
    """Return the name of the folder of a fault's runs."""
    return fault.replace(" ", "_")


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _text_of(fault: str) -> str:
    """Return what a fault changes, as text."""
    plant = FAULTS[fault].plant
    if plant is None:
        return FAULTS[fault].release
    return f"{plant.file}: {plant.old} -> {plant.new}"


SHOWING: Final = ("rendering/", "reports/", "cli/", "envs/", "designs/")
"""Rooms on which no figure here depends."""
COMPARING: Final = ("experiments/compare.py", "experiments/compare_report.py")
TUNING: Final = ("tuning/tune.py", "tuning/tune_report.py")
OTHERS: Final = {
    "validate": ("audit/", "tuning/", "learning/", "reality/", *COMPARING),
    "audit": ("tuning/", "learning/", "reality/", *COMPARING),
    "robot": ("audit/", "validation/", "learning/", "reality/", *TUNING, *COMPARING),
    "reality": ("audit/", "validation/", "learning/", "planning/", *TUNING, *COMPARING),
    "compare": ("audit/", "tuning/", "learning/", "reality/"),
    "train": (
        *("mjcf/", "models/", "skills/", "checking/", "robots/", "planning/"),
        *("validation/", "audit/", "tuning/", "reality/", *COMPARING),
    ),
}
"""By command: rooms, and modules, on which its figures do not depend, for it imports none of them."""


@cache
def digest_of_code(command: str) -> str:
    """Return a digest of that part of the package on which the figures of a command depend.

    Comments and docstrings are left out, and rooms that only show or that are for other commands.
    """
    left_out = (*SHOWING, *OTHERS[command])
    digest = hashlib.sha256()
    package = ROOT / "craftsim"
    for path in sorted(package.rglob("*")):
        if str(path.relative_to(package)).startswith(left_out):
            continue
        if path.suffix == ".py":
            tree = ast.parse(path.read_text("utf-8"))
            for node in ast.walk(tree):
                body = getattr(node, "body", None)
                if isinstance(body, list):
                    node.body = [part for part in body if not _is_docstring(part)]  # type: ignore[attr-defined]
            digest.update(ast.dump(tree).encode())
        elif path.suffix in (".yaml", ".csv", ".xml"):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _is_docstring(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


LEGAL: Final = "audit --rules physical --only legal --randomize mild --seed {seed}"
PLAN: Final = "validate simple_two_story --randomize mild --seed {seed} --trials 20 --video none"
CERTIFIED: Final = 0.95
CERTIFICATE: Final = (
    f"validate simple_two_story --certify {CERTIFIED} --trials 200 --randomize mild --seed {{seed}} "
    "--video none"
)
N_TOSSES: Final = 60
DRIVEN_S: Final = 30.0
"""Of each drive."""
RECORDINGS: Final = [word for word in MEASURED["reality"].split() if word.endswith(".npz")]
REALITY: Final = f"reality {' '.join(f'recordings/{name}' for name in RECORDINGS)} --seed {{seed}}"
MARGINS: Final = "audit margins friction motor-strength --quick --situations '[cf]*' --seed {seed}"
EXCITE: Final = "robot excite --duration 30 --randomize none --noise mild --seed {seed}"
N_SEEDS: Final = 4
STUDY: Final = """title: Target networks
tasks: [strip]
algos: [vdn]
seeds: {seeds}
steps: 50000
until: 0.99
episodes: 20
settings: {{worlds: 10, width: 32, evaluate_every: 5000, evaluation_episodes: 1}}
"""


def _figures(folder: Path) -> dict[str, Any]:
    figures: dict[str, Any] = json.loads((folder / "report.json").read_text("utf-8"))["figures"]
    return figures


def _records(folder: Path) -> list[dict[str, Any]]:
    lines = (folder / "trials.jsonl").read_text("utf-8").splitlines()
    return [json.loads(line) for line in lines]


def _first(agreeing: list[bool]) -> int | None:
    """Return the number, from 1, of the first that does not agree."""
    if all(agreeing):
        return None
    return agreeing.index(False) + 1


def _share_missed(trials: int) -> str:
    """Return the largest share of failures that so many trials without one leave possible."""
    return f"less than {100 * (1 - 0.05 ** (1 / trials)):.1f} % failing"


def _audit(bench: Bench, fault: str, name: str, command: str) -> Reading:
    folder = bench.run(fault, name, command)
    rows = _figures(folder)["audit"]["rows"]
    unsound = {f"{row['action']}/{row['context']}" for row in rows if row["verdict"] == "unsound"}
    records = _records(folder)
    at = None
    for number, record in enumerate(records, 1):
        given_up = any(attempt["result"] == "numerics" for attempt in record["attempts"])
        found = record["group"] in unsound and not record["agrees"]
        if at is None and (found or given_up):
            at = number
    good = sum(record["agrees"] for record in records)
    figure = f"{len(unsound)}/{len(rows)} rows unsound, {good}/{len(records)} trials"
    seen = bench.status(folder) == 1
    return Reading(seen, at, len(records), figure, _share_missed(len(records)))


def quick_audit(bench: Bench, fault: str) -> Reading:
    """Return what the quick audit of the allowed rows says."""
    return _audit(bench, fault, "quick", f"{LEGAL} --quick --trials 1")


def full_audit(bench: Bench, fault: str) -> Reading:
    """Return what the full audit says of the rows with a neighbour."""
    return _audit(bench, fault, "full", f"{LEGAL} --situations '*near=*' --trials 20")


def validate(bench: Bench, fault: str) -> Reading:
    """Return what 20 runs of a plan say."""
    folder = bench.run(fault, "validate", PLAN)
    agreeing = [record["agrees"] for record in _records(folder)]
    figure = f"{sum(agreeing)}/{len(agreeing)} runs"
    seen = bench.status(folder) == 1
    return Reading(seen, _first(agreeing), len(agreeing), figure, _share_missed(len(agreeing)))


PAIRS: Final = """
import json, sys
from dataclasses import replace
from pathlib import Path
from craftsim.experiments.compare import compare_with_reality
from craftsim.experiments.intervals import least_detectable
from craftsim.validation.record_schemas import read_run
first, second = (read_run(Path(folder)) for folder in sys.argv[1:3])
total = min(len(first.records), len(second.records))
for n in sorted({min(total, 5 * 2**k) for k in range(9)}):
    gap = compare_with_reality(
        replace(first, records=list(first.records)[:n]), replace(second, records=list(second.records)[:n])
    )
    trials = gap.trials
    differing = trials.only_first + trials.only_second
    interval = trials.difference
    print(json.dumps({
        "n": n, "agrees": gap.agrees, "differing": differing, "pairs": trials.pairs, "p": trials.p_value,
        "durations": gap.other_durations,
        "detectable": least_detectable(interval.low, interval.high),
    }))
"""
"""Compares the first pairs of two runs, and more and more of them: prints a line for each number."""


def _pairs(bench: Bench, fault: str, first: Path, second: Path) -> list[dict[str, Any]]:
    before = _cpu_s()
    done = bench.call(fault, "-c", PAIRS, str(first), str(second))
    if done.returncode:
        raise RuntimeError(done.stderr)
    bench.cpu_s += _cpu_s() - before
    return [json.loads(line) for line in done.stdout.splitlines()]


def compare(bench: Bench, fault: str) -> Reading:
    """Return what the comparison of two validations says: without and with the fault.

    The fault of the pairing is looked for in a run of which half fails, compared with itself.
    """
    first = bench.run(HEALTHY, "validate", PLAN)
    second = first
    program = HEALTHY
    if fault == "pairing":
        program = fault
        first = bench.run("motor", "validate", PLAN)
        second = first
    elif fault != HEALTHY:
        second = bench.run(fault, "validate", PLAN)
    steps = _pairs(bench, program, first, second)
    last = steps[-1]
    at = next((step["n"] for step in steps if not step["agrees"]), None)
    figure = f"{last['differing']}/{last['pairs']} differ, p {last['p']:.2g}"
    if last["durations"]:
        figure += f", durations of {', '.join(last['durations'])}"
    seen = not last["agrees"]
    misses = f"less than {100 * last['detectable']:.0f} points"
    if fault == "pairing":
        # A run differs from itself in nothing.
        seen = last["differing"] > 0
        at = next((step["n"] for step in steps if step["differing"]), None)
    return Reading(seen, at if seen else None, last["pairs"], figure, misses)


def engine_table(bench: Bench, fault: str) -> Reading:
    """Return what the table of engines says: trials of a quick audit and of a plan with other verdicts."""
    folders = {}
    for name, command in (("quick", f"{LEGAL} --quick --trials 1"), ("validate", PLAN)):
        folders[name] = (bench.run(HEALTHY, name, command), bench.run(fault, name, command))
    differing = []
    of = 0
    at = None
    for first, second in folders.values():
        steps = _pairs(bench, HEALTHY, first, second)
        by_key = {record["key"]: record["agrees"] for record in _records(second)}
        for number, record in enumerate(_records(first), of + 1):
            if at is None and by_key.get(record["key"], record["agrees"]) != record["agrees"]:
                at = number
        last = steps[-1]
        of += last["pairs"]
        differing.append(f"{last['differing']}/{last['pairs']}")
    figure = f"{'; '.join(differing)} differ"
    return Reading(at is not None, at, of, figure, _share_missed(of))


def margins(bench: Bench, fault: str) -> Reading:
    """Return what the margins of two imperfections say; two differ where their intervals have nothing in common."""
    before = _margins_of(bench, HEALTHY)
    after = _margins_of(bench, fault)
    moved = 0
    tried = 0
    texts = []
    for name, margin in after.items():
        tried += margin["tried"]
        healthy = before[name]
        change = (margin["margin"] or 0.0) - (healthy["margin"] or 0.0)
        texts.append((change, f"{name} {_percent(margin)} (was {_percent(healthy)})"))
        fails = margin["end"] == "BASE"
        moved += fails or _is_below(margin, healthy) or _is_below(healthy, margin)
    figure = f"{moved}/{len(after)} moved: {min(texts)[1]}"
    seen = moved > 0
    return Reading(seen, tried if seen else None, tried, figure, "less than an interval")


def _is_below(lower: dict[str, Any], higher: dict[str, Any]) -> bool:
    """Return whether the interval of a margin ends before another begins."""
    return lower["upper"] is not None and lower["upper"] <= (higher["margin"] or 0.0)


def _percent(margin: dict[str, Any]) -> str:
    if margin["margin"] is None:
        return "fails at nominal"
    upper = ">= " * (margin["upper"] is None)
    return f"{upper}{100 * margin['margin']:.3g} %"


def _margins_of(bench: Bench, fault: str) -> dict[str, dict[str, Any]]:
    folder = bench.run(fault, "margins", MARGINS)
    by_name = {}
    for margin in _figures(folder)["margins"]["scenarios"]:
        by_name[f"{margin['action']} {margin['axis']}"] = margin
    return by_name


BONFERRONI: Final = 1.5
"""By so much wider than one interval at 95 % are ten that hold together."""


def identification(bench: Bench, fault: str) -> Reading:
    """Return what identification says of a car that differs from the assumed one, from half a minute's drive."""
    capped_steps = _figures(bench.run(fault, "excite", EXCITE))["capped_steps"]
    command = "robot identify {folder}/excite/log.csv"
    folder = bench.run(fault, "identify", command, program=HEALTHY)
    figures = _figures(folder)
    estimates = figures["estimates"]
    parts = [
        f"friction {_estimate(estimates['smartcar.roller_friction'])}",
        f"misfit {max(figures['misfit'].values()):.1f}",
    ]
    if capped_steps:
        parts.append(f"the solver gave up in {capped_steps} steps")
    ratios = " ".join(figures["untold"])
    differing = []
    for name, estimate in estimates.items():
        half_width = estimate["half_width_95"]
        # What the log tells only as a ratio to other figures is no figure.
        if not half_width or estimate["what"] in ratios or not name.startswith("smartcar."):
            continue
        if abs(estimate["value"] - estimate["assumed"]) > BONFERRONI * half_width:
            differing.append(name)
    if figures["fits"]:
        for name in differing:
            if name != "smartcar.roller_friction":
                parts.append(f"{name.removeprefix('smartcar.')} {_estimate(estimates[name])}")
    seen = capped_steps > 0 or not figures["fits"] or bool(differing)
    return Reading(seen, 30 if seen else None, 30, ", ".join(parts), "less than its intervals")


def _estimate(estimate: dict[str, Any]) -> str:
    if estimate["half_width_95"]:
        return f"{estimate['value']:.3g} +- {estimate['half_width_95']:.2g}"
    if estimate["range"]:
        low, high = estimate["range"]
        return f"{low:.2g} to {high:.2g}"
    return "not identifiable"


def certify(bench: Bench, fault: str) -> Reading:
    """Return whether a plan is certified to succeed in so large a share of its runs; "no" is what sees a fault."""
    folder = bench.run(fault, "certify", CERTIFICATE)
    certificate = _figures(folder)["certificates"][0]
    decision = certificate["decision"]
    trials = certificate["trials"]
    misses = f"undecided after {trials}"
    if decision == "yes":
        misses = f"less than {100 * (1 - CERTIFIED):.0f} % failing"
    figure = f"{decision}, {certificate['successes']}/{trials} runs"
    seen = decision == "no"
    return Reading(seen, trials if seen else None, trials, figure, misses)


def reality(bench: Bench, fault: str) -> Reading:
    """Return what recordings say: two figures of a report differ where their intervals have nothing in common.

    Tosses are the first recording. Drives are read together, for a robot is fitted to some and tested on the others.
    """
    _write_recordings(bench)
    before = _figures(bench.run(HEALTHY, "reality", REALITY))
    after = _figures(bench.run(fault, "reality", REALITY))
    n_figures = 0
    at = None
    moves = []
    for part, recordings in (("contact_law", 1), ("driving", len(RECORDINGS))):
        healthy = _intervals(before[part])
        for name, interval in _intervals(after[part]).items():
            if name not in healthy:
                continue
            n_figures += 1
            low, high = healthy[name]
            gap = max(interval[0] - high, low - interval[1])
            if gap > 0:
                at = at or recordings
                text = f"{name} {_ends(interval)} (was {_ends(healthy[name])})"
                moves.append((gap / (high - low), text))
    figure = f"{len(moves)}/{n_figures} moved"
    if moves:
        figure += f": {max(moves)[1]}"
    return Reading(bool(moves), at, len(RECORDINGS), figure, "less than an interval")


def _ends(interval: tuple[float, float]) -> str:
    low, high = interval
    return f"{low:.5g} to {high:.5g}"


def _intervals(figures: Any, name: str = "") -> dict[str, tuple[float, float]]:
    """Return the intervals of all that a part of a report has, by its name there."""
    intervals = {}
    if isinstance(figures, list):
        for number, part in enumerate(figures):
            title = str(number)
            if isinstance(part, dict):
                title = next((word for word in part.values() if isinstance(word, str)), title)
            intervals |= _intervals(part, f"{name} {title}".strip())
    if not isinstance(figures, dict):
        return intervals
    if figures.get("low") is not None and figures["low"] < figures["high"]:
        return {name: (figures["low"], figures["high"])}
    if figures.get("range"):
        low, high = figures["range"]
        return {name: (low, high)}
    if figures.get("half_width_95"):
        half_width = figures["half_width_95"]
        return {name: (figures["value"] - half_width, figures["value"] + half_width)}
    for key, part in figures.items():
        intervals |= _intervals(part, f"{name} {key}".strip())
    return intervals


def _write_recordings(bench: Bench) -> None:
    """Write the first tosses, and the beginnings of the drives, to where the runs read them."""
    assert bench.data is not None
    folder = bench.out / "recordings"
    folder.mkdir(parents=True, exist_ok=True)
    for name in RECORDINGS:
        with np.load(bench.data / name) as arrays:
            recording = dict(arrays)
        if "length" in recording:
            recording["length"] = recording["length"][:N_TOSSES]
            recording["states"] = recording["states"][: recording["length"].sum()]
        else:
            first_s = max(recording["wheels"][0, 1], recording["pose"][0, 1])
            for part in ("wheels", "pose"):
                is_early = recording[part][:, 1] <= first_s + DRIVEN_S
                recording[part] = recording[part][is_early]
        np.savez(folder / name, **recording)


def study(bench: Bench, fault: str) -> Reading:
    """Return what a study says of four trainings."""
    program = fault
    seeds = N_SEEDS
    if fault in (HEALTHY, CONTROL):
        # The control's are the seeds that come after.
        program = HEALTHY
        seeds = 2 * N_SEEDS
    name = f"study{seeds}.yaml"
    bench.out.mkdir(parents=True, exist_ok=True)
    (bench.out / name).write_text(STUDY.format(seeds=seeds), "utf-8")
    folder = bench.run(program, "study", f"train study {name}")
    runs = _figures(folder)["runs"]
    runs = runs[N_SEEDS:] if fault == CONTROL else runs[:N_SEEDS]
    steps = [run["steps"] for run in runs]
    learned = [run["evaluations"]["strip"]["success"]["rate"] >= 0.99 for run in runs]
    figure = (
        f"{sum(learned)}/{len(learned)} learned, median {sorted(steps)[len(steps) // 2]:,} steps"
    )
    seen = not all(learned)
    of = sum(steps)
    at = None
    if seen:
        at = sum(steps[: learned.index(False) + 1])
    return Reading(seen, at, of, figure, _share_missed(len(learned)))


INSTRUMENTS: Final[dict[str, Callable[[Bench, str], Reading]]] = {
    "quick audit": quick_audit,
    "full audit": full_audit,
    "validate": validate,
    "certify": certify,
    "compare": compare,
    "margins": margins,
    "identify": identification,
    "reality": reality,
    "engines": engine_table,
    "study": study,
}
COMMAND: Final = {
    "quick audit": "audit",
    "full audit": "audit",
    "validate": "validate",
    "certify": "validate",
    "compare": "compare",
    "margins": "audit",
    "identify": "robot",
    "reality": "reality",
    "engines": "compare",
    "study": "train",
}
"""The command on whose code an instrument depends."""
UNITS: Final = {
    "certify": "runs",
    "compare": "pairs",
    "engines": "pairs",
    "identify": "s",
    "reality": "recordings",
    "study": "steps",
}
"""Of what "at" counts; trials unless given."""
ABSENT: Final = {
    "quick audit": {"learner": "no learner", "pairing": "no pairs"},
    "full audit": {"learner": "no learner", "pairing": "no pairs"},
    "validate": {"learner": "no learner", "pairing": "no pairs"},
    "certify": {"learner": "no learner", "pairing": "no pairs"},
    "compare": {"learner": "no learner"},
    "margins": {
        "rule": "no such scenario",
        "learner": "no learner",
        "pairing": "other pairs",
    },
    "identify": {
        "hinge": "no slope",
        "rule": "no rules",
        "learner": "no learner",
        "pairing": "no pairs",
    },
    "reality": {
        "hinge": "no slope",
        "rule": "no rules",
        "learner": "no learner",
        "pairing": "no pairs",
    },
    "engines": {
        "learner": "no learner",
        "pairing": "no failure to pair",
    },
    "study": {
        **dict.fromkeys(PHYSICAL, "on grid"),
        "rule": "judges by the same",
        "pairing": "no pairs",
    },
}
"""Why an instrument does not look at a part at all."""
BLIND: Final = {
    ("validate", "rule"): "in no plan",
    ("certify", "rule"): "in no plan",
    ("reality", "motor"): "wheels turn as measured",
    ("compare", "rule"): "in no plan",
    ("engines", "rule"): "drops unpaired rows",
}
"""Why an instrument cannot see what it looks at, however long; what is not here is a matter of trials."""


def measure(bench: Bench, instrument: str, fault: str) -> dict[str, Any]:
    """Return a cell of the table: what an instrument says of a fault, and of the package without it."""
    if fault in ABSENT[instrument]:
        return {"seen": None, "why": ABSENT[instrument][fault]}
    healthy = INSTRUMENTS[instrument](bench, HEALTHY)
    bench.cpu_s = 0.0
    bench.commands = []
    reading = INSTRUMENTS[instrument](bench, fault)
    cell = {
        "seen": reading.seen,
        "at": reading.at,
        "of": reading.of,
        "figure": reading.figure,
        "healthy": healthy.figure,
        "commands": list(dict.fromkeys(bench.commands)),
        "seed": FAULTS[fault].seed,
        "cpu_s": round(bench.cpu_s, 1),
    }
    if not reading.seen:
        cell["why"] = BLIND.get((instrument, fault), reading.misses)
    return cell


def main(words: list[str]) -> int:
    """Measure what is not stored for this code, store it, and print the table."""
    if words[:1] == ["rules"]:
        return look_at_rules(words[1:])
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    faults = [fault for fault in FAULTS if fault != HEALTHY]
    parser.add_argument("--faults", nargs="+", choices=faults, default=faults)
    parser.add_argument("--instruments", nargs="+", choices=INSTRUMENTS, default=[*INSTRUMENTS])
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the runs")
    parser.add_argument("--data", type=Path, help=f"folder with {', '.join(RECORDINGS)}")
    asked = parser.parse_args(words)
    stored = read_stored()
    bench = Bench(asked.out.resolve(), asked.data)
    for instrument in asked.instruments:
        if instrument == "reality" and asked.data is None:
            print("reality needs --data: what is stored of it stays", flush=True)
            continue
        row = stored["cells"].setdefault(instrument, {})
        for fault in asked.faults:
            key = key_of(instrument, fault)
            cell = row.get(fault, {})
            known = {name: cell.get(name) for name in key} == key
            if not known or fault in ABSENT[instrument]:
                cell = measure(bench, instrument, fault)
                row[fault] = key | {"revision": revision(), "versions": versions()} | cell
                STORED.write_text(json.dumps(stored, indent=1) + "\n", "utf-8")
            print(f"{instrument}, {fault}: {said(row[fault], instrument)}", flush=True)
    return 0


def key_of(instrument: str, fault: str) -> dict[str, str]:
    """Return what a cell is of: package, fault, and how the instrument is read."""
    code = digest_of_code(COMMAND[instrument])
    source = inspect.getsource(INSTRUMENTS[instrument])
    reading = hashlib.sha256(source.encode()).hexdigest()[:16]
    return {"code": code, "fault": _text_of(fault), "reading": reading}


def read_stored() -> dict[str, Any]:
    """Return what is stored."""
    if STORED.exists():
        stored: dict[str, Any] = json.loads(STORED.read_text("utf-8"))
        return stored
    return {"command": "scripts/plants.py", "cells": {}}


def matrix(stored: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return the table of all cells, its head first: after how much of what was tried a fault is seen, or why not."""
    cells = stored["cells"]
    rows: list[tuple[str, ...]] = [("fault", *INSTRUMENTS)]
    for fault in FAULTS:
        if fault != HEALTHY:
            rows.append((fault, *(short(cells[name][fault], fault) for name in INSTRUMENTS)))
    return rows


def short(cell: dict[str, Any], fault: str) -> str:
    """Return a cell for the table of all."""
    if cell["seen"] is None:
        return f"({cell['why']})"
    if cell["seen"]:
        return f"**{cell['at']:,}**/{cell['of']:,}"
    if fault == CONTROL:
        return "no"
    why = cell["why"].replace("less than", "<").removesuffix(" failing")
    return f"no: {why}"


def row_of(stored: dict[str, Any], instrument: str) -> list[tuple[str, ...]]:
    """Return the table of an instrument, its head first, with the figures that show a fault and those without it."""
    unit = UNITS.get(instrument, "trials")
    rows: list[tuple[str, ...]] = [("fault", f"seen after, {unit}", "with it", "without")]
    for fault, cell in stored["cells"][instrument].items():
        rows.append((fault, short(cell, fault), cell.get("figure", "-"), cell.get("healthy", "-")))
    return rows


def said(cell: dict[str, Any], instrument: str) -> str:
    """Return a cell in words."""
    if cell["seen"] is None:
        return f"does not look: {cell['why']}"
    figure = f"{cell['figure']} (healthy: {cell['healthy']})"
    if cell["seen"]:
        return f"seen at {cell['at']} of {cell['of']} {UNITS.get(instrument, 'trials')}: {figure}"
    return f"not seen: {figure}; {cell['why']}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
