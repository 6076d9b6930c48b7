"""Films of replay bundles, recorded runs and plans."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

from craftsim.cli.progress import counting
from craftsim.cli.text import print_safe
from craftsim.experiments.bundle import FILM, TRAJECTORY, Recorded, Replay, read_bundle
from craftsim.experiments.experiment import TrialRecord
from craftsim.rendering.film import FilmOptions
from craftsim.rendering.offscreen import RenderingUnavailable, choose_backend
from craftsim.rendering.render import render
from craftsim.rendering.trajectory import SUFFIX, TRAJECTORIES, Trajectory
from craftsim.reports.terminal import Terminal
from craftsim.storage.folders import directory_within
from craftsim.validation.recording import CLIP_S, record_bundle
from craftsim.workers.pool import Pool, answered

if TYPE_CHECKING:
    from craftsim.discrete.files.design import Design
    from craftsim.discrete.schedule import Schedule

Job = TypeVar("Job")

FILMS: Final = "films"
SIZE: Final = (640, 360)
"""Size of the films of a run in pixels."""


def rendering_works() -> bool:
    """Return whether rendering works on this machine; print the reason if not."""
    try:
        choose_backend()
    except RenderingUnavailable as error:
        Terminal().print_safe(f"No film: {error}", style="yellow")
        return False
    return True


def film_bundle(recorded: Recorded, path: Path) -> Replay:
    """Replay a bundle, film its last step, and return the replay; requires :func:`rendering_works`."""
    result, trajectory = record_bundle(recorded)
    render(trajectory, path, _clip(trajectory))
    return result


def _clip(trajectory: Trajectory) -> FilmOptions:
    """Return the options of a film of one failure: a close-up of the car that acts first."""
    car = trajectory.story.attempts[0].car
    return FilmOptions(SIZE, cameras=(f"follow:{car}",), length_s=CLIP_S, cards=False)


def record_failures(out: Path, records: Iterable[TrialRecord], workers: int = 1, films: bool = True) -> None:
    """Write missing trajectories of the bundles and, with ``films``, their films."""
    folders = (out / record["bundle"] for record in records if record["bundle"])
    last = FILM if films else TRAJECTORY
    missing = [(folder, films) for folder in folders if not (folder / last).exists()]
    _do_all("films" if films else "trajectories", _record_folder, missing, workers)


def film_runs(out: Path, workers: int = 1) -> None:
    """Film the recorded runs without a film."""
    folder = directory_within(out, FILMS)
    paths = [
        (path, folder / f"{path.stem}.mp4") for path in sorted((out / TRAJECTORIES).glob(f"[!.]*{SUFFIX}"))
    ]
    _do_all("films", _film_trajectory, [pair for pair in paths if not pair[1].exists()], workers)


def draw_plan(out: Path, schedule: Schedule, name: str, film: bool, design: Design | None = None) -> None:
    """Draw the Gantt chart of a plan by the physical rules, and, with ``film``, film it on the grid."""
    from craftsim.discrete.rules import Rules
    from craftsim.rendering.grid_picture import wanted_of
    from craftsim.rendering.plan_film import film_plan
    from craftsim.rendering.plots.gantt import FORMATS, draw_gantt

    for ending in FORMATS:
        print_safe(f"Gantt chart: {draw_gantt(out / f'{name}-gantt{ending}', schedule, name)}")
    if film:
        path, frames = out / f"{name}-plan.mp4", counting("frames", bool)
        print_safe(
            f"film: {film_plan(path, schedule, Rules('physical'), name, wanted_of(design), progress=frames)}"
        )


def _do_all(what: str, function: Callable[[Job], None], jobs: Sequence[Job], workers: int) -> None:
    """Call a function for each job, in this process for one worker."""
    with counting(what, bool)(len(jobs)) as tell:
        for _ in _done(function, jobs, workers):
            tell(True)


def _done(function: Callable[[Job], None], jobs: Sequence[Job], workers: int) -> Iterator[None]:
    if workers == 1 or len(jobs) < 2:
        yield from map(function, jobs)
        return
    with Pool(workers) as pool:
        for _, answer in pool.map_unordered(function, jobs):
            yield answered(answer)


def _record_folder(job: tuple[Path, bool]) -> None:
    folder, filmed = job
    _, trajectory = record_bundle(read_bundle(folder, of_own_run=True))
    trajectory.write(folder / TRAJECTORY)
    if filmed:
        render(trajectory, folder / FILM, _clip(trajectory))


def _film_trajectory(pair: tuple[Path, Path]) -> None:
    render(Trajectory.read(pair[0]), pair[1], FilmOptions(SIZE))
