"""Coverage of the intervals of `craftsim robot identify`: cars with hidden parameters are simulated and identified.

    .venv/bin/python scripts/identification_coverage.py --cars 100 --out out/coverage

Each car's parameters are drawn over the ranges in which they are sought; every second car has a torque limit that its
drive reaches. Masses are true, and sensors have noise, delay and lags. A car is
written to cars.jsonl as soon as it is identified; cars that stand there already are not done again.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from craftsim.checking.setup import RANDOMIZE, Seed, setup_of
from craftsim.experiments.intervals import Proportion
from craftsim.mjcf.machines import Machines
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.robots.log import Log
from craftsim.storage.writing import write_whole
from craftsim.tuning.excitation import Area, drive, excitation, free_area
from craftsim.tuning.identification import Identification, identify

ASSUMED: Final = Machines()
FORCES: Final = ("wheel_gain_nms_rad", "gear_friction_nm", "wheel_armature_kgm2")
"""Drawn over a factor of 2.5 either way, each from the logarithm's uniform distribution."""
FORCE_FACTOR: Final = 2.5
SHARES: Final = {
    "wheel_radius_m": (-0.02, 0.0),
    "board_mass_kg": (-0.3, 0.3),
    "screw_friction_n": (-0.5, 0.5),
    "board_damping_ns_m": (-0.5, 0.5),
}
"""Uniform deviations, as shares of what is assumed; with larger wheels the board does not go under a slope."""
TORQUES_NM: Final = ((0.9, 1.6), (2.0, 6.5))
"""Of torque limits that the drive reaches, and of those that it does not, in turns."""
MOVES_NM: Final = 0.35
"""How far a torque limit is above the gear's friction, so that the car moves."""
CAR_KGM2: Final = ASSUMED.car(0).mass_kg * ASSUMED.car(0).wheel_radius_m ** 2 / 4
"""What a quarter of the car adds to a wheel's inertia."""
STEP_S: Final = 0.004
STIFFEST: Final = 1.4
"""Stiffer servos ring in the simulation's steps."""
DELAY_S: Final = (0.0, 0.08)
LAG_S: Final = (0.005, 0.04)


def hidden_car(rng: np.random.Generator, saturates: bool) -> dict[str, float]:
    """Return the parameters of a car, by key."""
    nominal = ASSUMED.car(0)
    while True:
        low, high = TORQUES_NM[0 if saturates else 1]
        hidden = {"smartcar.wheel_torque_nm": math.exp(rng.uniform(math.log(low), math.log(high)))}
        for name in FORCES:
            factor = FORCE_FACTOR ** rng.uniform(-1, 1)
            hidden[f"smartcar.{name}"] = getattr(nominal, name) * factor
        for name, deviations in SHARES.items():
            hidden[f"smartcar.{name}"] = getattr(nominal, name) * (1 + rng.uniform(*deviations))
        hidden["noise.delay_s"] = rng.uniform(*DELAY_S)
        hidden["noise.motor_lag_s"] = rng.uniform(*LAG_S)
        hidden["noise.encoder_lag_s"] = rng.uniform(*LAG_S)
        moves = hidden["smartcar.wheel_torque_nm"] > hidden["smartcar.gear_friction_nm"] + MOVES_NM
        inertia = hidden["smartcar.wheel_armature_kgm2"] + CAR_KGM2
        if moves and hidden["smartcar.wheel_gain_nms_rad"] * STEP_S < STIFFEST * inertia:
            return hidden


def log_of(hidden: dict[str, float], seed: int, time_s: float) -> Log:
    """Return the log of a car in mild noise."""
    car = {
        key.removeprefix("smartcar."): value
        for key, value in hidden.items()
        if key.startswith("smartcar.")
    }
    noise = replace(
        RANDOMIZE["mild"].sensors,
        min_delay_s=hidden["noise.delay_s"],
        max_delay_s=hidden["noise.delay_s"],
        motor_lag_s=hidden["noise.motor_lag_s"],
        encoder_lag_s=hidden["noise.encoder_lag_s"],
    )
    setup = setup_of(machines=Machines(cars=(SmartcarParameters(**car),)), noise=noise)
    commands = excitation(time_s, Area(), ASSUMED.car(0), 0.02)
    return drive(free_area(Area()), setup, Seed((seed,)), commands).log


