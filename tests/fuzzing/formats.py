"""Every format that is read from outside: small files that are as they should be, and what reads them."""

from __future__ import annotations

import gzip
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path

import cv2
import numpy as np
import trimesh
from robots.bags import write_bag

from craftsim.audit.conformance import Checker, read_records
from craftsim.checking.setup import Setup, setup_of
from craftsim.cli.app import bind
from craftsim.designs.finding import find_design
from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint, read_blueprint
from craftsim.discrete.files.design import read_design
from craftsim.discrete.files.shipped import shipped_blueprint
from craftsim.discrete.rules import Rules
from craftsim.errors import InputError
from craftsim.experiments.bundle import read_bundle
from craftsim.learning.checkpoint import POLICY_FILE, RUN_FILE, read_policy
from craftsim.learning.config import TrainConfig, read_settings
from craftsim.learning.policies import make_policy
from craftsim.learning.study import read_study
from craftsim.learning.trainer import Trainer
from craftsim.mjcf.machines import load_machines
from craftsim.models.measuring import CarMeasurement
from craftsim.planning.plan_file import read_actions, read_plan
from craftsim.rendering.cameras import read_aim
from craftsim.rendering.trajectory import Trajectory
from craftsim.robots.bags import read_topics
from craftsim.robots.log import GROUPS, Log
from craftsim.robots.log_files import read_log, write_table
from craftsim.robots.messages import Commands, Measurements, MessageError, TruePoses, pack, unpack
from craftsim.skills.gains import load_gains
from craftsim.skills.skill import Command
from craftsim.tasks import TASK_NAMES, as_task, make_task
from craftsim.tasks.registry import read_task
from craftsim.tasks.starts import load_starts, save_starts
from craftsim.validation.sources import record_once
from fuzzing import campaign_folders, replays

Files = dict[str, bytes]
"""Of one example, by name; the first is damaged more often than the others."""
CONFIG = TrainConfig("strip", "ippo", worlds=1, width=4)
_DATA = files("craftsim.data")
_SNAPSHOT = """
snapshot:
  cells:
    - {x: 0, y: 0, z: 1, kind: gear, yaw: 1}
  top:
    - {x: 0, y: 0, z: 0, mark: -2}
  back:
    - {x: 0, y: 0, z: 1, mark: 1}
"""


@dataclass(frozen=True)
class Format:
    """A format."""

    examples: Callable[[], Sequence[Files]]
    read: Callable[[Path], object]
    """Given the folder of an example."""
    cases: int = 150
    """That the tests try: fewer of what takes ten milliseconds each, more where few are right once changed."""


def _texts(name: str, read: Callable[[Path], object], *texts: str, cases: int = 150) -> Format:
    """Return a format of one file."""
    return Format(
        lambda: [{name: text.encode()} for text in texts], lambda folder: read(folder / name), cases
    )


def _shipped(*parts: str) -> str:
    return _DATA.joinpath(*parts).read_text()


