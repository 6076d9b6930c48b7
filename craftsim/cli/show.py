"""Worlds, designs and plans: ``craftsim show``, ``design`` and ``plan``."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Parameter

from craftsim.cli.options import RESULTS_GROUP, Dir, File, OptionalDir, Shown
from craftsim.cli.progress import print_regularly, working
from craftsim.cli.text import print_safe
from craftsim.designs.ranges import DESIGN_SIDE
from craftsim.discrete.ranges import BLOCKS, CARS
from craftsim.errors import InputError
from craftsim.mjcf.drives import Drive
from craftsim.planning.ranges import PLAN_ROUNDS, PLAN_TIME_S
from craftsim.planning.search import DEFAULT_ROUNDS, Objective
from craftsim.storage.folders import owning
from craftsim.storage.limits import SHARE
from craftsim.validation.options import GoalFile, RulesName, Seeded, number

if TYPE_CHECKING:
    from craftsim.designs.starts import DesignStart
    from craftsim.discrete.files.design import Design
    from craftsim.discrete.grid import Grid
    from craftsim.planning import Planned
    from craftsim.planning.plan_file import Plan


_MACHINES: Final = ("smartcar", "block", "flag", "wall", "slope")
_NAMED: Final = 12  # forbidden actions that are named
_DRAWN_CELLS: Final = 16_384
"""Of a picture in which single cells can be told apart."""
_PRINTED_LINES: Final = 80
"""Of a world on the terminal; larger ones are drawn alone."""


def show(
    start: Annotated[Path, Parameter(metavar="TASK|FILE|MACHINE")],
    *,
    chance: Seeded = Seeded(),  # noqa: B008
    design: GoalFile = GoalFile(),  # noqa: B008
    plan: File = None,
    out: OptionalDir = None,
    export: Annotated[tuple[Path, ...], Parameter(metavar="FILE")] = (),
    drive: Drive = "rollers",
) -> int:
    """Print the world of a blueprint, level by level; with --out draw it as PNG.

    With --plan also print the duration of the plan at nominal physics and its forbidden actions; with --out draw its
    Gantt chart (PNG and SVG) and film it on the grid. Exit status: 0, 1 if the plan has a forbidden action, or 2 for
    invalid input.

    Args:
        start: start file, or the name of a task such as simple_two_story or random_strip; or, for --export, a machine:
            smartcar, block, flag, wall or slope.
        plan: plan file, or the name of a shipped plan such as simple_two_story; checked by the physical rules.
        out: folder for the pictures.
        export: files to write the start or machine to: MJCF, or with the suffix .urdf URDF with a folder of meshes, for
            RViz, Gazebo, Isaac or PyBullet, and for ros2_control with controllers beside a car. URDF has no contacts or
            self-locking gears. Of a start each machine becomes a file, and a CSV table says where each stands.
        drive: wheels of the exported cars: rollers, or tyres, to which plain MuJoCo gives equal friction both ways.
    """
    name = str(start)
    if name in _MACHINES:
        from craftsim.models.composition import machine_spec

        if not export:
            raise InputError(f"{name} is a machine, which is written with --export FILE")
        _export(lambda machines: machine_spec(name, machines), export, drive)
        return 0
    import numpy as np

    from craftsim.discrete.drawing import LEGEND, world_text
    from craftsim.discrete.files.blueprint import read_blueprint
    from craftsim.discrete.files.design import read_design
    from craftsim.discrete.files.shipped import shipped_blueprint
    from craftsim.planning.plan_file import read_plan
    from craftsim.reports.terminal import Terminal
    from craftsim.tasks import TASK_NAMES, VARIED_NAMES, as_task

    rng = np.random.default_rng(chance.seed)
    path = start
    if name in TASK_NAMES:
        path = shipped_blueprint(name)
    is_varied = name.partition("@")[0] in VARIED_NAMES
    goal: Design | None = None
    if name in TASK_NAMES or is_varied:
        task = as_task(name).for_episode(rng)
        blueprint = task.starts[0]
        goal = task.design
        grid = task.draw(rng)
    else:
        blueprint = read_blueprint(path)
        grid = blueprint.grid(rng)
    if design.goal:
        goal = read_design(design.goal)
    if goal is not None:
        goal.check_fits(blueprint.size)
    plan_to_show = None
    if plan is not None:
        plan_to_show = read_plan(plan, grid.n_cars)
    Terminal(highlight=False).print(world_text(grid, blueprint.goal))
    print_safe(LEGEND)
    counts = {"cars": blueprint.n_cars, "blocks": blueprint.n_blocks, "slopes": blueprint.n_slopes}
    if is_varied:
        counts = _counts(grid)
    _print_size(blueprint.size, counts)
    for note in blueprint.notes:
        print_safe(f"note: {note}")
    if out is not None:
        from craftsim.storage.folders import output_directory

        _draw(output_directory(out) / f"{path.stem}.png", grid, path.stem, blueprint.goal, goal)
    if export:
        from craftsim.models.composition import check_extent, world_spec
        from craftsim.models.config import SimulationConfig

        check_extent(grid)
        _export(lambda machines: world_spec(grid, SimulationConfig(), machines), export, drive)
    if plan_to_show is None:
        return 0
    return _show_plan(plan_to_show, grid, goal, out)


def _counts(grid: Grid) -> dict[str, int]:
    from craftsim.discrete.kinds import Kind

    kinds = {"blocks": Kind.BLOCK, "slopes": Kind.FSLOPE}
    return {"cars": grid.n_cars} | {
        name: int((grid.kind == kind).sum()) for name, kind in kinds.items()
    }


def _print_size(size: tuple[int, int, int], counts: Mapping[str, int]) -> None:
    from craftsim.reports.report import count

    length, width, height = size
    contents = ", ".join(count(n, name.removesuffix("s")) for name, n in counts.items())
    print_safe(f"{length} x {width} cells, {count(height, 'level')}: {contents}")


def _print_building(goal: Design) -> None:
    """Print how large a design is, in cells and in metres."""
    import numpy as np

    from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
    from craftsim.reports.report import count

    places = np.array([target.cell for target in goal.targets])
    length, width, levels = (np.ptp(places, axis=0) + 1).tolist()
    extent_m = f"{length * CELL_PITCH_M:.2f} x {width * CELL_PITCH_M:.2f} x {levels * LEVEL_HEIGHT_M:.2f} m"
    print_safe(
        f"building: {length} x {width} cells, {count(levels, 'level')}: {extent_m}; "
        f"a cell is {CELL_PITCH_M} m wide and {LEVEL_HEIGHT_M} m high"
    )


def _draw(file: Path, grid: Grid, title: str, goal: Any, design: Design | None) -> None:
    from craftsim.rendering.plots.levels import draw_blueprint

    if design is not None:
        targets = design.targets
    else:
        targets = ()
    print_safe(f"picture: {draw_blueprint(file, grid, title, goal, targets)}")


def _export(spec_of: Callable[[Any], Any], files: Iterable[Path], drive: Drive) -> None:
    """Write a machine or a world with a drive as MJCF or as URDF, which the names' endings say."""
    from craftsim.mjcf.machines import NOMINAL
    from craftsim.models.exporting import LACKS, write_mjcf, write_urdf

    machines = replace(NOMINAL, drive=drive)
    for file in files:
        if file.suffix.lower() == ".urdf":
            for written in write_urdf(file, spec_of(machines)):
                print_safe(f"URDF: {written}")
            print_safe(LACKS)
        else:
            print_safe(f"MJCF: {write_mjcf(file, spec_of(machines))}")


