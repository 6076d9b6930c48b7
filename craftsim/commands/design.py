"""``craftsim design``: a design, and a start to build it from, out of a library, pictures, a mesh or chance."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from craftsim.commands.options import Dir
from craftsim.commands.text import say
from craftsim.storage.limits import BLOCKS, CARS, DESIGN_SIDE, SEED, SHARE


def design(
    what: tyro.conf.Positional[tuple[str, ...]] = (),
    size: Annotated[tuple[int, ...], DESIGN_SIDE, tyro.conf.arg(metavar="N...", help_behavior_hint="")] = (),
    text: str | None = None,
    difficulty: Annotated[float, SHARE] = 0.5,
    cars: Annotated[int | None, CARS] = None,
    area: Annotated[
        tuple[int, int, int] | None, DESIGN_SIDE, tyro.conf.arg(metavar="L W H", help_behavior_hint="")
    ] = None,
    spare_blocks: Annotated[int, BLOCKS] = 0,
    spare_slopes: Annotated[int | None, BLOCKS] = None,
    list: bool = False,
    seed: Annotated[int, SEED] = 0,
    out: Dir = Path("out/design"),
) -> int:
    """Write a design as a goal file, and a start that has the blocks and slopes for it; print and draw both.

    WHAT is a building of the library, a picture (PNG) a level from the floor up, a mesh (.obj or .stl), or 'random'. What
    stays in --out: goal.yaml, start.yaml, design.png and report.json. Exit status 0, or 2 for wrong input.

    Args:
        what: name, picture files, mesh file or 'random'.
        size: sizes of the building, in cells, in the order of --list; of a mesh its longest side in cells.
        text: of letters.
        difficulty: of a random design: 0 to 1.
        cars: how many; 2 unless given, or as many as a random design draws.
        area: length, width and height of the area in cells; as large as is needed unless given.
        spare_blocks: blocks beyond those of the design, such as for a scaffold.
        spare_slopes: slopes beyond those of the design; one for each upper level without one of its own unless given.
        list: print the names of the library with their sizes, and stop.
        seed: decides a random design, and the places of all things.
        out: folder for the files.
    """
    import numpy as np

    from craftsim.commands.terminal import Terminal
    from craftsim.designs.doors import RANDOM, listing, start_of
    from craftsim.discrete.drawing import LEGEND, world_text
    from craftsim.discrete.files.saving import write_blueprint, write_design
    from craftsim.discrete.kinds import Kind
    from craftsim.errors import InputError
    from craftsim.rendering.plots.blueprint import draw_blueprint
    from craftsim.rendering.shapes import wanted_of
    from craftsim.report import output_directory, write_report

    if list:
        say(listing())
        return 0
    if not what:
        raise InputError(f"nothing to design; allowed: a name of 'craftsim design --list', PNG or mesh files, {RANDOM}")
