"""Show a blueprint as coloured text and as a picture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

from cyclopts import Parameter

from craftsim.choices import Drive
from craftsim.cli.options import File, OptionalDir
from craftsim.cli.text import say
from craftsim.errors import InputError
from craftsim.options import number
from craftsim.storage.limits import SEED

if TYPE_CHECKING:
    from mujoco import MjSpec

    from craftsim.discrete.files.design import Design
    from craftsim.discrete.files.plan import Plan
    from craftsim.discrete.grid import Grid
    from craftsim.mjcf.parameters import Machines

Machine = Literal["smartcar", "block", "flag", "wall", "slope"]
_NAMED: Final = 12
"""Forbidden actions that are named."""


def show(
    start: Annotated[Path | None, Parameter(metavar="TASK|FILE")] = None,
    *,
    seed: Annotated[int, number(SEED)] = 0,
    goal: File = None,
    plan: File = None,
    out: OptionalDir = None,
    mjcf: File = None,
    urdf: File = None,
    machine: Machine | None = None,
    drive: Drive = "rollers",
) -> int:
    """Print the world that a blueprint describes, level by level; with --out draw it as a PNG.

    With --plan also say how long the plan takes at nominal physics, and what of it the rules forbid; with --out draw
    its Gantt chart (PNG and SVG), and film it on the grid, without physics. Exit status 0, 1 where the plan has an
    action that is forbidden, or 2 for wrong input.

    Args:
        start: start file, or the name of a shipped one such as simple_two_story, or of a task that varies, such as
            random_strip.
        seed: decides what is left to chance.
        goal: goal file whose cells are marked in the picture; that of a shipped task unless given.
        plan: plan file, or the name of a shipped plan such as simple_two_story; judged by the physical rules.
        out: folder for the picture, which is named after the blueprint, and those of the plan.
        mjcf: file for the world's start, or the machine, as MJCF that opens alone in MuJoCo's viewer.
        urdf: file for the same as URDF, its meshes in a folder beside it, for RViz, Gazebo or Isaac: links, inertias,
            shapes and joints; without contacts, motors besides their limits, and gears that lock themselves.
        machine: writes one machine alone, in place of a blueprint.
        drive: of the cars that are written.
    """
    if (start is None) == (machine is None):
        raise InputError("give a world, or a --machine with --mjcf or --urdf, and not both")
    if machine is not None and mjcf is None and urdf is None:
        raise InputError("--machine is written with --mjcf, --urdf or both")
    if start is None:
        from craftsim.models.composition import machine_spec

        _export(lambda machines: machine_spec(str(machine), machines), mjcf, urdf, drive)
        return 0
    import numpy as np

    from craftsim.discrete.drawing import LEGEND, world_text
    from craftsim.discrete.files.blueprint import read_blueprint
    from craftsim.discrete.files.design import read_design
    from craftsim.discrete.files.plan import read_plan
    from craftsim.discrete.files.shipped import shipped_blueprint
    from craftsim.discrete.grid import Kind
    from craftsim.discrete.tasks import TASK_NAMES, VARIED_NAMES, as_task
    from craftsim.reports.terminal import Terminal

    name, rng = str(start), np.random.default_rng(seed)
    shipped, varied = name in TASK_NAMES, name.partition("@")[0] in VARIED_NAMES
    path = shipped_blueprint(name) if shipped else start
    task = as_task(name).for_episode(rng) if shipped or varied else None
    drawing = read_blueprint(path) if task is None else task.starts[0]
    design = task.design if task is not None else None
    if goal is not None:
        design = read_design(goal)
    if design is not None:
        design.check_fits(drawing.size)
    grid = drawing.grid(rng) if task is None else task.draw(rng)
    read = None if plan is None else read_plan(plan, grid.n_cars)
    Terminal(highlight=False).print(world_text(grid, drawing.goal))
    say(LEGEND)
    length, width, height = drawing.size
    blocks, slopes = drawing.n_blocks, drawing.n_slopes
    if varied:
        blocks, slopes = (int((grid.kind == kind).sum()) for kind in (Kind.BLOCK, Kind.FSLOPE))
    counts = f"{drawing.n_cars} cars, {blocks} blocks, {slopes} slopes"
    say(f"{length} x {width} cells, {height} levels: {counts}")
    for note in drawing.notes:
        say(f"note: {note}")
    if out is not None:
        from craftsim.rendering.grid_picture import wanted_of
        from craftsim.rendering.plots.levels import draw_blueprint
        from craftsim.storage.folders import output_directory

        file = output_directory(out) / f"{path.stem}.png"
        say(f"picture: {draw_blueprint(file, grid, path.stem, drawing.goal, wanted_of(design))}")
    if mjcf is not None or urdf is not None:
        from craftsim.models.composition import WorldSpec, check_extent
        from craftsim.models.config import SimulationConfig

        check_extent(grid)
        _export(
            lambda machines: WorldSpec(grid, SimulationConfig.of(drive), machines).spec(), mjcf, urdf, drive
        )
    return 0 if read is None else _show_plan(read, grid, design, out)


def _export(
    spec_of: Callable[[Machines], MjSpec], mjcf: Path | None, urdf: Path | None, drive: Drive
) -> None:
    """Write a machine or a world with a drive as MJCF, as URDF, or both."""
    from craftsim.mjcf.parameters import NOMINAL
    from craftsim.models.exporting import LACKS, write_mjcf, write_urdf

    machines = replace(NOMINAL, drive=drive)
    if mjcf is not None:
        say(f"MJCF: {write_mjcf(mjcf, spec_of(machines))}")
    if urdf is not None:
        say(f"URDF: {write_urdf(urdf, spec_of(machines))}")
        say(LACKS)


def _show_plan(plan: Plan, grid: Grid, design: Design | None, out: Path | None) -> int:
    """Say how long a plan takes and what of it is forbidden, draw and film it; return the exit status."""
    from craftsim.cli.progress import counting
    from craftsim.discrete.rules import Rules
    from craftsim.discrete.schedule import make_schedule
    from craftsim.reports.terminal import Terminal

    rules = Rules("physical")
    schedule = make_schedule(grid, plan.ticks, rules, after=plan.after)
    took, name = schedule.makespan(), plan.path.stem
    say(f"plan {name}: {len(schedule.acts)} actions in {len(plan.ticks)} ticks, makespan {took:.1f} s")
    for step in schedule.forbidden[:_NAMED]:
        why = rules.explain(step.before, step.car, step.action).why
        say(f"forbidden: car {step.car} {step.action.name} in tick {step.tick}: {why}")
    if more := len(schedule.forbidden[_NAMED:]):
        say(f"and {more} more")
    if out is not None:
        from craftsim.rendering.grid_picture import wanted_of
        from craftsim.rendering.plan_film import film_plan
        from craftsim.rendering.plots.gantt import FORMATS, draw_gantt

        for ending in FORMATS:
            say(f"Gantt chart: {draw_gantt(out / f'{name}-gantt{ending}', schedule, name)}")
        console = Terminal()
        film = film_plan(
            *(out / f"{name}-plan.mp4", schedule, rules, name, wanted_of(design)),
            progress=lambda total: counting(console, "frames", total, bool),
        )
        say(f"film: {film}")
    return int(bool(schedule.forbidden))
