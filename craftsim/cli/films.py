"""Trajectories and films of replay bundles, recorded runs and plans."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import Any, Final

from craftsim.checking.judge import Judge
from craftsim.cli.progress import counting
from craftsim.cli.text import print_safe
from craftsim.discrete.files.design import Design
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Schedule
from craftsim.errors import InputError, RenderingUnavailable
from craftsim.experiments.bundle import (
    BUNDLE_FILE,
    FILM,
    RECORDING_FILE,
    TRAJECTORY_FILE,
    Recorded,
    Replay,
    read_bundle,
    replay,
)
from craftsim.experiments.experiment import TrialRecord
from craftsim.rendering.offscreen import choose_backend
from craftsim.rendering.trajectory import (
    SUFFIX,
    TRAJECTORIES,
    Recorder,
    Trajectory,
    trajectory_files,
)
from craftsim.reports.terminal import Terminal
from craftsim.storage.folders import directory_within
from craftsim.storage.paths import is_file, is_folder
from craftsim.tasks import TASK_NAMES
from craftsim.workers.pool import Pool, answered

_FILMS: Final = "films"
SIZE: Final = (640, 360)
"""Size of the films of a run in pixels."""
CLIP_S: Final = 3.0
"""Length of a film of one failure."""
_NAMED: Final = 12  # trajectories of a folder that an error names
_AFTER: Final = 0.2
"""Share of a long action's time for which what follows is recorded; a short one's is filled up to a film's length."""


def rendering_works() -> bool:
    """Return whether rendering works on this machine; print the reason if not."""
    try:
        choose_backend()
    except RenderingUnavailable as error:
        Terminal().print_safe(f"No film: {error}", style="yellow")
        return False
    return True


def record_bundle(recorded: Recorded) -> tuple[Replay, Trajectory]:
    """Re-run what a bundle shows, and a little of what follows; return how it compares, and what moved.

    Raises InputError as :func:`craftsim.experiments.bundle.replay`.
    """
    recorder = Recorder()
    bundle = recorded.bundle
    span_s = bundle.end_s - bundle.start_s

    @contextmanager
    def watch(judge: Judge) -> Iterator[None]:
        recorder.begin(judge)
        yield
        after_s = max(_AFTER * span_s, CLIP_S - span_s)
        for _ in range(math.ceil(after_s / judge.physics.config.control_period_s)):
            judge.executor.advance()

    result = replay(recorded, watch)
    return result, recorder.trajectory(bundle.key, bundle.recipe, result.attempts)


def is_recorded(word: str) -> bool:
    """Return whether a word on the command line is a recorded run: a trajectory or a folder."""
    return word not in TASK_NAMES and (Path(word).suffix == SUFFIX or is_folder(Path(word)))


def recorded_runs(path: Path) -> dict[str, Callable[[], Trajectory]]:
    """Return the recorded runs in a file or a folder, by the name of their file, or of the bundle in which it is."""
    if is_file(path / BUNDLE_FILE):
        return {path.name: lambda: record_bundle(read_bundle(path))[1]}
    files = trajectory_files(path)
    names = (
        file.parent.name if is_file(file.parent / BUNDLE_FILE) else file.stem for file in files
    )
    return {name: partial(Trajectory.read, file) for name, file in zip(names, files, strict=True)}


def recorded_run(path: Path) -> Trajectory:
    """Return the one recorded run in a file or a folder."""
    runs = recorded_runs(path)
    if len(runs) > 1:
        files = trajectory_files(path)
        unnamed = ""
        if len(files) > _NAMED:
            unnamed = f" and {len(files) - _NAMED} more"
        raise InputError(
            f"{path}: give one of its trajectories: {', '.join(map(str, files[:_NAMED]))}{unnamed}"
        )
    return next(iter(runs.values()))()


def film_failure(trajectory: Trajectory, path: Path) -> None:
    """Film the last step of a bundle; requires :func:`rendering_works`."""
    camera = f"follow:{trajectory.story.attempts[0].car}"
    _film(trajectory, path, cameras=(camera,), length_s=CLIP_S, cards=False)


def _film(trajectory: Trajectory, path: Path, **look: Any) -> None:
    from craftsim.rendering.render import (
        FilmOptions,
        render,
    )  # a fifth of a second that only films take

    render(trajectory, path, FilmOptions(SIZE, **look))


def record_failures(
    out: Path,
    records: Iterable[TrialRecord],
    workers: int = 1,
    films: bool = True,
    played: bool = False,
) -> None:
    """Write missing trajectories of the bundles and, with ``films``, their films; with ``played``, for the player."""
    file_names = [TRAJECTORY_FILE]
    items = "trajectories"
    if played:
        file_names.append(RECORDING_FILE)
    if films:
        file_names.append(FILM)
        items = "films"
    folders = [out / record["bundle"] for record in records if record["bundle"]]
    missing = [
        folder for folder in folders if not all((folder / name).exists() for name in file_names)
    ]
    _do_all(items, partial(_record_folder, films, played), missing, workers)


def _record_folder(filmed: bool, played: bool, folder: Path) -> None:
    _, trajectory = record_bundle(read_bundle(folder, of_own_run=True))
    trajectory.write(folder / TRAJECTORY_FILE)
    if played:
        from craftsim.rendering.player import write_player_file

        write_player_file(folder / RECORDING_FILE, trajectory)
    if filmed:
        film_failure(trajectory, folder / FILM)


def film_runs(out: Path, workers: int = 1) -> None:
    """Film the recorded runs without a film."""
    films = directory_within(out, _FILMS)
    paths = sorted((out / TRAJECTORIES).glob(f"[!.]*{SUFFIX}"))
    missing = [path for path in paths if not (films / f"{path.stem}.mp4").exists()]
    _do_all("films", partial(_film_run, films), missing, workers)


def _film_run(films: Path, path: Path) -> None:
    _film(Trajectory.read(path), films / f"{path.stem}.mp4")


def _do_all(
    items: str, function: Callable[[Path], None], jobs: Sequence[Path], workers: int
) -> None:
    """Call a function for each job, in this process for one worker."""
    several = workers > 1 and len(jobs) > 1
    with (
        counting(items, bool)(len(jobs)) as tell,
        Pool(workers) if several else nullcontext() as pool,
    ):
        done = (
            map(function, jobs)
            if pool is None
            else (answered(answer) for _, answer in pool.map_unordered(function, jobs))
        )
        for _ in done:
            tell(True)


def draw_plan(
    out: Path, schedule: Schedule, name: str, film: bool, design: Design | None = None
) -> None:
    """Draw the Gantt chart of a plan by the physical rules, and, with ``film``, film it on the grid."""
    from craftsim.rendering.plots.gantt import FORMATS, draw_gantt
    from craftsim.rendering.render import film_plan

    for ending in FORMATS:
        print_safe(f"Gantt chart: {draw_gantt(out / f'{name}-gantt{ending}', schedule, name)}")
    if film:
        path = out / f"{name}-plan.mp4"
        if design is not None:
            targets = design.targets
        else:
            targets = ()
        film_plan(
            path, schedule, Rules("physical"), name, targets, progress=counting("frames", bool)
        )
        print_safe(f"film: {path}")
