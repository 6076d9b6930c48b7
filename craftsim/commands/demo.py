"""``craftsim demo``: drawings become buildings, and every action is checked."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from craftsim.commands.filming import rendering_works
from craftsim.discrete.errors import InputError
from craftsim.discrete.tasks import TASK_NAMES, TaskName
from craftsim.report import output_directory, write_report

if TYPE_CHECKING:
    from craftsim.discrete.actions import Action
    from craftsim.models.site import Site
    from craftsim.rendering.film import Film
    from craftsim.validation.jobs.job import Job, JobResult

_FILM_SPEED: Final = 3.0


def demo(
    task: TaskName | Literal["all"] = "simple_two_story",
    out: Path = Path("out/demo"),
    video: bool = True,
    seed: int = 0,
    blueprint: Path | None = None,
    plan: Path | None = None,
    goal: Path | None = None,
) -> int:
    """Build one of the paper's tasks in physics, or all six, and check every action against the rules.

    Exit status 0 when every action did what the rules predicted and each goal is reached, 1 when not, 2 for
    wrong input.

    Args:
        task: what to build; all builds the six tasks one after the other.
        out: folder for report.json and the films.
        video: make a film of each task; without a rendering backend the demo goes on without.
        seed: decides what a blueprint leaves to chance.
        blueprint: start file of your own.
        plan: plan file of your own, one 'tick car ACTION' a line.
        goal: goal file of your own; a blueprint of your own needs none.
    """
    started = time.perf_counter()
    console = Console()
    if task == "all" and (blueprint or plan or goal):
        raise InputError("--task all builds the shipped tasks; files of your own go with a single task")
    output_directory(out)
    filming = video and rendering_works(console)

    # MuJoCo must not be imported before the rendering backend is chosen.
    from craftsim.commands import demo_text
    from craftsim.validation.jobs.figures import job_figures, job_files
    from craftsim.validation.jobs.job import read_job

    jobs = (
        [read_job(name) for name in TASK_NAMES] if task == "all" else [read_job(task, blueprint, plan, goal)]
    )
    films: list[str] = []
    results = [_perform(console, job, seed, out, films if filming else None) for job in jobs]
    config: dict[str, Any] = {
        "simulation": results[0].simulation,
        "gains": results[0].gains,
        "rules": "physical",
    }
    if task == "all":
        figures: dict[str, Any] = {
            "tasks": {result.job.name: job_figures(result) for result in results},
            "agree": sum(result.agree for result in results),
            "total": sum(len(result.run.records) for result in results),
            "good": sum(result.good for result in results),
        }
        config["tasks"] = {job.name: job_files(job) for job in jobs}
        console.print(demo_text.summary(results))
    else:
        figures = job_figures(results[0])
        config |= job_files(jobs[0])
        console.print(demo_text.actions_table(results[0].run))
        demo_text.print_worst(console, figures)
    wall = {"total_s": time.perf_counter() - started}
    report = write_report(out, figures, command="demo", seed=seed, config=config, wall=wall)
    console.print(f"Report: {report}", soft_wrap=True)
    for film in films:
        console.print(f"Film:   {film}", soft_wrap=True)
    for result in results:
        demo_text.print_differences(console, result, name_task=task == "all")
    console.print(demo_text.conclusion(results))
    return 0 if all(result.good for result in results) else 1


def _perform(console: Console, job: Job, seed: int, out: Path, films: list[str] | None) -> JobResult:
    """Run a job with progress on the screen; film it and add the film to the list, if there is one."""
    from craftsim.validation.jobs.job import run_job

    site = job.site(seed)
    path = out / f"{job.name}.mp4"
    doing: dict[int, Action] = {}
    with _progress(console, job.name) as progress, _film(path, site.model, films is not None) as film:
        bar = progress.add_task("", total=job.n_actions)

        def observe(site: Site) -> None:
            if film is not None and film.due(site.time_s):
                film.capture(site.data, _captions(job.drawing.n_cars, doing))

        def begin(tick: int, car: int, action: Action) -> None:
            doing.clear()
            doing[car] = action
            progress.update(bar, description=f"tick {tick}: car {car} {action.name}")

        result = run_job(job, site, observe, begin, lambda _: progress.advance(bar))
    if film is not None and films is not None:
        films.append(f"{path} ({film.frames} frames)")
    return result


@contextmanager
def _film(path: Path, model: object, wanted: bool) -> Iterator[Film | None]:
    if not wanted:
        yield None
        return
    from craftsim.rendering.film import Film

    with Film(path, model, "overview", speed=_FILM_SPEED) as film:
        yield film


def _progress(console: Console, title: str) -> Progress:
    return Progress(
        TextColumn(f"{title:<18}{{task.description:<30}}"),
        BarColumn(bar_width=10),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


def _captions(n_cars: int, doing: dict[int, Action]) -> list[str]:
    """Return what each car does, two cars a line: more lines would hide the building."""
    words = [
        f"car {car}: {doing[car].name.replace('_', ' ').lower() if car in doing else 'waits'}"
        for car in range(n_cars)
    ]
    return ["   ".join(words[i : i + 2]) for i in range(0, n_cars, 2)]
