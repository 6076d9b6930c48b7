"""Films of replay bundles and of recorded runs, where they can be made."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final, TypeVar

from rich.console import Console

from craftsim.cli.progress import counting
from craftsim.experiments.bundle import FILM, TRAJECTORY, Recorded, read_bundle
from craftsim.experiments.experiment import TrialRecord
from craftsim.experiments.replay import Replay
from craftsim.rendering.film import Look
from craftsim.rendering.offscreen import RenderingUnavailable, choose_backend
from craftsim.rendering.render import render
from craftsim.rendering.trajectory import SUFFIX, TRAJECTORIES, Trajectory
from craftsim.storage.folders import directory_within
from craftsim.validation.recording import CLIP_S, record_bundle
from craftsim.workers.pool import Pool, answered

Job = TypeVar("Job")

FILMS: Final = "films"
SIZE: Final = (640, 360)
"""Of the films of a campaign, in pixels."""


def rendering_works(console: Console) -> bool:
    """Return whether films can be made here; say why not."""
    try:
        choose_backend()
    except RenderingUnavailable as error:
        console.print(f"No film: {error}", style="yellow", soft_wrap=True, markup=False)
        return False
    return True


def film_bundle(recorded: Recorded, path: Path) -> Replay:
    """Replay a bundle, film its last step, and return the replay; :func:`rendering_works` must have said yes."""
    result, trajectory = record_bundle(recorded)
    render(trajectory, path, _clip(trajectory))
    return result


def _clip(trajectory: Trajectory) -> Look:
    """Return how a film of one failure looks: close to the car that acts first."""
    car = trajectory.story.attempts[0].car
    return Look(SIZE, cameras=(f"follow:{car}",), length_s=CLIP_S, cards=False)


def record_failures(
    console: Console, out: Path, records: Iterable[TrialRecord], workers: int = 1, films: bool = True
) -> None:
    """Write the trajectories of the bundles that have none yet, and films of them unless none are wanted."""
    folders = (out / record["bundle"] for record in records if record["bundle"])
    last = FILM if films else TRAJECTORY
    missing = [(folder, films) for folder in folders if not (folder / last).exists()]
    with counting(console, "films" if films else "trajectories", len(missing), bool) as tell:
        for _ in _done(_record_folder, missing, workers):
            tell(True)


def film_runs(console: Console, out: Path, workers: int = 1) -> None:
    """Film the recorded runs that have no film yet, from their start to their end."""
    folder = directory_within(out, FILMS)
    paths = [
        (path, folder / f"{path.stem}.mp4") for path in sorted((out / TRAJECTORIES).glob(f"[!.]*{SUFFIX}"))
    ]
    missing = [pair for pair in paths if not pair[1].exists()]
    with counting(console, "films", len(missing), bool) as tell:
        for _ in _done(_film_trajectory, missing, workers):
            tell(True)


def _done(function: Callable[[Job], None], jobs: Sequence[Job], workers: int) -> Iterator[None]:
    """Call a function for each job, in this process where one is enough; yield as each is done, in no order."""
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
    render(Trajectory.read(pair[0]), pair[1], Look(SIZE))
