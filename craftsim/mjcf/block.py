"""The block, a table that stacks, and that a smartcar can drive under and lift, and what else has its shape.

Frame: origin on the floor under the centre, z up. A flag is carried like a block, but nothing may stand on it; a wall
is an obstacle, bolted to the floor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np

from craftsim.discrete.kinds import CARRIED, Kind
from craftsim.mjcf.building import CORNERS, TOUCHES, MachineBuilder, Pose, digits, surface, volume
from craftsim.mjcf.machines import Machines
from craftsim.mjcf.parameters import BEVEL, BlockParameters
from craftsim.mjcf.solids import ClosedSolid, Interval, box, loft, square, turned


@dataclass(frozen=True)
class Table:
    """A kind with a block's shape: what it is, and how it looks."""

    title: str
    rgb: tuple[float, float, float]
    top: tuple[str, str, tuple[float, float, float, float]] | None = None
    """Parts that are seen besides the table: geom, mesh and colour."""


TABLES: Final = {
    Kind.BLOCK: Table(
        "A table that stacks, and that a smartcar can drive under and lift.",
        (0.93, 0.72, 0.35),
        ("trim", "block_trim", (0.45, 0.32, 0.20, 1.0)),
    ),
    Kind.FLAG: Table(
        "A flag on a table: lifted and carried like a block, but nothing may stand on it.",
        (0.88, 0.84, 0.76),
        ("flag_visual", "flag", (0.80, 0.16, 0.20, 1.0)),
    ),
    Kind.WALL: Table("An obstacle: a table, bolted to the floor.", (0.42, 0.44, 0.47)),
}
"""The kinds with a block's shape; those that cars do not carry are bolted to the floor."""
TABLE_NAMES: Final = {kind.name.lower(): kind for kind in TABLES}
"""Their kinds by the names of their machines."""


def add_block(
    spec: mujoco.MjSpec,
    prefix: str,
    pose: Pose,
    machines: Machines,
    name: str = "block",
    visual: bool = True,
) -> None:
    """Add a block, or another table, to a spec.

    Four legs and a deck over a frame of four bars, which leaves a pocket for a smartcar's boss; the deck's mass is
    shared by volume. Legs end in round rubber feet at their outer corners: one point of contact each, on as wide a
    stand and, by ``foot_stiffness_ratio``, as firm. The frame stands on a board by its front and back bars; the other
    two, a little higher, only stop the boss, by its bevel. Other arguments are as of :func:`craftsim.mjcf.car.add_car`.
    """
    block = machines.block
    contact = machines.contact
    table = TABLES[TABLE_NAMES[name]]
    of_solid = {"type": mujoco.mjtGeom.mjGEOM_BOX, "rgba": [*table.rgb, 0.4]}
    of_solid |= {**TOUCHES["things"], **surface(contact, block.friction)}
    builder = MachineBuilder(spec, prefix, name, visual, block_looks, block, **of_solid)
    body = builder.body(pose, free=TABLE_NAMES[name] in CARRIED)
    builder.show(body, "table_visual", "block", (*table.rgb, 1.0))
    if table.top is not None:
        builder.show(body, *table.top)
    bars = _bars(block)
    density = block.deck_mass_kg / sum(volume(*spans) for spans in bars.values())
    for bar, spans in bars.items():
        builder.add_box(body, builder.solid, bar, spans, density)
    rubber = builder.geoms(
        "foot",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[block.foot_radius_m, 0, 0],
        mass=0,
        priority=1,
        **surface(contact, block.foot_friction, contact.foot_stiffness_ratio),
    )
    leg = block.leg_offset_m
    foot = digits(block.side_m / 2 - block.foot_radius_m)
    length = block.underside_m - block.foot_proud_m
    proud = block.underside_m + block.foot_proud_m
    half = digits((block.leg_side_m / 2, block.leg_side_m / 2, length / 2))
    for corner, (x, y) in CORNERS.items():
        place = [x * leg, y * leg, digits(proud / 2)]
        builder.add(
            body, builder.solid, f"leg_{corner}", pos=place, size=half, mass=block.leg_mass_kg
        )
        builder.add(body, rubber, f"foot_{corner}", pos=[x * foot, y * foot, block.foot_radius_m])