def outcome(hidden: dict[str, float], found: Identification) -> dict[str, Any]:
    """Return what an identification says of each hidden parameter, and of the fit."""
    parameters = {}
    for key, true in hidden.items():
        estimate = found[key]
        kind = "held"
        covered = None
        if estimate.half_width is not None:
            kind = "identified" if estimate.identified else "uncertain"
            covered = abs(estimate.value - true) <= estimate.half_width
            if estimate.at_bound:
                kind = "at bound"
        elif estimate.range is not None:
            kind = "range"
            covered = estimate.range[0] <= true <= estimate.range[1]
        parameters[key] = {
            "true": true,
            "value": estimate.value,
            "half_width": estimate.half_width,
            "range": estimate.range,
            "kind": kind,
            "covered": covered,
        }
    return {"fits": found.fits, "misfit": found.misfit, "parameters": parameters}


def summary(cars: Sequence[dict[str, Any]]) -> str:
    """Return a table of coverage by parameter, of cars whose model fits the log."""
    fitting = [car for car in cars if car["fits"]]
    lines = [f"{len(cars)} cars, {len(fitting)} of them with a model that fits the log", ""]
    lines += [
        "| parameter | of it | cars | interval holds the truth | 95 % interval of this share |",
        "| --- " * 5 + "|",
    ]
    total: dict[str, list[bool]] = {"identified": [], "uncertain": [], "range": []}
    keys = fitting[0]["parameters"] if fitting else {}
    for key in keys:
        for kind in total:
            rows = [
                car["parameters"][key] for car in fitting if car["parameters"][key]["kind"] == kind
            ]
            covered = [row["covered"] for row in rows]
            total[kind] += covered
            if covered:
                lines.append(_row(key, kind, covered))
    lines += [_row("all", kind, covered) for kind, covered in total.items() if covered]
    kinds = [row["kind"] for car in fitting for row in car["parameters"].values()]
    lines += [
        "",
        f"at the border of the search: {kinds.count('at bound')}; held: {kinds.count('held')}",
    ]
    return "\n".join(lines)


def _row(key: str, kind: str, covered: Sequence[bool]) -> str:
    share = Proportion.of(sum(covered), len(covered))
    interval = f"{100 * share.low:.0f} to {100 * share.high:.0f} %"
    holds = f"{sum(covered)} ({100 * share.successes / share.trials:.0f} %)"
    return f"| {key} | {kind} | {len(covered)} | {holds} | {interval} |"


def main() -> None:
    """Simulate and identify cars, and write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cars", type=int, default=100, help="number of cars")
    parser.add_argument(
        "--time", type=float, default=16.0, help="duration of a car's log in seconds"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/coverage"),
        help="folder of cars.jsonl and coverage.md",
    )
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    path = arguments.out / "cars.jsonl"
    cars = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    for number in range(len(cars), arguments.cars):
        started = time.process_time()
        hidden = hidden_car(np.random.default_rng([57, number]), saturates=number % 2 == 0)
        found = identify(log_of(hidden, number, arguments.time), ASSUMED)
        car = {"number": number, **outcome(hidden, found), "cpu_s": time.process_time() - started}
        cars.append(car)
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(car) + "\n")
        missed = [key for key, row in car["parameters"].items() if row["covered"] is False]
        print(
            f"car {number}: {car['cpu_s']:.0f} s, misfit {max(car['misfit'].values()):.2f}, missed {missed}",
            flush=True,
        )
    text = summary(cars)
    write_whole(arguments.out / "coverage.md", text + "\n")
    print(text)


if __name__ == "__main__":
    main()
