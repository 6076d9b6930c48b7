"""Learn the rules of machines in physics, and plan the shipped tasks with them.

    python scripts/learned.py                        # all machines, resumed: two hours of CPU time
    python scripts/learned.py default unladen_car    # some of them

Each is a ``craftsim audit --learn``. Two have a fault planted, of which the learned rules have to say: a lift that
raises blocks but no slope, and a hinge that turns no slope. What was learned is stored in docs/results/learned.json, of
which scripts/results.py makes a table, and the rules themselves in out/learned.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from measure_results import cpu_seconds_of, revision

from craftsim.discrete.learned import LearnedRules, read_rules
from craftsim.discrete.rules import Rules
from craftsim.planning import NoPlanError, plan_building
from craftsim.tasks import as_task

ROOT: Final = Path(__file__).parents[1]
STORED: Final = ROOT / "docs" / "results" / "learned.json"
OUT: Final = ROOT / "out" / "learned"
TASKS: Final = (
    "strip",
    "block",
    "simple_two_story",
    "breaking_barrier",
    "complex_two_story",
    "free_building",
)
_PLAN_S: Final = 20.0
_SMALL: Final = "--most-actions 2000 --held-out 2000"
_PLANTED: Final = "--most-actions 1000 --held-out 500"


@dataclass(frozen=True)
class Machine:
    """A machine whose rules are learned."""

    name: str
    parameters: str = ""
    """In YAML; empty for the nominal ones."""
    options: str = _SMALL
    fault: str = ""
    """The action that does not work, of a planted fault."""

    @property
    def command(self) -> str:
        """The command that learns its rules, from the folder of the project."""
        words = f"audit --learn out/learned/{self.name}.yaml --randomize none {self.options}"
        if self.parameters:
            words += f" --machines out/learned/machines/{self.name}.yaml"
        return words


def _example(name: str) -> str:
    return (ROOT / "examples" / f"{name}.yaml").read_text(encoding="utf-8")


MACHINES: Final = (
    Machine("default", options="--compare physical"),
    Machine("unladen_car", _example("unladen_car")),
    Machine("wide_block", "block: {side_m: 0.322}\n"),
    Machine("light_car", _example("light_car")),
    Machine("weak_lift", "smartcar: {board_force_n: 11.0}\n", _PLANTED, "LIFT"),
    Machine("weak_hinge", "slope: {hinge_torque_nm: 0.1}\n", _PLANTED, "UNFOLD"),
)


def main() -> None:
    """Learn the rules of the machines that are named, or of all."""
    names = [machine.name for machine in MACHINES]
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(names)}")
    parser.add_argument("--workers", type=int, default=1)
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(names):
        parser.error(f"no machine {', '.join(sorted(unknown))}; there are {', '.join(names)}")
    for machine in MACHINES:
        if not arguments.names or machine.name in arguments.names:
            store(machine, measure(machine, arguments.workers))


def measure(machine: Machine, workers: int) -> dict[str, Any]:
    """Learn a machine's rules, plan with them, and return what the table says."""
    out = OUT / machine.name
    if machine.parameters:
        path = OUT / "machines" / f"{machine.name}.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(machine.parameters, encoding="utf-8")
    words = [*machine.command.split(), "--workers", str(workers), "--out", str(out)]
    is_resumed = out.exists()
    if is_resumed:
        words.append("--resume")
    print(*words, flush=True)
    cpu_s = cpu_seconds_of([sys.executable, "-P", "-m", "craftsim", *words], out)
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    rules = read_rules(OUT / f"{machine.name}.yaml")
    stored = figures(report["figures"]["learning"], rules)
    stored["tasks"] = {task: planned(task, rules) for task in TASKS}
    return {
        "command": machine.command,
        "revision": revision(),
        "seed": report["seed"],
        "versions": report["versions"],
        "cpu_s": None if is_resumed else round(cpu_s, 1),
        **stored,
    }


def figures(learning: Mapping[str, Any], rules: LearnedRules) -> dict[str, Any]:
    """Return what is stored of a report's figures."""
    return {
        "actions": rules.origin.actions,
        "rules": [str(rule) for rule in rules.rules],
        "rounds": learning["rounds"],
        "held_out": learning["held_out"],
        "compared": learning["compared"],
        "corrections": learning["corrections"],
    }


def planned(name: str, rules: LearnedRules) -> str:
    """Return what the planner says of a task: the length of a plan, or why there is none."""
    task = as_task(name)
    start = task.draw(np.random.default_rng(0))
    try:
        plan = plan_building(start, task, Rules(rules), rounds=20, time_s=_PLAN_S)
    except NoPlanError as error:
        return str(error)
    return f"{len(plan.ticks)} ticks"


def table_rows(stored: Mapping[str, Any]) -> list[dict[str, object]]:
    """Return the rows of the table of machines."""
    rows: list[dict[str, object]] = []
    for machine in MACHINES:
        if machine.name not in stored:
            continue
        figures_of_machine = stored[machine.name]
        held_out = figures_of_machine["held_out"]
        n_actions = held_out["actions"]
        low, high = held_out["bounds"]
        compared = figures_of_machine["compared"]
        forbidden = "-"
        if compared["allowed"]:
            forbidden = f"{compared['forbidden']:,}/{compared['allowed']:,}"
        unplanned = []
        for task, text in figures_of_machine["tasks"].items():
            if not text.endswith(" ticks"):
                unplanned.append(task)
        cpu_min = "-"
        if figures_of_machine["cpu_s"] is not None:
            cpu_min = f"{figures_of_machine['cpu_s'] / 60:.0f}"
        rows.append(
            {
                "machine": machine.name,
                "rules": len(figures_of_machine["rules"]),
                "actions in physics": f"{figures_of_machine['actions']:,}",
                "as predicted": f"{n_actions - held_out['failures']:,}/{n_actions:,}",
                "interval, %": f"{100 * low:.2f}-{100 * high:.2f}",
                "forbidden though it works": forbidden,
                "no plan for": ", ".join(unplanned) or "-",
                "CPU min": cpu_min,
                "revision": figures_of_machine["revision"],
            }
        )
    return rows


def correction_rows(stored: Mapping[str, Any]) -> list[dict[str, object]]:
    """Return the rows of the table of corrections that the rules of the default machine have."""
    rows: list[dict[str, object]] = []
    for name, correction in stored["default"]["corrections"].items():
        rows.append(
            {
                "correction": f"`{name}`",
                "tried": correction["tried"],
                "failures": correction["failures"],
                "forbidden": correction["forbidden"],
                "by": ", ".join(correction["rules"]) or "-",
            }
        )
    return rows


def store(machine: Machine, measured: Mapping[str, Any]) -> None:
    """Store what was measured of a machine beside that of the others."""
    stored = {}
    if STORED.exists():
        stored = json.loads(STORED.read_text(encoding="utf-8"))
    stored[machine.name] = measured
    text = json.dumps(stored, indent=1, sort_keys=True).replace(f"{ROOT}/", "")
    STORED.write_text(f"{text}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
