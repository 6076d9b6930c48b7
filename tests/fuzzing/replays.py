"""Mutated replay bundles, blueprints and files of figures, each read as its command would."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from craftsim.checking.recipe import Recipe, Step
from craftsim.discrete.actions import Action
from craftsim.discrete.files.blueprint import read_blueprint
from craftsim.discrete.files.saving import blueprint_text
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.tasks import shipped_blueprint
from craftsim.errors import InputError
from craftsim.models.parameter_files import load_machines, load_noise
from craftsim.skills.gains import load_gains
from craftsim.validation.replays.bundle import AFTER, BEFORE, PHYSICS, TEXT, read_bundle, write_bundle

VALUES: Final[tuple[Any, ...]] = (
    *(None, True, False, "", "x", "1", [], {}, [[]], {"a": 1}, [None], -1, 0, 1, 2, 3, 99, 2**31, 2**63, 10**400),
    *(-(10**30), 0.5, -0.0, 1e-300, 1e-9, 1e9, 1e300, -1e300, float("nan"), float("inf"), "\x1b[31m", "\u00e9" * 9),
)  # fmt: skip
"""What takes the place of a value."""
PIECES: Final = (
    *(b"0", b"-", b"1e999", b"NaN", b"[", b"]", b"{", b"}", b":", b",", b"null", b'"', b"\\", b"\n", b"  ", b"- "),
    *(b"\xff", b"\x00", b"\xed\xa0\x80", b"&a", b"*a", b"!t", b"---\n", b"9" * 40, b"[" * 300, b"x: 1", b"slope: 2"),
)  # fmt: skip
"""What is put into a text."""
SNAPSHOT: Final = """
snapshot:
  cells:
    - {x: 0, y: 0, z: 1, kind: gear, yaw: 1}
  top:
    - {x: 0, y: 0, z: 0, mark: -2}
  back:
    - {x: 0, y: 0, z: 1, mark: 1}
"""
FIGURES: Final = b"""smartcar: {chassis_mass_kg: 1.1, wheel_torque_nm: 3.0}
cars: [{}, {wheel_mass_kg: 2.5}]
slope: {hinge_speed_rad_s: 1.0}
gains: {drive: {max_speed: 0.6}, hinge: {allowance: 3}}
"""
NOISE: Final = b"{position_m: 0.001, min_delay_s: 0.02, max_delay_s: 0.04}\n"


@cache
def bundle_files() -> dict[str, bytes]:
    """Return the files of a small bundle by name."""
    grid = Grid.empty((3, 2, 2), 2)
    grid.cars[:, :4] = [[0, 0, 1, 0], [0, 1, 1, 0]]
    grid.kind[2, 1, 1] = Kind.BLOCK
    grid.derive_marks()
    turns = [(0, Action.STOP), (1, Action.STOP)]
    steps = (Step.single(0, 0, Action.STOP), Step.joint(1, turns))
    with TemporaryDirectory() as folder:
        write_bundle(Path(folder), "two stops", Recipe(blueprint_text(grid), steps))
        return {name: (Path(folder) / name).read_bytes() for name in (TEXT, PHYSICS, BEFORE, AFTER)}


def mutated_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Return bytes with a few pieces cut out, put in, flipped, doubled or swapped."""
    for _ in range(rng.integers(1, 4)):
        a, b = sorted(rng.integers(0, len(data) + 1, 2).tolist())
        b = min(b, a + int(rng.integers(1, 30)))
        match rng.integers(6):
            case 0:
                data = data[:a] + data[b:]
            case 1:
                data = data[:a] + PIECES[rng.integers(len(PIECES))] + data[a:]
            case 2:
                data = data[:a] + PIECES[rng.integers(len(PIECES))] + data[b:]
            case 3:
                data = data[:b] + data[a:]
            case 4:
                data = data[:a] + bytes(255 - byte for byte in data[a:b]) + data[b:]
            case _:
                data = data[:a]
    return data


def mutated_document(document: Any, rng: np.random.Generator) -> Any:
    """Replace, remove, double or add something anywhere in a document of JSON, in place; return it."""
    places: list[tuple[Any, Any]] = []
    waiting = [document]
    while waiting:
        node = waiting.pop()
        keys = node if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
        places += [(node, key) for key in keys]
        waiting += [node[key] for key in keys]
    node, key = places[rng.integers(len(places))]
    match rng.integers(6):
        case 0 if isinstance(node, dict):
            node[f"{key}x"] = node[key]
        case 1:
            del node[key]
        case 2 if isinstance(node, list):
            node *= int(rng.integers(2, 50))
        case 3 if isinstance(node[key], int | float):
            node[key] *= float(10.0 ** rng.integers(-9, 10))
        case _:
            node[key] = VALUES[rng.integers(len(VALUES))]
    return document


def _read(read: Callable[[], object]) -> None:
    try:
        read()
    except InputError:
        return


def attack_bundle(rng: np.random.Generator, folder: Path) -> None:
    """Read a bundle of which one file is changed."""
    files = dict(bundle_files())
    name = [TEXT, TEXT, TEXT, PHYSICS, BEFORE, AFTER][rng.integers(6)]
    if name == TEXT and rng.random() < 0.7:
        document = json.loads(files[TEXT])
        for _ in range(rng.integers(1, 4)):
            mutated_document(document, rng)
        files[TEXT] = json.dumps(document).encode()
    else:
        files[name] = mutated_bytes(files[name], rng)
    for name, data in files.items():
        (folder / name).write_bytes(data)
    _read(lambda: read_bundle(folder))


def attack_blueprint(rng: np.random.Generator, folder: Path) -> None:
    """Read a changed blueprint; what is accepted must be readable again once it is written."""
    names = ("strip", "block", "simple_two_story", "complex_two_story", "breaking_barrier")
    text = shipped_blueprint(names[rng.integers(len(names))]).read_bytes()
    text += SNAPSHOT.encode() * int(rng.integers(2))
    path = folder / "mutated.yaml"
    path.write_bytes(mutated_bytes(text, rng))

    def read() -> None:
        grid = read_blueprint(path).grid(rng)
        try:
            path.write_text(blueprint_text(grid))
            again = read_blueprint(path).grid(rng)
        except InputError as error:
            raise AssertionError(f"accepted, but not to be written: {error}") from error
        assert again.same_visible(grid)

    _read(read)


def attack_figures(rng: np.random.Generator, folder: Path) -> None:
    """Read a changed file of gains, of machines or of noise."""
    path = folder / "figures.yaml"
    load, data = [(load_gains, FIGURES), (load_machines, FIGURES), (load_noise, NOISE)][rng.integers(3)]
    path.write_bytes(mutated_bytes(data, rng))
    _read(lambda: load(path))


def attack(rng: np.random.Generator, folder: Path) -> None:
    """Make one case of any of the formats."""
    list(TARGETS.values())[rng.integers(len(TARGETS))](rng, folder)


TARGETS: Final[dict[str, Callable[[np.random.Generator, Path], None]]] = {
    "replay bundle": attack_bundle,
    "blueprint": attack_blueprint,
    "gains, machines, noise": attack_figures,
}