def _show_plan(plan: Plan, grid: Grid, design: Design | None, out: Path | None) -> int:
    from craftsim.discrete.rules import Rules
    from craftsim.discrete.schedule import make_schedule

    rules = Rules("physical")
    schedule = make_schedule(grid, plan.ticks, rules, after=plan.after)
    name = plan.path.stem
    makespan_s = schedule.makespan()
    print_safe(
        f"plan {name}: {len(schedule.acts)} actions in {len(plan.ticks)} ticks, makespan {makespan_s:.1f} s"
    )
    for step in schedule.forbidden[:_NAMED]:
        reason = rules.explain(step.before, step.car, step.action).why
        print_safe(f"forbidden: car {step.car} {step.action.name} in tick {step.tick}: {reason}")
    n_unnamed = len(schedule.forbidden[_NAMED:])
    if n_unnamed:
        print_safe(f"and {n_unnamed} more")
    if out is not None:
        from craftsim.cli.films import draw_plan

        draw_plan(out, schedule, name, True, design)
    return int(bool(schedule.forbidden))


@owning
def design(
    building: Annotated[tuple[str, ...], Parameter(metavar="NAME|FILE")] = (),
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
    chance: Seeded = Seeded(),  # noqa: B008
    out: Dir = Path("out/design"),
) -> int:
    """Write a start with all that a design needs as start.yaml, and the design beside it as start_goal.yaml.

    Exit status: 0, or 2 for invalid input.

    Args:
        building: name of a building, PNG or JPEG files with one level each from the floor up, a closed mesh in metres
            (.obj, .stl or .ply with z up, or .glb), or random.
        size: size of the building in cells, in the order given by --list; for a picture or a mesh the cells of its
            longer side, whatever its unit; for a random building the length, width and height of its bounding box.
        text: text of the building 'letters'.
        difficulty: of a random design without a size, 0 to 1: sets area, blocks, levels, ramps and cars.
        area: length, width and height in cells; default: as large as needed.
        cars: number of cars; default: 2, or drawn for a random design.
        spare_blocks: blocks beyond those of the design, for instance for a scaffold.
        spare_slopes: slopes beyond those of the design; default: one for each upper level without one.
        barrier: put a wall across the middle of the design, and all that it is built from on one side of it.
        names: list the buildings with their sizes, and write nothing.
        out: folder for start.yaml, start_goal.yaml, design.png and report.json.
    """
    from craftsim.designs.finding import listing
    from craftsim.discrete.drawing import LEGEND, world_text
    from craftsim.discrete.files.blueprint import blueprint_text
    from craftsim.discrete.files.design import design_text
    from craftsim.discrete.kinds import Kind
    from craftsim.reports.json_file import write_report
    from craftsim.reports.terminal import Terminal
    from craftsim.storage.writing import write_whole

    if names:
        print_safe(listing())
        return 0
    seed = chance.seed
    spare: dict[str, Any] = {
        "spare_blocks": spare_blocks,
        "spare_slopes": spare_slopes,
        "barrier": barrier,
    }
    with working(f"design {' '.join(building)}"):
        start = _designed(building, size, text, difficulty, area, cars, spare, seed)
    grid = start.grid
    goal = start.design
    finished = world_text(goal.finished(grid.size))
    if finished.plain.count("\n") <= _PRINTED_LINES:
        console = Terminal(highlight=False)
        console.print(finished, soft_wrap=True)
        console.print("start", style="bold")
        console.print(world_text(grid), soft_wrap=True)
        print_safe(LEGEND)
    counts = _counts(grid)
    _print_size(grid.size, counts)
    _print_building(goal)
    print_safe(f"goal: {write_whole(out / 'start_goal.yaml', design_text(goal))}")
    print_safe(f"start: {write_whole(out / 'start.yaml', blueprint_text(grid))}")
    if math.prod(grid.size) <= _DRAWN_CELLS:
        _draw(out / "design.png", grid, goal.path.stem, None, goal)
    targets = {kind.name.lower(): len(goal.of_kind(kind)) for kind in (Kind.BLOCK, Kind.BODY)}
    figures = {"size": grid.size, "design": targets, **counts}
    config = {
        "what": building,
        "size": size,
        "text": text,
        "difficulty": difficulty,
        "area": area,
        "cars": cars,
    }
    written = write_report(out, figures, command="design", seed=seed, config=config | spare)
    print_safe(f"report: {written}")
    return 0


