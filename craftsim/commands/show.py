"""Show a blueprint as coloured text and as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from craftsim.commands.options import File
from craftsim.commands.text import say
from craftsim.storage.limits import SEED


def show(
    blueprint: tyro.conf.Positional[Path],
    seed: Annotated[int, SEED] = 0,
    goal: File = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
) -> int:
    """Print the world that a blueprint describes, level by level; with --out draw it as a PNG.

    Args:
        blueprint: start file, or the name of a shipped one such as simple_two_story.
        seed: decides what the file leaves to chance.
        goal: goal file whose cells are marked in the picture; that of a shipped task unless given.
        out: folder for the picture, which is named after the blueprint.
    """
    import numpy as np

    from craftsim.commands.terminal import Terminal
    from craftsim.discrete.drawing import LEGEND, world_text
    from craftsim.discrete.files.blueprint import read_blueprint
    from craftsim.discrete.files.design import read_design
    from craftsim.discrete.tasks import TASK_NAMES, make_task, shipped_blueprint

    shipped = str(blueprint) in TASK_NAMES
    path = shipped_blueprint(str(blueprint)) if shipped else blueprint
    drawing = read_blueprint(path)
    design = make_task(str(blueprint)).design if shipped else None
    if goal is not None:
        design = read_design(goal)
    if design is not None:
        design.check_fits(drawing.size)
    grid = drawing.grid(np.random.default_rng(seed))
    Terminal(highlight=False).print(world_text(grid, drawing.goal))
    say(LEGEND)
    length, width, height = drawing.size
    counts = f"{drawing.n_cars} cars, {drawing.n_blocks} blocks, {drawing.n_slopes} slopes"
    say(f"{length} x {width} cells, {height} levels: {counts}")
    for note in drawing.notes:
        say(f"note: {note}")
    if out is not None:
        from craftsim.rendering.plots.blueprint import draw_blueprint
        from craftsim.rendering.shapes import wanted_of
        from craftsim.report import output_directory

        file = output_directory(out) / f"{path.stem}.png"
        say(f"picture: {draw_blueprint(file, grid, path.stem, drawing.goal, wanted_of(design))}")
    return 0
