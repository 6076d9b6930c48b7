"""Damaged pictures and meshes, as designs."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import trimesh

from craftsim.designs.finding import find_design
from fuzzing.mutations import mutated_bytes, mutated_text


@cache
def _picture(channels: int) -> bytes:
    pixels = np.full((6, 5, channels), 255, np.uint8)
    pixels[1:4, 2:4] = 9
    return cv2.imencode(".png", pixels)[1].tobytes()


@cache
def _mesh(suffix: str) -> bytes:
    found = trimesh.creation.box((0.9, 0.6, 0.4)).export(file_type=suffix)
    return found if isinstance(found, bytes) else found.encode()


def picture(rng: np.random.Generator, folder: Path) -> None:
    """Read a mutated picture as a design."""
    path = folder / "level.png"
    path.write_bytes(mutated_bytes(_picture((1, 3, 4)[rng.integers(3)]), rng))
    find_design([str(path)])


def mesh(rng: np.random.Generator, folder: Path) -> None:
    """Read a mutated mesh as a design."""
    suffix = ("obj", "stl")[rng.integers(2)]
    path, data = folder / f"mesh.{suffix}", _mesh(suffix)
    if suffix == "obj":
        data = mutated_text(data.decode(), rng).encode("utf-8", "surrogatepass")
    path.write_bytes(data if suffix == "obj" and rng.random() < 0.7 else mutated_bytes(data, rng))
    find_design([str(path)], [int(rng.integers(1, 20))] if rng.random() < 0.5 else [])


TARGETS: dict[str, Callable[[np.random.Generator, Path], None]] = {"picture": picture, "mesh": mesh}
