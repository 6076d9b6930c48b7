"""Compare the drives with a real mecanum robot under motion capture, and with ideal kinematics.

python scripts/real_robot.py RUN.npz ...    # writes docs/results/real_robot.json

A file has two arrays. ``wheels``, (n, 10): time of arrival and of measurement in seconds, encoder ticks of the front
left, front right, rear left and rear right motor, and their speeds. ``pose``, (m, 9): both times, position in metres,
and quaternion x, y, z, w. The files of docs/explanation/drives.md come from a course of the Politecnico di Milano and
are not part of this project.

The robot's effective wheel radius and the lever by which wheels turn it are fitted to ideal kinematics over windows of
half a second. Then each drive gets the measured wheel angles, and all three are compared with motion capture: the error
of the way in windows of several lengths, in the robot's frame as a window begins.
"""

from __future__ import annotations

import argparse
import json
from copy import copy
from pathlib import Path
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import savgol_filter

from craftsim.discrete.grid import Grid
from craftsim.mjcf.drives import DRIVES, Drive
from craftsim.mjcf.machines import NOMINAL, Machines
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.models.config import SimulationConfig
from craftsim.models.world import PhysicsWorld

ROOT: Final = Path(__file__).parents[1]
STORED: Final = ROOT / "docs" / "results" / "real_robot.json"
TICKS_PER_TURN: Final = 5 * 42
"""Of a wheel: a gear of 5, and 42 ticks a revolution of the motor."""
PERIOD_S: Final = 0.02
SMOOTHED: Final = 11
"""Periods over which encoder ticks are smoothed, by parabolas."""
RADIUS_M, LEVER_M = 0.07, 0.369
"""The nominal figures: half the track, 0.169 m, and half the wheelbase, 0.200 m, are the lever."""
WINDOWS_S: Final = (0.5, 2.0, 10.0)

Floats = NDArray[np.float64]


class Run(NamedTuple):
    """A drive of the robot, sampled each PERIOD_S."""

    angles: Floats
    """(n, 4) rad: of the wheels, in the order of WHEELS."""
    poses: Floats
    """(n, 3): x and y in metres, heading in rad, by motion capture."""


def read_run(path: Path) -> Run:
    """Return a run of a file."""
    with np.load(path) as arrays:
        wheels, pose = arrays["wheels"], arrays["pose"]
    first = max(wheels[0, 1], pose[0, 1])
    last = min(wheels[-1, 1], pose[-1, 1])
    times = np.arange(first, last, PERIOD_S)
    x, y, z, w = pose[:, 5:9].T
    heading = np.unwrap(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    captured = np.column_stack([pose[:, 2:4], heading])
    order = np.argsort(pose[:, 1])
    poses = [np.interp(times, pose[order, 1], captured[order, column]) for column in range(3)]
    turns = wheels[:, 2:6] / TICKS_PER_TURN
    ticks = [np.interp(times, wheels[:, 1], turns[:, wheel]) for wheel in range(4)]
    angles = savgol_filter(2 * np.pi * np.column_stack(ticks), SMOOTHED, 2, axis=0)
    return Run(angles, np.column_stack(poses))


def ideal_poses(angles: Floats, radius_m: float, lever_m: float) -> Floats:
    """Return the poses (n, 3) of a robot whose rollers do not slip, from the origin on."""
    front_left, front_right, rear_left, rear_right = np.diff(angles, axis=0).T * radius_m
    forward = (front_left + front_right + rear_left + rear_right) / 4
    left = (-front_left + front_right + rear_left - rear_right) / 4
    turn = (-front_left + front_right - rear_left + rear_right) / (4 * lever_m)
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    middle = heading[:-1] + turn / 2
    x = np.concatenate([[0.0], np.cumsum(np.cos(middle) * forward - np.sin(middle) * left)])
    y = np.concatenate([[0.0], np.cumsum(np.sin(middle) * forward + np.cos(middle) * left)])
    return np.column_stack([x, y, heading])


def ways(poses: Floats, periods: int) -> Floats:
    """Return the ways (k, 3) in windows one after the other, each in the robot's frame as it begins."""
    starts = poses[:-periods:periods]
    ends = poses[periods::periods][: len(starts)]
    change = ends - starts[: len(ends)]
    cos, sin = np.cos(starts[:, 2]), np.sin(starts[:, 2])
    forward = cos * change[:, 0] + sin * change[:, 1]
    left = -sin * change[:, 0] + cos * change[:, 1]
    return np.column_stack([forward, left, change[:, 2]])


def fitted(runs: list[Run]) -> tuple[float, float]:
    """Return the radius and the lever with which ideal kinematics fits motion capture best, over half a second."""
    periods = round(WINDOWS_S[0] / PERIOD_S)

    def errors(figures: Floats) -> Floats:
        off = []
        for run in runs:
            predicted = ways(ideal_poses(run.angles, *figures), periods)
            off.append((predicted - ways(run.poses, periods)) * [1.0, 1.0, LEVER_M])
        return np.concatenate(off).ravel()

    radius_m, lever_m = least_squares(errors, [RADIUS_M, LEVER_M], loss="soft_l1", f_scale=0.005).x
    return float(radius_m), float(lever_m)


def machines_of(drive: Drive, radius_m: float, lever_m: float) -> Machines:
    """Return a car with the robot's wheels, which follow their commands; it is unchecked, for no block is near."""
    car: SmartcarParameters = copy(NOMINAL.cars[0])
    scale = radius_m / car.wheel_radius_m
    share = lever_m / LEVER_M
    vars(car).update(
        wheel_radius_m=radius_m,
        wheel_x_m=0.200 * share,
        wheel_y_m=0.169 * share,
        roller_radius_m=car.roller_radius_m * scale,
        roller_half_length_m=car.roller_half_length_m * scale,
        gear_friction_nm=1e-4,
        wheel_torque_nm=50.0,
    )
    machines: Machines = copy(NOMINAL)
    vars(machines).update(cars=(car,), drive=drive)
    return machines


def simulated_poses(run: Run, machines: Machines) -> Floats:
    """Return the poses (n, 3) of a simulated car whose wheels turn as the robot's did."""
    world = PhysicsWorld(Grid.empty((3, 3, 1), 1), SimulationConfig(sleep=False), machines=machines)
    speeds = np.diff(run.angles, axis=0) / PERIOD_S
    poses = np.zeros((len(run.angles), 3))
    for number in range(len(poses)):
        position, (w, x, y, z) = world.free_body_state(world.cars[0].base)
        poses[number] = [*position[:2], np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))]
        if number < len(speeds):
            world.drive(0, speeds[number])
            world.advance()
    poses[:, 2] = np.unwrap(poses[:, 2])
    return poses


