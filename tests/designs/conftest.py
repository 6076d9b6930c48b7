"""Files of designs, sound ones and others."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M


@pytest.fixture
def picture(tmp_path):
    """Write rows of '#' and '.', the top one first, as a PNG; black on white unless other colours are given."""

    def write(name: str, *rows: str, ink=(0, 0, 0), paper=(255, 255, 255)) -> Path:
        pixels = np.array(
            [[ink if sign == "#" else paper for sign in row] for row in rows], np.uint8
        )
        assert cv2.imwrite(str(tmp_path / name), pixels)
        return tmp_path / name

    return write


@pytest.fixture
def box(tmp_path):
    """Write a mesh that fills as many cells as it says."""

    def write(name: str, *cells: int) -> Path:
        sides = np.array(cells) * (CELL_PITCH_M, CELL_PITCH_M, LEVEL_HEIGHT_M)
        trimesh.creation.box(sides).export(tmp_path / name)
        return tmp_path / name

    return write