def _designed(
    building: tuple[str, ...],
    size: tuple[int, ...],
    text: str | None,
    difficulty: float,
    area: tuple[int, ...],
    cars: int | None,
    spare: Mapping[str, Any],
    seed: int,
) -> DesignStart:
    """Return the start that the options of :func:`design` ask for."""
    import numpy as np

    from craftsim.designs.drawn import random_start, random_structure
    from craftsim.designs.finding import RANDOM_DESIGN, find_design
    from craftsim.designs.starts import make_start

    rng = np.random.default_rng(seed)
    is_random = building == (RANDOM_DESIGN,)
    if is_random and (text or not size):
        has_spare = spare["spare_blocks"] or spare["spare_slopes"] is not None
        if size or area or text or has_spare or spare["barrier"]:
            raise InputError(
                f"{RANDOM_DESIGN} takes --size, or --difficulty, --cars, --seed and --out alone"
            )
        return random_start(rng, difficulty, cars)
    if len(area) not in (0, 3):
        raise InputError(
            f"--area has {len(area)} numbers; allowed: three, length, width and height in cells"
        )
    extent = None
    if area:
        extent = (area[0], area[1], area[2])
    if is_random:
        structure = random_structure(size, rng)
    else:
        structure = find_design(building, size, text)
    return make_start(structure, 2 if cars is None else cars, rng, extent, **spare)


_ENDING: Final = ".plan"
_PLAN_EVERY_S: Final = 5.0
"""Interval of the lines that say how far the search for a plan is."""