def figures(errors: list[Floats]) -> dict[str, float]:
    """Return medians and 90th percentiles of the errors of position and heading."""
    off = np.concatenate(errors)
    position_mm = 1e3 * np.hypot(off[:, 0], off[:, 1])
    heading_mrad = 1e3 * np.abs(off[:, 2])
    return {
        "windows": len(off),
        "position_mm_median": float(np.median(position_mm)),
        "position_mm_90": float(np.quantile(position_mm, 0.9)),
        "heading_mrad_median": float(np.median(heading_mrad)),
        "heading_mrad_90": float(np.quantile(heading_mrad, 0.9)),
    }


def compare(runs: list[Run]) -> dict[str, Any]:
    """Return the fitted figures, and the errors by model and length of windows."""
    radius_m, lever_m = fitted(runs)
    models = {"ideal kinematics": [ideal_poses(run.angles, radius_m, lever_m) for run in runs]}
    for drive in DRIVES:
        machines = machines_of(drive, radius_m, lever_m)
        models[drive] = [simulated_poses(run, machines) for run in runs]
    rows = []
    for name, predictions in models.items():
        for seconds in WINDOWS_S:
            periods = round(seconds / PERIOD_S)
            errors = [
                ways(poses, periods) - ways(run.poses, periods)
                for poses, run in zip(predictions, runs, strict=True)
            ]
            rows.append({"model": name, "window_s": seconds, **figures(errors)})
    return {"radius_m": radius_m, "lever_m": lever_m, "rows": rows}


def main() -> None:
    """Compare, print a table and store it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, default=STORED)
    arguments = parser.parse_args()
    result = compare([read_run(path) for path in arguments.runs])
    result["mujoco"] = mujoco.__version__
    print(f"radius {1e3 * result['radius_m']:.1f} mm, lever {1e3 * result['lever_m']:.0f} mm")
    for row in result["rows"]:
        print(
            f"{row['model']:18} {row['window_s']:5.1f} s  {row['position_mm_median']:7.2f} mm "
            f"(90 %: {row['position_mm_90']:.2f})  {row['heading_mrad_median']:6.2f} mrad "
            f"(90 %: {row['heading_mrad_90']:.2f})"
        )
    arguments.out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
