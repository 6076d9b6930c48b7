"""``craftsim design``: a design from a library, pictures, a mesh or chance, and a start to build it from."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from craftsim.cli.options import Dir
from craftsim.cli.text import say
from craftsim.options import number
from craftsim.storage.folders import owning
from craftsim.storage.limits import BLOCKS, CARS, DESIGN_SIDE, PHYSICS_CELLS, SEED, SHARE

if TYPE_CHECKING:
    from craftsim.designs.starts import DesignStart

CARS_UNLESS_GIVEN = 2


@owning
def design(
    what: Annotated[tuple[str, ...], Parameter(metavar="NAME|FILE")] = (),
    *,
    size: Annotated[tuple[int, ...], number(DESIGN_SIDE)] = (),
    text: str | None = None,
    difficulty: Annotated[float, number(SHARE)] = 0.5,
    area: Annotated[tuple[int, ...], number(DESIGN_SIDE)] = (),
    cars: Annotated[int | None, number(CARS)] = None,
    spare_blocks: Annotated[int, number(BLOCKS)] = 0,
    spare_slopes: Annotated[int | None, number(BLOCKS)] = None,
    barrier: bool = False,
    names: Annotated[bool, Parameter(name="--list")] = False,
    seed: Annotated[int, number(SEED)] = 0,
    out: Dir = Path("out/design"),
) -> int:
    """Write a design as goal.yaml, and as start.yaml a world with what it takes; print and draw them.

    WHAT is a building of the library, PNG files of a level each from the floor up, a mesh (.obj or .stl), or random.
    Exit status 0, or 2 for wrong input.

    Args:
        what: name of a building, files, or random.
        size: sizes of the building in cells, in the order of --list; of a mesh the cells of its longer side.
        text: what letters say.
        difficulty: of a random design, 0 to 1: sets area, blocks, levels, ramps and cars.
        area: length, width and height in cells; as large as the pieces need unless given.
        cars: 2 unless given, or as many as the random design draws.
        spare_blocks: blocks beyond those of the design, such as for a scaffold.
        spare_slopes: slopes beyond those of the design; one for each upper level without one of its own unless given.
        barrier: put walls from side to side across the middle of the design.
        names: print the names of the library with their sizes, and write nothing.
        seed: random seed of the design and of where pieces lie.
        out: folder for goal.yaml, start.yaml, design.png and report.json.
    """
    import numpy as np

    from craftsim.designs.drawn import random_start
    from craftsim.designs.finding import RANDOM, find_design, listing
    from craftsim.designs.starts import make_start
    from craftsim.errors import InputError

    if names:
        say(listing())
        return 0
    rng = np.random.default_rng(seed)
    if what == (RANDOM,):
        if size or area or text or spare_blocks or spare_slopes is not None or barrier:
            raise InputError(f"{RANDOM} takes --difficulty, --cars, --seed and --out alone")
        start: DesignStart = random_start(rng, difficulty, cars)
    else:
        if len(area) not in (0, 3):
            raise InputError(
                f"--area has {len(area)} numbers; allowed: three, length, width and height in cells"
            )
        found = find_design(what, size, text)
        number = CARS_UNLESS_GIVEN if cars is None else cars
        extent = (area[0], area[1], area[2]) if area else None
        spare = {"spare_blocks": spare_blocks, "spare_slopes": spare_slopes, "barrier": barrier}
        start = make_start(found, number, rng, extent, **spare)  # type: ignore[arg-type]
    config: dict[str, object] = {
        "what": what,
        "size": size,
        "text": text,
        "difficulty": difficulty,
        "area": area,
        "cars": cars,
    }
    config |= {"spare_blocks": spare_blocks, "spare_slopes": spare_slopes, "barrier": barrier}
    _write(start, out, seed, config)
    return 0


def _write(start: DesignStart, out: Path, seed: int, config: dict[str, object]) -> None:
    from craftsim.discrete.drawing import LEGEND, world_text
    from craftsim.discrete.files.blueprint import blueprint_text
    from craftsim.discrete.files.design import design_text
    from craftsim.discrete.kinds import Kind
    from craftsim.reports.json_file import write_report
    from craftsim.reports.terminal import Terminal
    from craftsim.storage.writing import write_whole

    grid, goal = start.grid, start.design
    texts = {"goal": design_text(goal), "start": blueprint_text(grid)}
    console = Terminal(highlight=False)
    console.print(world_text(goal.finished(grid.size)), soft_wrap=True)
    console.print("start", style="bold")
    console.print(world_text(grid), soft_wrap=True)
    say(LEGEND)
    counts = {
        "cars": grid.n_cars,
        "blocks": int((grid.kind == Kind.BLOCK).sum()),
        "slopes": int((grid.kind == Kind.FSLOPE).sum()),
    }
    length, width, height = grid.size
    say(
        f"{length} x {width} cells, {height} levels: {', '.join(f'{n} {what}' for what, n in counts.items())}"
    )
    for name, text in texts.items():
        say(f"{name}: {write_whole(out / f'{name}.yaml', text)}")
    if length * width * height <= PHYSICS_CELLS:
        from craftsim.rendering.grid_picture import wanted_of
        from craftsim.rendering.plots.levels import draw_blueprint

        say(f"picture: {draw_blueprint(out / 'design.png', grid, goal.path.stem, None, wanted_of(goal))}")
    targets = {kind.name.lower(): len(goal.of_kind(kind)) for kind in (Kind.BLOCK, Kind.BODY)}
    figures = {"size": grid.size, "design": targets, **counts}
    say(f"report: {write_report(out, figures, command='design', seed=seed, config=config)}")
