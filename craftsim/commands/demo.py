"""``craftsim demo``: a drawing becomes a building, and every action is checked."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from craftsim.rendering.backend import RenderingUnavailable, choose_backend
from craftsim.report import output_directory, write_report

if TYPE_CHECKING:
    from craftsim.discrete.actions import Action
    from craftsim.rendering.film import Film
    from craftsim.validation.checked_run import ActionRecord, CheckedRun

_NAME = "simple_two_story"
_FILM_SPEED = 3.0


def demo(
    out: Path = Path("out/demo"),
    video: bool = True,
    seed: int = 0,
    blueprint: Path | None = None,
    plan: Path | None = None,
    goal: Path | None = None,
) -> int:
    """Build a drawing in physics, and check every action against the rules.

    Without files of your own this is the paper's simple two-story building. Exit status 0 when every action
    did what the rules predicted and the building matches its goal, 1 when not, 2 for wrong input.

    Args:
        out: folder for report.json and the film.
        video: make the film; without a rendering backend the demo goes on without it.
        seed: decides what the blueprint leaves to chance.
        blueprint: start file of your own.
        plan: plan file of your own, one 'tick car ACTION' a line.
        goal: goal file of your own; a blueprint of your own needs none.
    """
    started = time.perf_counter()
    console = Console()
    output_directory(out)
    filming = video and _rendering_works(console)
    with _shipped() as data:
        own = blueprint is not None
        goal = goal or (None if own else data / "blueprints" / f"{_NAME}_goal.yaml")
        plan = plan or data / "plans" / f"{_NAME}.plan"
        return _run(
            console,
            blueprint or data / "blueprints" / f"{_NAME}.yaml",
            plan,
            goal,
            out,
            filming,
            seed,
            started,
        )


def _run(
    console: Console,
    blueprint: Path,
    plan: Path,
    goal: Path | None,
    out: Path,
    filming: bool,
    seed: int,
    started: float,
) -> int:
    # MuJoCo must not be imported before the rendering backend is chosen.
    import numpy as np

    from craftsim.discrete.blueprint import read_blueprint
    from craftsim.discrete.design import read_design
    from craftsim.discrete.plan import read_plan
    from craftsim.discrete.rules import Rules
    from craftsim.models.site import Site
    from craftsim.skills.executor import Executor
    from craftsim.validation.checked_run import CheckedSite, run_plan

    drawing = read_blueprint(blueprint)
    actions = read_plan(plan, drawing.n_cars)
    design = read_design(goal) if goal else None
    if design:
        design.check_fits(drawing.size)
    grid = drawing.grid(np.random.default_rng(seed))
    site = Site(
        grid, goals=[target.cell for target in design.targets if target.cell[2] == 1] if design else ()
    )
    executor = Executor(site)
    total = sum(len(tick) for tick in actions.ticks)
    doing: dict[int, Action] = {}
    with _progress(console) as progress, _film(out / f"{blueprint.stem}.mp4", site.model, filming) as film:
        task = progress.add_task("", total=total)

        def observe(site: Site) -> None:
            if film is not None and film.due(site.time_s):
                film.capture(site.data, [_caption(car, doing) for car in range(drawing.n_cars)])

        def begin(tick: int, car: int, action: Action) -> None:
            doing.clear()
            doing[car] = action
            progress.update(task, description=f"tick {tick}: car {car} {action.name}")

        executor.observer = observe
        observe(site)
        run = run_plan(
            CheckedSite(site, Rules("physical"), executor), actions, begin, lambda _: progress.advance(task)
        )
    console.print(_table(run))
    built = design.satisfied(run.final.grid) if design else None
    figures: dict[str, Any] = {
        "actions": [_figures(record) for record in run.records],
        "agree": sum(record.legal and record.verdict.agrees for record in run.records),
        "total": len(run.records),
        "matches_goal": built,
        "simulated_s": run.simulated_s,
        "max_car_error_mm": 1e3 * max(r.car_error_m for r in run.records),
        "max_car_heading_error_mrad": 1e3 * max(abs(r.car_heading_error_rad) for r in run.records),
        "max_placed_error_mm": 1e3 * max(r.placed_error_m or 0.0 for r in run.records),
        "max_others_moved_mm": 1e3 * max(r.others_moved_m for r in run.records),
        "final_cars": run.final.cars,
        "final_objects": run.final.objects,
    }
    config = {
        "simulation": site.config,
        "gains": executor.gains,
        "blueprint": blueprint.name,
        "plan": plan.name,
        "goal": goal.name if goal else None,
        "rules": "physical",
    }
    wall = {"total_s": time.perf_counter() - started}
    _print_worst(console, figures)
    report = write_report(out, figures, command="demo", seed=seed, config=config, wall=wall)
    console.print(f"Report: {report}", soft_wrap=True)
    if film is not None:
        console.print(f"Film:   {out / f'{blueprint.stem}.mp4'} ({film.frames} frames)", soft_wrap=True)
    return _conclude(console, run, built)


def _print_worst(console: Console, figures: dict[str, Any]) -> None:
    console.print(
        f"At worst: cars {figures['max_car_error_mm']:.2f} mm and "
        f"{figures['max_car_heading_error_mrad']:.2f} mrad off, things set down "
        f"{figures['max_placed_error_mm']:.2f} mm off, others moved {figures['max_others_moved_mm']:.2f} mm. "
        f"{figures['simulated_s']:.1f} s simulated.",
        soft_wrap=True,
    )


def _conclude(console: Console, run: CheckedRun, built: bool | None) -> int:
    for record in run.records:
        for difference in record.verdict.differences:
            console.print(
                f"tick {record.tick}, car {record.car} {record.action.name}: {difference}", soft_wrap=True
            )
    agree = sum(record.legal and record.verdict.agrees for record in run.records)
    actions = f"{agree} of {len(run.records)} actions agree with the rules"
    if built is None:
        console.print(f"{actions}; no goal was given.")
    elif built:
        console.print(f"{actions}; the building matches its goal.")
    else:
        console.print(f"{actions}; the building does NOT match its goal.")
    return 0 if run.agrees and built is not False else 1


def _rendering_works(console: Console) -> bool:
    if "mujoco" in sys.modules:
        return True
    try:
        choose_backend()
    except RenderingUnavailable as error:
        console.print(f"No film: {error}", style="yellow", soft_wrap=True, markup=False)
        return False
    return True


@contextmanager
def _shipped() -> Iterator[Path]:
    with as_file(files("craftsim.data")) as folder:
        yield folder


@contextmanager
def _film(path: Path, model: object, wanted: bool) -> Iterator[Film | None]:
    if not wanted:
        yield None
        return
    from craftsim.rendering.film import Film

    with Film(path, model, "overview", speed=_FILM_SPEED) as film:
        yield film


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description:<32}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=console,
        transient=True,
    )


def _caption(car: int, doing: dict[int, Action]) -> str:
    action = doing.get(car)
    return f"car {car}: {action.name.replace('_', ' ').lower() if action is not None else 'waits'}"


def _table(run: CheckedRun) -> Table:
    caption = "cell, heading, load, low or high on a slope; mm, mrad: error of the car"
    table = Table(title="Predicted by the rules, read from poses", caption=caption, box=None, pad_edge=False)
    for heading in ("tick", "car", "action", "predicted", "read", "verdict"):
        table.add_column(heading, no_wrap=heading != "verdict", overflow="fold")
    for heading in ("s", "mm", "mrad"):
        table.add_column(heading, justify="right", no_wrap=True)
    for record in run.records:
        verdict = str(record.verdict.finding) + ("" if record.outcome.succeeded else f"; {record.outcome}")
        good = record.legal and record.verdict.agrees
        table.add_row(
            str(record.tick),
            str(record.car),
            record.action.name,
            record.predicted,
            "same" if record.read == record.predicted else record.read,
            f"[{'green' if good else 'red'}]{verdict}[/]",
            f"{record.outcome.duration_s:.2f}",
            f"{record.car_error_m * 1e3:.2f}",
            f"{record.car_heading_error_rad * 1e3:+.2f}",
        )
    return table


def _figures(record: ActionRecord) -> dict[str, object]:
    return {
        "tick": record.tick,
        "car": record.car,
        "action": record.action,
        "legal": record.legal,
        "predicted": record.predicted,
        "read": record.read,
        "verdict": record.verdict.finding,
        "differences": record.verdict.differences,
        "outcome": str(record.outcome),
        "duration_s": record.outcome.duration_s,
        "car_error_mm": record.car_error_m * 1e3,
        "car_heading_error_mrad": record.car_heading_error_rad * 1e3,
        "placed_error_mm": None if record.placed_error_m is None else record.placed_error_m * 1e3,
        "others_moved_mm": record.others_moved_m * 1e3,
    }
