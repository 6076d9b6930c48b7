"""Recordings as of a real cube and a real robot, simulated with parameters that the command does not know."""

import numpy as np

from craftsim.discrete.grid import Grid
from craftsim.mjcf.machines import NOMINAL
from craftsim.mjcf.parameters import ContactParameters
from craftsim.models.config import SimulationConfig
from craftsim.models.world import PhysicsWorld
from craftsim.reality.contact_law import ContactLaw, cube_model, simulate_tosses, steps_per_row
from craftsim.reality.recordings import (
    PERIOD_S,
    CubeParameters,
    RobotParameters,
    with_following_wheels,
)

CUBE = CubeParameters()
ROBOT = RobotParameters()
ROWS = 70


def toss_arrays(friction, n=24, seed=0, noise=0.0):
    """Return the arrays of a file of tosses with a friction; ``noise`` is of velocities, in half widths and radians."""
    rng = np.random.default_rng(seed)
    starts = np.zeros((n, 13))
    starts[:, :3] = rng.uniform((-3, -3, 2.5), (3, 3, 3.5), (n, 3)) * CUBE.half_width_m
    quaternions = rng.normal(size=(n, 4))
    starts[:, 3:7] = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    starts[:, 7:10] = rng.uniform((-20, -20, -10), (20, 20, 0), (n, 3)) * CUBE.half_width_m
    starts[:, 10:] = rng.uniform(-6, 6, (n, 3))
    model = cube_model(CUBE, ContactLaw("hidden", ContactParameters(ground_friction=friction)))
    poses = simulate_tosses(model, starts, [ROWS] * n, steps_per_row(CUBE))
    states = np.zeros((n, ROWS, 19))
    for state, pose, start in zip(states, poses, starts, strict=True):
        state[:, :7] = pose
        state[0, 7:13] = start[7:]
        state[1:, 7:10] = np.diff(pose[:, :3], axis=0) * CUBE.rate_hz
        state[1:, 10:13] = start[10:]  # of the flight, which alone counts
        state[0, 7:13] += noise * rng.normal(size=6) * [*[CUBE.half_width_m] * 3, 1, 1, 1]
    states[..., :3] /= CUBE.half_width_m
    states[..., 7:10] /= CUBE.half_width_m
    return {
        "states": states.reshape(-1, 19).astype(np.float32),
        "length": np.full(n, ROWS),
    }


def wheel_speeds(time_s, seed):
    """Return the speeds, (n, 4), of wheels of a robot that goes forward, sideways and turns, in changing shares."""
    rng = np.random.default_rng(seed)
    n = int(time_s / PERIOD_S)
    directions = np.array([[1, 1, 1, 1], [-1, 1, 1, -1], [-1, 1, -1, 1]])
    at = np.arange(n) * PERIOD_S
    speeds = np.zeros((n, 4))
    for direction in directions:
        periods_s = rng.uniform(3.0, 7.0, 2)
        phases = rng.uniform(0, 2 * np.pi, 2)
        wave = np.sin(2 * np.pi * at[:, None] / periods_s + phases).sum(axis=1)
        speeds += 1.5 * wave[:, None] * direction
    return speeds * np.clip(at / 0.5, 0, 1)[:, None]


def drive_arrays(time_s=14.0, seed=0, radius_m=ROBOT.wheel_radius_m, shares=(1, 1, 1, 1), lean=0.0):
    """Return the arrays of a file of a drive, with a radius and shares of it that single wheels have.

    A smaller wheel rolls as one of full size that turns less. ``lean`` is the slope of the floor in the recording.
    """
    rng = np.random.default_rng(100 + seed)
    figures = {
        "smartcar.wheel_radius_m": radius_m,
        "smartcar.wheel_x_m": ROBOT.half_wheelbase_m,
        "smartcar.wheel_y_m": ROBOT.half_track_m,
    }
    config = SimulationConfig(sleep=False)
    world = PhysicsWorld(
        Grid.empty((3, 3, 1), 1), config, machines=with_following_wheels(NOMINAL, figures)
    )
    speeds = wheel_speeds(time_s, seed)
    motion = []
    for row in speeds:
        position, (w, x, y, z) = world.free_body_state(world.cars[0].base)
        heading = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        motion.append([*position[:2], heading])
        world.drive(0, row * shares)
        world.advance()
    at = np.arange(len(speeds)) * PERIOD_S
    turned = np.vstack([np.zeros(4), np.cumsum(speeds[:-1] * PERIOD_S, axis=0)])
    wheels = np.column_stack([at, at, turned * ROBOT.ticks_per_turn / (2 * np.pi), speeds])
    fine = np.arange(0, at[-1], 0.006)
    x, y, heading = (np.interp(fine, at, signal) for signal in np.unwrap(motion, axis=0).T)
    half = (heading + rng.normal(0, 0.002, len(fine))) / 2
    x = x + rng.normal(0, 0.0003, len(fine))
    y = y + rng.normal(0, 0.0003, len(fine))
    # The floor is turned about y, which lowers what is ahead: q = (0, sin, 0, cos) * (0, 0, sin, cos).
    turned_by = np.arctan(lean)
    pose = np.zeros((len(fine), 9))
    pose[:, :2] = fine[:, None]
    pose[:, 2] = np.cos(turned_by) * x
    pose[:, 3] = y
    pose[:, 4] = 0.3 - np.sin(turned_by) * x
    pose[:, 5] = np.sin(turned_by / 2) * np.sin(half)
    pose[:, 6] = np.sin(turned_by / 2) * np.cos(half)
    pose[:, 7] = np.cos(turned_by / 2) * np.sin(half)
    pose[:, 8] = np.cos(turned_by / 2) * np.cos(half)
    return {"wheels": wheels, "pose": pose}


def written(path, arrays):
    """Write a file of arrays and return its path."""
    np.savez(path, **arrays)
    return path
