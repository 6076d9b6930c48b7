"""Plan the structures of the collective-construction literature, and build them in contact physics.

    python scripts/structures.py plan                            # all sets
    python scripts/structures.py plan 7x7x3 --trials 60
    python scripts/structures.py build house wall --drive rollers

The same command goes on where it was cut off. What it has found so far is stored in docs/results/structures.json, of
which scripts/results.py makes a table. Structure N of a random set is that of
``craftsim design random --size ... --cars 4 --seed N``.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np
from measure_results import revision

from craftsim.checking.setup import Seed, set_up, setup_of
from craftsim.designs.drawn import random_structure
from craftsim.designs.library import make_design
from craftsim.designs.starts import DesignStart, make_start
from craftsim.designs.tasks import shape_digest
from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
from craftsim.experiments.experiment import Experiment, Result, RunOptions, Trial
from craftsim.experiments.intervals import Proportion
from craftsim.experiments.session import open_session
from craftsim.mjcf.drives import Drive
from craftsim.planning import NoPlanError, Planned, plan_building
from craftsim.reports.json_file import json_value
from craftsim.tasks.starts import targets_of

ROOT: Final = Path(__file__).parents[1]
STORED: Final = ROOT / "docs" / "results" / "structures.json"
LIMIT_S: Final = 60.0
"""CPU time in which a plan counts as found."""
TIMEOUT_S: Final = 24 * 3600.0
BLOCK_MM3: Final = 1e9 * CELL_PITCH_M**2 * LEVEL_HEIGHT_M
"""What a block fills of a structure: its cell."""


@dataclass(frozen=True)
class Structures:
    """One design, or as many random ones."""

    design: str
    size: tuple[int, ...]
    cars: int
    number: int = 1

    def start(self, seed: int) -> DesignStart:
        """Return a structure with its start."""
        rng = np.random.default_rng(seed)
        if self.design == "random":
            return make_start(random_structure(self.size, rng), self.cars, rng)
        return make_start(make_design(self.design, self.size), self.cars, rng)


SETS: Final = {
    "7x7x3": Structures("random", (7, 7, 3), 4, 200),
    "10x10x4": Structures("random", (10, 10, 4), 4, 200),
    "house": Structures("house", (9, 9, 1), 24),
    "pyramid": Structures("pyramid", (5,), 4),
    "wall": Structures("wall", (25, 2, 2), 8),
}
"""200 random structures of two sizes (Srinivasan et al. 2023), a single-storey house with 24 cars (ReRamp 2024), a
pyramid of 35 blocks and a wall of 100."""


@dataclass(frozen=True)
class Job:
    """A structure to plan, and with a drive to build."""

    name: str
    seed: int
    drive: Drive | None


def first_plan(start: DesignStart) -> tuple[Planned | None, float]:
    """Return the first plan that is found in LIMIT_S of CPU time, and how much of it that took."""
    begun_s = time.process_time()

    def is_enough(number: int, best: Planned | None) -> bool:
        return best is not None or time.process_time() - begun_s > LIMIT_S

    found = None
    with suppress(NoPlanError):
        found = plan_building(
            start.grid, start.design, rounds=sys.maxsize, time_s=np.inf, report=is_enough
        )
    took_s = time.process_time() - begun_s
    return (found if took_s <= LIMIT_S else None), took_s


def attempt(job: Job) -> Result:
    """Plan a structure, and build it where a drive is given."""
    start = SETS[job.name].start(job.seed)
    planned, took_s = first_plan(start)
    extra: dict[str, Any] = {
        "blocks": len(start.design.targets),
        "shape": shape_digest(targets_of(start.design)).hex()[:16],
        "plan_s": round(took_s, 3),
        "planned": planned is not None,
    }
    if planned is None:
        return Result(False, extra=extra)
    extra |= {"makespan_s": planned.makespan_s, "actions": sum(map(len, planned.ticks))}
    if job.drive is None:
        return Result(True, extra=extra)
    setup = setup_of("mild", drive=job.drive)
    judge = set_up(start.grid, setup, Seed((job.seed,)))
    begun_s = time.process_time()
    attempts = judge.perform_plan(planned.ticks, "concurrent")
    performed = [one for one in attempts if one.performed]
    wrong = next((one for one in attempts if not one.agrees), None)
    extra |= {
        "built": not judge.problems and start.design.satisfied(judge.grid),
        "agree": sum(one.agrees for one in attempts),
        "executed_s": max((one.start_s + one.duration_s for one in performed), default=0.0),
        "physics_s": round(time.process_time() - begun_s, 1),
        "first_wrong": None if wrong is None else f"{wrong.action}: {wrong.result}, {wrong.reason}",
    }
    return Result(extra["built"], extra=extra)


def figures_of(records: Sequence[dict[str, Any]], cars: int, drive: Drive | None) -> dict[str, Any]:
    """Return what the trials of a set come to; None and 0 of what no trial has."""
    planned = [one for one in records if one["planned"]]

    def spread(key: str, some: Sequence[dict[str, Any]]) -> list[float]:
        values = [one[key] for one in some]
        return [min(values), median(values), max(values)] if values else []

    found: dict[str, Any] = {
        "cars": cars,
        "distinct": len({one["shape"] for one in records}),
        "blocks": spread("blocks", records),
        "planned": Proportion.of(len(planned), len(records)),
        "plan_s": spread("plan_s", planned),
        "makespan_s": spread("makespan_s", planned),
        "actions": spread("actions", planned),
    }
    done, took = planned, "makespan_s"
    if drive is not None:
        done, took = [one for one in planned if one["built"]], "executed_s"
        agree, actions = (sum(one[key] for one in planned) for key in ("agree", "actions"))
        found |= {
            "built": Proportion.of(len(done), len(planned)),
            "as_predicted": Proportion.of(agree, actions),
            "executed_s": spread("executed_s", done),
            "physics_s": spread("physics_s", planned),
            "first_wrong": [one["first_wrong"] for one in planned if one["first_wrong"]],
        }
    hours = sum(one[took] for one in done) / 3600
    rate = sum(one["blocks"] for one in done) / hours if done else None
    found |= {
        "blocks_per_hour": rate,
        "mm3_per_minute_per_car": rate and rate * BLOCK_MM3 / 60 / cars,
    }
    return found


def run(name: str, trials: int, drive: Drive | None, out: Path) -> dict[str, Any]:
    """Run the first trials of a set that have no result yet, and return the metrics of all finished ones."""
    structures, what = SETS[name], drive or "plan"
    items = [
        Trial(f"{name} {seed}", name, seed, Job(name, seed, drive))
        for seed in range(structures.number)
    ]
    config = {"size": structures.size, "cars": structures.cars, "drive": drive, "limit_s": LIMIT_S}
    experiment = Experiment("structures", 0, config, items, attempt, timeout_s=TIMEOUT_S)
    with open_session(experiment, out / f"{name}-{what}", RunOptions(resume=True)) as session:
        jobs = {number: items[number].job for number in range(min(trials, len(items)))}
        records = session.run_some(
            jobs, lambda record: print(record["key"], record["extra"], flush=True)
        )
        figures = figures_of([record["extra"] for record in records], structures.cars, drive)
        session.write_report(figures)
    return figures


def main() -> None:
    """Plan or build sets of structures, and store what that comes to."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("plan", "build"))
    parser.add_argument("sets", nargs="*", metavar="SET", help=", ".join(SETS))
    parser.add_argument("--trials", type=int, default=200, help="of each set at most")
    parser.add_argument("--drive", choices=("wheels", "rollers"), default="wheels")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "structures")
    asked = parser.parse_args()
    if unknown := set(asked.sets) - set(SETS):
        parser.error(f"no set {', '.join(sorted(unknown))}; there are {', '.join(SETS)}")
    drive = None if asked.what == "plan" else asked.drive
    for name in asked.sets or SETS:
        figures = run(name, asked.trials, drive, asked.out)
        stored = json.loads(STORED.read_text(encoding="utf-8")) if STORED.exists() else {}
        stored.setdefault(name, {})[drive or "plan"] = json_value(figures) | {
            "revision": revision()
        }
        STORED.write_text(json.dumps(stored, indent=1, sort_keys=True) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