@cache
def _written(write: Callable[[Path], object]) -> list[Files]:
    """Return what a function writes into a folder, as the only example."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder))
        return [{path.name: path.read_bytes() for path in sorted(Path(folder).iterdir())}]


def _starts() -> list[str]:
    found = [shipped_blueprint(name).read_text() for name in TASK_NAMES]
    return [*found, found[2] + _SNAPSHOT, found[3].replace("block_num: 6", "block_num: 9")]


def _blueprint(path: Path) -> None:
    """Read a blueprint; what is accepted must be readable again once it is written."""
    grid = read_blueprint(path).grid(np.random.default_rng(0))
    try:
        again = parse_blueprint(blueprint_text(grid), path).grid(np.random.default_rng(0))
    except InputError as error:
        raise AssertionError(f"accepted, but not to be written: {error}") from error
    assert again.same_visible(grid)


def _pictures() -> list[Files]:
    found = []
    for channels in (1, 3, 4):
        pixels = np.full((6, 5, channels), 255, np.uint8)
        pixels[1:4, 2:4] = 9
        found.append({"level.png": cv2.imencode(".png", pixels)[1].tobytes()})
    grey = np.full((6, 5), 255, np.uint8)
    grey[1:4, 2:4] = 9
    found.append({"level.jpg": cv2.imencode(".jpg", grey)[1].tobytes()})
    return found


def _meshes() -> list[Files]:
    box = trimesh.creation.box((0.9, 0.6, 0.4))
    return [
        {"mesh.obj": box.export(file_type="obj").encode()},
        {"mesh.stl": box.export(file_type="stl")},
        {"mesh.stl": box.export(file_type="stl_ascii").encode()},
        {"mesh.ply": box.export(file_type="ply")},
        {"mesh.glb": box.export(file_type="glb")},
    ]


def _design(folder: Path) -> None:
    (path,) = folder.iterdir()
    find_design([str(path)], [7] if path.stem == "mesh" else [])


def _log() -> Log:
    rng = np.random.default_rng(0)
    groups = {name: 0.01 * rng.normal(size=(12, len(columns))) for name, columns in GROUPS.items()}
    return Log(0.02 * np.arange(12), **groups)


def _messages() -> list[Files]:
    car = CarMeasurement(
        0.5, 1.0, 2.0, 0.0, 3.0, 0.1, -0.1, (1.0, 2.0, 3.0, 4.0), 0.045, 30.0, 1, 3.1
    )
    pose = (0.0, 1.0, 2.0, 0.5, -0.5, 0.5, 0.5)
    sent = (
        Measurements(7, 0.5, 3, -0.01, 0, (car, car)),
        Commands(3, 0.6, (Command((1.0, 2.0, 3.0, 4.0), 0.05, -0.3),)),
        TruePoses(0.5, (pose,), (pose, pose), (3.1,), 2),
    )
    return [{"message.msgpack": pack(message)} for message in sent]


def _message(folder: Path) -> None:
    try:
        unpack((folder / "message.msgpack").read_bytes())
    except MessageError as error:
        raise InputError(str(error)) from error


def _trained(folder: Path) -> None:
    trainer = Trainer(CONFIG)
    next(trainer.run(trainer.steps_an_iteration, until=2.0))
    trainer.save(folder)


def trained(name: str) -> Files:
    """Return a file of a short training run."""
    return {name: _written(_trained)[0][name]}


def _recordings() -> list[Files]:
    data = Path(__file__).parents[1] / "data"
    every = b"".join(
        gzip.decompress((data / f"{name}.jsonl.gz").read_bytes()) for name in ("traces", "plans")
    )
    return [{"recording.jsonl.gz": gzip.compress(line, 1)} for line in every.splitlines()[::40]]


def _recording(folder: Path) -> None:
    checker = Checker(Rules("published"))
    for number, record in read_records(folder / "recording.jsonl.gz"):
        checker.check(number, record)


_task = cache(lambda: make_task("strip"))


def _trajectory(folder: Path) -> None:
    with tempfile.TemporaryDirectory() as other:
        plan, world = Path(other) / "a.plan", Path(other) / "one.yaml"
        plan.write_text("0 0 STOP\n")
        world.write_text(
            "area_length: 3\narea_width: 3\narea_height: 2\nblock_num: 0\nslope_num: 0\nsmartcar_num: 1\n"
        )
        record_once(str(world), Setup(), 0, plan=plan).write(folder / "run.npz")


FORMATS = {
    "blueprint": Format(
        lambda: [{"a.yaml": text.encode()} for text in _starts()],
        lambda folder: _blueprint(folder / "a.yaml"),
    ),
    "goal": _texts(
        *("a.yaml", read_design),
        *(_shipped("blueprints", f"{name}_goal.yaml") for name in ("strip", "block")),
    ),
    "plan": _texts(
        *("a.plan", lambda path: read_plan(path, n_cars=2)),
        *(_shipped("plans", f"{name}.plan") for name in ("strip", "simple_two_story")),
    ),
    "actions": _texts(
        "a.txt",
        lambda path: read_actions(path, n_cars=2),
        "# tries\n0 MOVE_LEFT\n1 LIFT\n0 ROTATE_RIGHT\n",
    ),
    "task": _texts(
        "a.yaml",
        read_task,
        "start: strip\ngoal: strip_goal\nreward: paper\nmax_steps: 40\ncars: 3\nblocks: 6\n",
        cases=300,
    ),
    "machines": _texts(
        *("a.yaml", load_machines),
        "smartcar: {chassis_mass_kg: 1.1, wheel_torque_nm: 3.0}\ncars: [{}, {wheel_mass_kg: 2.5}]\n"
        "slope: {hinge_speed_rad_s: 1.0}\ngains:\n  drive: {max_speed: 0.4}\n",
    ),
    "gains": _texts("a.yaml", load_gains, _shipped("gains", "fast.yaml")),
    "noise": _texts(
        "a.yaml",
        lambda path: setup_of(noise=path),
        "{min_delay_s: 0.02, max_delay_s: 0.04, position_m: 0.001}\n",
    ),
    "randomization": _texts("a.yaml", setup_of, _shipped("randomizations", "lab_floor.yaml")),
    "settings": _texts(
        "a.yaml", lambda path: read_settings(path, "ippo"), "gamma: 0.98\nepochs: 3\nclip: 0.1\n"
    ),
    "study": _texts(
        "a.yaml", lambda path: read_study(str(path)), _shipped("studies", "quick.yaml")
    ),
    "camera": _texts(
        "a.yaml", read_aim, "{lookat: [0.1, 0.2, 0.3], distance: 2, azimuth: 45, elevation: -30}\n"
    ),
    "topics": _texts(
        "a.yaml",
        read_topics,
        "commands: /told\npose: /pose\njoint_names: {wheel_fl: left, board: lift}\n",
    ),
    "configuration": _texts(
        "config.yaml",
        lambda path: bind(["validate", "--config", str(path)]),
        "command: validate\nversions: {craftsim: 0.4}\noptions:\n  worlds: [strip]\n  plan: null\n  policy: [planner]\n"
        "  seed: 3\n  randomize: mild\n  gains: fast\n  trials: 2\n  area: []\n  video: none\n  minimize: true\n",
        cases=300,
    ),
    "names": _texts(
        "name",
        lambda path: make_policy(path.read_text("utf-8", "surrogateescape"), 0),
        *("json:dumps", "own.policies:greedy", "strip", "random", "planner", "os.path:join"),
        cases=300,
    ),
    "task names": _texts(
        "name",
        lambda path: as_task(path.read_text("utf-8", "surrogateescape")),
        *("strip", "shelf.yaml", "random_strip", "tasks:corner", "os.path:join"),
        cases=300,
    ),
    "picture": Format(_pictures, _design, 150),
    "mesh": Format(_meshes, _design, 100),
    "log": Format(lambda: _written(_write_log), lambda folder: read_log(folder / "log.csv")),
    "bag": Format(lambda: _written(_write_bag), lambda folder: read_log(folder / "log.mcap")),
    "message": Format(_messages, _message),
    "policy": Format(
        lambda: [trained(POLICY_FILE)], lambda folder: read_policy(folder / POLICY_FILE), 40
    ),
    "run": Format(
        lambda: [trained(RUN_FILE)],
        lambda folder: Trainer.resume(folder, task=_task(), config=CONFIG),
        40,
    ),
    "recording": Format(_recordings, _recording, 80),
    "starts": Format(
        lambda: _written(_write_starts),
        lambda folder: _task().starting_from(load_starts(folder / "starts.npz")),
    ),
    "trajectory": Format(
        lambda: _written(_trajectory), lambda folder: Trajectory.read(folder / "run.npz"), 100
    ),
    "replay bundle": Format(lambda: [replays.bundle_files()], read_bundle, 40),
    "resume": Format(lambda: [campaign_folders.files()], campaign_folders.resume, 60),
    "against": Format(lambda: [campaign_folders.files()], campaign_folders.against, 50),
}
"""By name."""


def _write_log(folder: Path) -> None:
    write_table(folder / "log.csv", {0: _log()})


def _write_bag(folder: Path) -> None:
    write_bag(folder / "log.mcap", _log())


def _write_starts(folder: Path) -> None:
    save_starts(folder / "starts.npz", [_task().draw(np.random.default_rng(0))] * 2)