def plan(
    start: str,
    *,
    design: GoalFile = GoalFile(),  # noqa: B008
    objective: Objective = "makespan",
    time_limit: Annotated[float | None, number(PLAN_TIME_S)] = None,
    attempts: Annotated[int, number(PLAN_ROUNDS)] = DEFAULT_ROUNDS,
    chance: Seeded = Seeded(),  # noqa: B008
    rules: RulesName = "physical",
    pddl: OptionalDir = None,
    video: Shown = False,
    out: Annotated[Path, Parameter(metavar="DIR|FILE", group=RESULTS_GROUP)] = Path("out/plan"),
) -> int:
    """Find a plan for a building: the order of assembly, the car for each piece, and every move.

    The plan improves with time; Ctrl-C keeps the best so far. It obeys the rules and contains the dependencies between
    actions. Without a goal the flag goes to its goal in the start file, or all blocks become one platform. Exit
    status: 0, or 2 for invalid input or if no plan is found, with the reason.

    Args:
        start: start file, or the name of a task such as simple_two_story.
        objective: minimize the makespan, or the sum of all actions' durations.
        time_limit: limit of the whole search; without it 60 s for a first plan, improved until 10 s have passed.
        attempts: maximum number of attempts; the same seed and number give the same plan if the time suffices.
        rules: rule set, or a YAML file of learned rules.
        pddl: instead of planning, write domain.pddl and problem.pddl into this folder, for another planner.
        video: film the plan on the grid, too.
        out: file with the suffix .plan, or folder for plan, report and Gantt chart.
    """
    import numpy as np

    from craftsim.discrete.rules import Rules
    from craftsim.planning import plan_building
    from craftsim.planning.pddl import write_pddl
    from craftsim.planning.plan_file import write_plan
    from craftsim.reports.json_file import write_report
    from craftsim.storage.folders import output_directory, owned
    from craftsim.validation.sources import read_goal

    seed = chance.seed
    rng = np.random.default_rng(seed)
    task = read_goal(start, design.goal).for_episode(rng)
    grid = task.draw(rng)
    rule_set = Rules(rules)
    if pddl is not None:
        for path in write_pddl(task, rule_set, pddl):
            print_safe(f"PDDL: {path}")
        return 0
    start_s = time.monotonic()
    least_cost = np.inf
    attempt = 0
    newest: Planned | None = None
    figures_of_best = "no plan yet"

    def report(number: int, planned: Planned | None) -> None:
        nonlocal attempt, least_cost, figures_of_best, newest
        attempt = number
        newest = planned
        if planned is not None and planned.cost(objective)[0] < least_cost - 1e-9:
            least_cost = planned.cost(objective)[0]
            figures_of_best = f"best so far: {_figures(planned)}"
            # At once, for whatever ends the search.
            write_plan(planned.ticks, file, planned.schedule)
            print_safe(
                f"{time.monotonic() - start_s:6.1f} s  attempt {number}: {_figures(planned)}"
            )

    def so_far() -> list[str]:
        return [f"{time.monotonic() - start_s:6.1f} s  {attempt} attempts done: {figures_of_best}"]

    if out.suffix == _ENDING:
        file = out
    else:
        file = out / f"{task.name}{_ENDING}"
    if file is out:
        output_directory(out.parent)
    with nullcontext() if file is out else owned(out):
        with print_regularly(so_far, _PLAN_EVERY_S):
            try:
                planned = plan_building(
                    grid,
                    task,
                    rules=rule_set,
                    objective=objective,
                    rounds=attempts,
                    time_s=time_limit,
                    seed=seed,
                    report=report,
                )
            except KeyboardInterrupt:
                # The best plan so far is what an interrupted search gives.
                if newest is None:
                    raise
                planned = newest
        if not planned.ticks:
            print_safe("the goal is reached already; there is nothing to do")
            return 0
        bound = f"none can take less than {planned.bound_s:.1f} s"
        if planned.optimal:
            bound = "proved to be the best"
        print_safe(f"best: {_figures(planned)}; {bound}")
        write_plan(planned.ticks, file, planned.schedule)
        print_safe(f"plan: {file}")
        if file is not out:
            from craftsim.cli.films import draw_plan

            draw_plan(out, planned.schedule, task.name, video)
            figures = {name: getattr(planned, name) for name in ("makespan_s", "work_s", "bound_s")}
            figures |= {"actions": len(planned.schedule.steps), "found_in_attempt": planned.rounds}
            config = {
                "start": task.name,
                "objective": objective,
                "rounds": attempts,
                "rules": rule_set.rule_set,
            }
            wall = {"planning_s": time.monotonic() - start_s}
            written = write_report(
                out, figures, command="plan", seed=seed, config=config, wall=wall
            )
            print_safe(f"report: {written}")
        return 0


def _figures(planned: Planned) -> str:
    n_actions = len(planned.schedule.steps)
    return f"makespan {planned.makespan_s:.1f} s, work {planned.work_s:.1f} s, {n_actions} actions"
