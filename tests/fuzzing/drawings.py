"""Damaged files that people write: blueprints, goals, plans, task files, machines, gains, noise, cameras, studies."""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import numpy as np

from craftsim.checking.setup import setup_of
from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint, read_blueprint
from craftsim.discrete.files.design import read_design
from craftsim.discrete.files.plan import read_actions, read_plan
from craftsim.discrete.files.shipped import shipped_blueprint
from craftsim.discrete.tasks import TASK_NAMES
from craftsim.discrete.tasks.registry import read_task
from craftsim.errors import InputError
from craftsim.logs.bags import read_topics
from craftsim.mjcf.machine_files import load_machines
from craftsim.models.randomization import load_noise
from craftsim.rendering.cameras import read_aim
from craftsim.skills.gains import load_gains
from craftsim.studies.study import read_study
from craftsim.training.settings import read_settings
from fuzzing.mutations import mutated_bytes, mutated_text

SNAPSHOT = """
snapshot:
  cells:
    - {x: 0, y: 0, z: 1, kind: gear, yaw: 1}
  top:
    - {x: 0, y: 0, z: 0, mark: -2}
  back:
    - {x: 0, y: 0, z: 1, mark: 1}
"""
_DATA = files("craftsim.data")
_STARTS = [shipped_blueprint(name).read_text() for name in TASK_NAMES]
_STARTS += [_STARTS[2] + SNAPSHOT, _STARTS[3].replace("block_num: 6", "block_num: 9")]
_SEEDS: dict[str, list[str]] = {
    "blueprint": _STARTS,
    "goal": [(_DATA / "blueprints" / f"{name}_goal.yaml").read_text() for name in ("strip", "block")],
    "plan": [(_DATA / "plans" / f"{name}.plan").read_text() for name in ("strip", "simple_two_story")],
    "actions": ["# tries\n0 MOVE_LEFT\n1 LIFT\n0 ROTATE_RIGHT\n"],
    "task": ["start: strip\ngoal: strip_goal\nreward: paper\nmax_steps: 40\ncars: 3\nblocks: 6\n"],
    "machines": [
        "smartcar: {chassis_mass_kg: 1.1, wheel_torque_nm: 3.0}\ncars: [{}, {wheel_mass_kg: 2.5}]\n"
        "slope: {hinge_speed_rad_s: 1.0}\ngains:\n  drive: {max_speed: 0.4}\n"
    ],
    "gains": [(_DATA / "gains" / "robust.yaml").read_text()],
    "noise": ["{min_delay_s: 0.02, max_delay_s: 0.04, position_m: 0.001}\n"],
    "randomization": [(_DATA / "randomizations" / "lab_floor.yaml").read_text()],
    "settings": ["gamma: 0.98\nepochs: 3\nclip: 0.1\n"],
    "study": [(_DATA / "studies" / "quick.yaml").read_text()],
    "camera": ["{lookat: [0.1, 0.2, 0.3], distance: 2, azimuth: 45, elevation: -30}\n"],
    "topics": ["commands: /told\npose: /pose\njoint_names: {wheel_fl: left, board: lift}\n"],
}


def _blueprint(path: Path) -> None:
    """Read a blueprint; what is accepted must be readable again once it is written."""
    grid = read_blueprint(path).grid(np.random.default_rng(0))
    try:
        again = parse_blueprint(blueprint_text(grid), path).grid(np.random.default_rng(0))
    except InputError as error:
        raise AssertionError(f"accepted, but not to be written: {error}") from error
    assert again.same_visible(grid)


_READERS: dict[str, Callable[[Path], object]] = {
    "blueprint": _blueprint,
    "goal": read_design,
    "plan": lambda path: read_plan(path, n_cars=2),
    "actions": lambda path: read_actions(path, n_cars=2),
    "task": read_task,
    "machines": load_machines,
    "gains": load_gains,
    "noise": load_noise,
    "randomization": setup_of,
    "settings": lambda path: read_settings(path, "ippo"),
    "study": lambda path: read_study(str(path)),
    "camera": read_aim,
    "topics": read_topics,
}


def _target(name: str) -> Callable[[np.random.Generator, Path], None]:
    seeds, read = _SEEDS[name], _READERS[name]

    def attack(rng: np.random.Generator, folder: Path) -> None:
        path, text = folder / "mutated.yaml", seeds[rng.integers(len(seeds))]
        data = mutated_text(text, rng).encode("utf-8", "surrogatepass")
        path.write_bytes(mutated_bytes(data, rng) if rng.random() < 0.2 else data)
        read(path)

    return attack


TARGETS = {name: _target(name) for name in _READERS}
