"""The speed of craftsim beside that of CraftEnv, on this machine: steps of masked random play a CPU second.

    python benchmarks/reference.py rules --out out/speed_rules
    python benchmarks/reference.py env --checkout CRAFTENV

CraftEnv is estimated from calibration work in plain Python, or, with a checkout of it, timed itself: with the masks and
observations of its helper and without its display, by PyBullet and gymnasium in place of gym. Either runs in turns with
what it is compared to, because a processor's speed changes: by 1.8 times within a minute where this was written.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import random
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final

import calibration
import numpy as np
import yaml

from craftsim.cli.bench import DEPTH, TASKS, WORLDS, cases, repeat, three_digits
from craftsim.reports.json_file import document
from craftsim.reports.publishing import publish
from craftsim.reports.report import Column, DataTable, Headline, Report, Section, Tone, numbers

BLUEPRINTS: Final = {"simple_two_story": "simple_twolayer", "complex_two_story": "complex_twolayer"}
"""CraftEnv's names of the tasks."""
_TURNS: Final = 10
_SHARE: Final = 0.25
"""Time of the reference over that of the work that it is compared to."""


class _NoDisplay:
    """Stands for what shows CraftEnv's world in PyBullet."""

    def __init__(self, *_: object) -> None:
        pass

    def sync(self) -> None:
        """Show nothing."""


def reference_play(checkout: Path, task: str) -> Callable[[], None]:
    """Return a function that takes a step of masked random play in CraftEnv itself.

    Raises SystemExit where the folder is no checkout of CraftEnv, or PyBullet is not installed.
    """
    import gymnasium

    source = checkout / "CraftEnv" / "src"
    settings = checkout / "PyMARL" / "src" / "config" / "envs" / "multicar.yaml"
    if not settings.is_file():
        raise SystemExit(
            f"{checkout} is no checkout of CraftEnv: it has no {settings.relative_to(checkout)}"
        )
    sys.modules.setdefault("gym", gymnasium)
    if str(source) not in sys.path:
        sys.path.append(str(source))
    try:
        from craft import matrix_env
        from craft.goal_env import GoalEnv
    except ImportError as error:
        raise SystemExit(
            f"CraftEnv does not load: {error}; it needs pip install pybullet"
        ) from error
    matrix_env.MatrixToBullet = _NoDisplay
    options: dict[str, Any] = yaml.safe_load(settings.read_text(encoding="utf-8"))["env_args"]
    blueprint = str(source / "craft" / "blueprint" / BLUEPRINTS[task])
    options["design_path"] = f"{blueprint}_goal.yaml"
    options["search_depth"] = DEPTH
    with contextlib.redirect_stdout(io.StringIO()):  # it prints which keys a blueprint lacks
        env = GoalEnv(False, [f"{blueprint}_init.yaml"], options)
        observed = [env.reset()]
    n_cars = env._blackboard.smartcar_num
    rng = random.Random(0)

    def step() -> None:
        actions = []
        for _, mask in observed[0][:n_cars]:
            allowed = np.flatnonzero(mask)
            actions.append(int(rng.choice(allowed)) if allowed.size else 0)
        observed[0], _, done, _ = env.step(actions)
        if done:
            with contextlib.redirect_stdout(io.StringIO()):
                observed[0] = env.reset()

    return step


def compare(
    step: Callable[[], object],
    n_worlds: int,
    reference: Callable[[], object],
    steps_per_call: float,
    seconds: float,
) -> dict[str, float]:
    """Return the rates of a function that takes a step of ``n_worlds``, and of the reference in turns with it.

    Args:
        step: takes ``n_worlds`` steps; what it compiles in its first call does not count.
        n_worlds: number of worlds.
        reference: the calibration, or a step of CraftEnv.
        steps_per_call: CraftEnv's steps in the time of one call of ``reference``.
        seconds: CPU time of all calls of ``step``.
    """
    step()
    reference()
    n_steps = n_references = 0
    of_steps_s = of_references_s = 0.0
    for _ in range(_TURNS):
        n_calls, spent_s = repeat(step, seconds / _TURNS)
        n_steps += n_calls * n_worlds
        of_steps_s += spent_s
        n_calls, spent_s = repeat(reference, _SHARE * seconds / _TURNS)
        n_references += n_calls
        of_references_s += spent_s
    steps_a_second = n_steps / of_steps_s
    references_a_second = n_references / of_references_s
    reference_a_second = references_a_second * steps_per_call
    return {
        "steps_a_second": steps_a_second,
        "units_a_second": references_a_second,
        "reference_a_second": reference_a_second,
        "per_unit": steps_a_second / references_a_second,
        "times": steps_a_second / reference_a_second,
    }


def rates_of(
    subject: str, task: str, seconds: float, checkout: Path | None, worlds: int = WORLDS
) -> dict[str, dict[str, float]]:
    """Return what :func:`compare` returns, by case."""
    if checkout is None:
        reference: Callable[[], object] = calibration.unit
        with_helper = calibration.REFERENCE_PER_UNIT[task]
    else:
        reference = reference_play(checkout, task)
        with_helper = 1.0
    rates = {}
    for name, n_worlds, play in cases(subject, task, "published", worlds, seed=0):
        steps_per_call = with_helper
        if name.startswith("primitive"):
            steps_per_call *= calibration.PRIMITIVE_TIMES_HELPER[task]
        rates[name] = compare(partial(next, play), n_worlds, reference, steps_per_call, seconds)
    return rates


def report_of(subject: str, seconds: float, checkout: Path | None) -> Report:
    """Return the report of all tasks."""
    rates = {task: rates_of(subject, task, seconds, checkout) for task in TASKS}
    rows = []
    for task, by_case in rates.items():
        for name, rate in by_case.items():
            columns = (rate["steps_a_second"], rate["reference_a_second"], rate["times"])
            rows.append((task, name, *map(three_digits, columns)))
    heads = numbers("case", "steps/s", "CraftEnv, steps/s", "times")
    table = DataTable((Column("task"), *heads), rows, f"Steps a CPU second, {subject}")
    how = "CraftEnv's steps are estimated from the calibration."
    if checkout is not None:
        how = "CraftEnv itself, without its display."
    config = {
        "what": subject,
        "rules": "published",
        "worlds": WORLDS,
        "seconds": seconds,
        "depth": DEPTH,
    }
    config["reference"] = "estimated" if checkout is None else "measured"
    return Report(
        "Speed beside CraftEnv",
        f"{subject}, on this machine",
        Headline("Measured", Tone.PLAIN, how),
        sections=[
            Section("speed", "Speed", "In CPU seconds, resets included.", [table], terminal=True)
        ],
        document=document({}, command="reference", seed=0, config=config, wall={"rates": rates}),
    )


def main() -> int:
    """Measure, print the table, and write the report into a folder if one is given."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("subject", choices=("rules", "env", "physics"))
    parser.add_argument("--seconds", type=float, default=2.0, help="CPU time of each measurement")
    parser.add_argument(
        "--checkout", type=Path, help="folder of a checkout of CraftEnv, which is timed itself"
    )
    parser.add_argument("--out", type=Path, help="folder for report.json")
    asked = parser.parse_args()
    return publish(report_of(asked.subject, asked.seconds, asked.checkout), asked.out)


if __name__ == "__main__":
    sys.exit(main())
