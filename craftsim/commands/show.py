"""Show a blueprint as coloured text and as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from craftsim.commands.text import say
from craftsim.storage.limits import SEED


def show(
    blueprint: tyro.conf.Positional[Path],
    seed: Annotated[int, SEED] = 0,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
) -> int:
    """Print the world that a blueprint describes, level by level; with --out draw it as a PNG.

    Args:
        blueprint: start file, or the name of a shipped one such as simple_two_story.
        seed: decides what the file leaves to chance.
        out: folder for the picture, which is named after the blueprint.
    """
    import numpy as np

    from craftsim.commands.terminal import Terminal
    from craftsim.discrete.drawing import LEGEND, world_image, world_text
    from craftsim.discrete.files.blueprint import read_blueprint
    from craftsim.discrete.tasks import TASK_NAMES, shipped_blueprint

    path = shipped_blueprint(str(blueprint)) if str(blueprint) in TASK_NAMES else blueprint
    drawing = read_blueprint(path)
    grid = drawing.grid(np.random.default_rng(seed))
    Terminal(highlight=False).print(world_text(grid, drawing.goal))
    say(LEGEND)
    length, width, height = drawing.size
    counts = f"{drawing.n_cars} cars, {drawing.n_blocks} blocks, {drawing.n_slopes} slopes"
    say(f"{length} x {width} cells, {height} levels: {counts}")
    for note in drawing.notes:
        say(f"note: {note}")
    if out is not None:
        import cv2

        from craftsim.report import output_directory
        from craftsim.storage.writing import write_whole

        picture = output_directory(out) / f"{path.stem}.png"
        _, data = cv2.imencode(".png", world_image(grid, drawing.goal)[:, :, ::-1])
        write_whole(picture, data.tobytes())
        say(f"picture: {picture}")
    return 0