def _bars(block: BlockParameters) -> dict[str, tuple[Interval, ...]]:
    """Return deck and frame of a block by name, as intervals of x, y and z."""
    half = block.side_m / 2
    pocket = block.pocket_side_m / 2
    low = block.underside_m
    high = block.underside_m + block.pocket_depth_m
    relief = block.frame_relief_m
    side = pocket - relief * BEVEL
    return {
        "deck": ((-half, half), (-half, half), (high, block.height_m)),
        "frame_front": ((pocket, half), (-half, half), (low, high)),
        "frame_back": ((-half, -pocket), (-half, half), (low, high)),
        "frame_left": ((-pocket, pocket), (side, half), (low + relief, high)),
        "frame_right": ((-pocket, pocket), (-half, -side), (low + relief, high)),
    }


def block_looks(block: BlockParameters) -> dict[str, list[ClosedSolid]]:
    """Return the solids of the meshes that are only seen, by name; their origin is on the floor, in the middle."""
    return {"block": _block(block), "block_trim": _block_trim(block), "flag": _flag(block)}


def _block(p: BlockParameters) -> list[ClosedSolid]:
    """Table: deck with a pocket under it, four legs, round seats on top; origin on the floor."""
    bottom = p.underside_m
    top = p.height_m
    half = p.side_m / 2
    leg = p.leg_side_m
    bevel = 0.005
    pocket = p.pocket_side_m + 0.0018
    sides = pocket, pocket, 2 * (half - bevel), 2 * half, 2 * half, 2 * (half - bevel)
    heights = bottom + p.pocket_depth_m, bottom, bottom, bottom + bevel, top - bevel, top
    deck = loft([square(*level) for level in zip(sides, heights, strict=True)])
    foot = loft([square(leg - 0.006, 0.0), square(leg, 0.003), square(leg, bottom + 0.001)])
    low = top - 0.001
    high = top + 0.0006
    ring = [[0.0085, low], [0.0115, low], [0.0112, high], [0.0088, high], [0.0085, low]]
    seat = turned(ring, 20, about_y=False)
    corners = []
    for x in (-p.leg_offset_m, p.leg_offset_m):
        for y in (-p.leg_offset_m, p.leg_offset_m):
            corners.append((x, y))
    return [deck, *(foot.moved(x, y) for x, y in corners), *(seat.moved(x, y) for x, y in corners)]


def _block_trim(p: BlockParameters) -> list[ClosedSolid]:
    """Plates on the block's four flanks, 0.5 mm proud: a second colour over the block."""
    half = p.side_m / 2
    across = (0.040 - p.side_m / 2, p.side_m / 2 - 0.040)
    panel = box((half - 0.002, half + 0.0005), across, (p.underside_m + 0.0165, p.height_m - 0.017))
    return [panel.rolled(quarter * np.pi / 2) for quarter in range(4)]


def _flag(p: BlockParameters) -> list[ClosedSolid]:
    """Pole and pennant standing on a block's deck; origin on the floor, at the block's middle."""
    pole = [
        [0.0, 0.0],
        [0.018, 0.0],
        [0.018, 0.003],
        [0.0045, 0.006],
        [0.0035, 0.158],
        [0.006, 0.161],
    ]
    rod = turned([*pole, [0.006, 0.165], [0.0, 0.168]], 14, about_y=False)
    rings = []
    for along in np.linspace(0.0, 1.0, 9):
        wave = 0.006 * np.sin(2 * np.pi * 1.1 * along) * along
        half = 0.034 * (1 - 0.92 * along)
        corners = [(-0.0008, -half), (0.0008, -half), (0.0008, half), (-0.0008, half)]
        rings.append(np.array([[0.002 + 0.105 * along, wave + y, 0.118 + z] for y, z in corners]))
    return [solid.moved(z=p.height_m) for solid in (rod, loft(rings))]
