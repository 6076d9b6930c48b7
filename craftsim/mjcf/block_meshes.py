"""The visual meshes of block and flag, made from a block's figures."""

from __future__ import annotations

import numpy as np
import trimesh

from craftsim.mjcf.parameters import BlockParameters
from craftsim.mjcf.solids import Parts, box, loft, moved, square


def block(p: BlockParameters) -> Parts:
    """Table: deck with a pocket under it, four legs, round seats on top; origin on the floor."""
    bottom, top, half, leg = p.underside_m, p.height_m, p.side_m / 2, p.leg_side_m
    bevel = 0.005
    pocket = p.pocket_side_m + 0.0018
    deck = loft(
        [
            square(pocket, bottom + p.pocket_depth_m),
            square(pocket, bottom),
            square(2 * (half - bevel), bottom),
            square(2 * half, bottom + bevel),
            square(2 * half, top - bevel),
            square(2 * (half - bevel), top),
        ]
    )
    foot = loft([square(leg - 0.006, 0.0), square(leg, 0.003), square(leg, bottom + 0.001)])
    low, high = top - 0.001, top + 0.0006
    ring = [[0.0085, low], [0.0115, low], [0.0112, high], [0.0088, high], [0.0085, low]]
    seat = trimesh.creation.revolve(np.array(ring), sections=20)
    corners = [(x, y) for x in (-p.leg_offset_m, p.leg_offset_m) for y in (-p.leg_offset_m, p.leg_offset_m)]
    return [deck, *(moved(foot, x, y) for x, y in corners), *(moved(seat, x, y) for x, y in corners)]


def block_trim(p: BlockParameters) -> Parts:
    """Plates on the block's four flanks, 0.5 mm proud: a second colour over the block."""
    parts = []
    half = p.side_m / 2
    for quarter in range(4):
        panel = box(
            (half - 0.002, half + 0.0005),
            (0.040 - half, half - 0.040),
            (p.underside_m + 0.0165, p.height_m - 0.017),
        )
        parts.append(
            panel.apply_transform(trimesh.transformations.rotation_matrix(quarter * np.pi / 2, (0, 0, 1)))
        )
    return parts


def flag(p: BlockParameters) -> Parts:
    """Pole and pennant standing on a block's deck; origin on the floor, at the block's middle."""
    pole = [[0, 0], [0.018, 0], [0.018, 0.003], [0.0045, 0.006], [0.0035, 0.158], [0.006, 0.161]]
    rod = trimesh.creation.revolve(np.array([*pole, [0.006, 0.165], [0, 0.168]]), sections=14)
    rings = []
    for along in np.linspace(0.0, 1.0, 9):
        wave = 0.006 * np.sin(2 * np.pi * 1.1 * along) * along
        half = 0.034 * (1 - 0.92 * along)
        corners = [(-0.0008, -half), (0.0008, -half), (0.0008, half), (-0.0008, half)]
        rings.append(np.array([[0.002 + 0.105 * along, wave + y, 0.118 + z] for y, z in corners]))
    return [moved(part, z=p.height_m) for part in (rod, loft(rings))]
