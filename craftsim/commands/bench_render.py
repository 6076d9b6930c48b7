"""Measure how fast films are rendered, beside a bare loop over MuJoCo's renderer, and what recording costs."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, Final

import mujoco

from craftsim.commands.bench_cells import Cells, show

if TYPE_CHECKING:
    from rich.console import Console

    from craftsim.rendering.frames import Look
    from craftsim.rendering.trajectory import Trajectory

TASK: Final = "simple_two_story"
FRAMES: Final = 60
"""Of each film."""
REPEATS: Final = 2
RUNS: Final = 5
"""Pairs of runs with and without a recorder."""


@dataclass(frozen=True)
class FilmTiming:
    """Frames a second, by the clock, the best of some repetitions that take turns."""

    quality: str
    size: tuple[int, int]
    """Of the picture, without the captions beside it."""
    bare_fps: float
    """A loop over MuJoCo's renderer with the same stage, camera, samples and size."""
    film_fps: float
    """A film with captions, encoded."""
    one_fps: float
    """The same film from one process with one rasterizer thread."""
    two_fps: float
    """From two such processes, their start not counted."""

    @property
    def of_bare(self) -> float:
        """The film's rate over that of the bare loop."""
        return self.film_fps / self.bare_fps

    @property
    def cells(self) -> tuple[str, ...]:
        """A row of the table."""
        rates = (self.bare_fps, self.film_fps, self.of_bare, self.one_fps, self.two_fps, self.speedup)
        return (self.quality, f"{self.size[0]} x {self.size[1]}", *(f"{rate:.2f}" for rate in rates))

    @property
    def speedup(self) -> float:
        """Of two processes over one."""
        return self.two_fps / self.one_fps


def bench_render(console: Console, seed: int, out: Path | None) -> dict[str, Any]:
    """Measure, print, write a table for the documentation if there is a folder, and return all figures."""
    from craftsim.checking.setup import setup_of
    from craftsim.rendering.backend import choose_backend
    from craftsim.validation.runs.once import record_once

    backend = choose_backend()
    trajectory = record_once(TASK, setup_of("none", "physical", drive="reduced"), seed)
    films = [_time_film(trajectory, quality) for quality in ("draft", "paper")]
    head = ("quality", "pixels", "bare", "film", "of bare", "one process", "two", "times")
    table = Cells(f"Frames a second, {TASK}", head, tuple(one.cells for one in films))
    recording = {drive: _recording_cost(drive, seed) for drive in ("rollers", "reduced")}
    lines = [
        f"recording adds {100 * share:.1f} % to a run with {drive}" for drive, share in recording.items()
    ]
    show([table], lines, console, None if out is None else out / "render.md")
    return {"films": films, "recording": recording, "backend": backend, "processors": os.cpu_count()}


def _time_film(trajectory: Trajectory, quality: str) -> FilmTiming:
    from craftsim.rendering.frames import Frames, Look
    from craftsim.rendering.layout import arrange

    speed = trajectory.duration_s / (FRAMES / 30)
    look = Look(quality="paper" if quality == "paper" else "draft", speed=speed, cards=False)
    (tile,), _ = arrange(look.size, 1, look.layout, look.captions)
    n = Frames.count(trajectory, look)
    with tempfile.TemporaryDirectory() as folder:
        ways = {
            "bare": lambda: _bare(trajectory, look, tile.size),
            "film": lambda: _film(trajectory, look, Path(folder) / "film.mp4"),
            "one": lambda: _shared(trajectory, look, 1, n),
            "two": lambda: _shared(trajectory, look, 2, n),
        }
        best = _best(ways, REPEATS)
    return FilmTiming(quality, tile.size, *(n / best[way] for way in ways))


def _best(ways: dict[str, Callable[[], float]], repeats: int) -> dict[str, float]:
    """Return the shortest time of each way, which take turns."""
    seconds = [{name: way() for name, way in ways.items()} for _ in range(repeats)]
    return {name: min(one[name] for one in seconds) for name in ways}


def _bare(trajectory: Trajectory, look: Look, size: tuple[int, int]) -> float:
    from craftsim.rendering.cameras import make_view
    from craftsim.rendering.frames import pace_of
    from craftsim.rendering.playback import Playback
    from craftsim.rendering.renderer import make_renderer
    from craftsim.rendering.stage import Stage

    stage = Stage(trajectory, look.quality)
    model = stage.model
    playback, view = Playback(model, trajectory), make_view("overview", trajectory, size[0] / size[1])
    model.vis.global_.fovy = view.fovy_deg
    renderer = make_renderer(model, size)
    renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = stage.shadows
    times = pace_of(trajectory, look).times
    begun = time.perf_counter()
    for moment in times:
        data = playback.at(trajectory.at(float(moment)))
        renderer.update_scene(data, view.camera(float(moment)))
        stage.finish(renderer.scene, data.qpos)
        renderer.render()
    seconds = time.perf_counter() - begun
    renderer.close()
    return seconds


def _film(trajectory: Trajectory, look: Look, path: Path) -> float:
    """Return the time that a film takes from its first frame on: what is prepared once is no matter of rates."""
    from contextlib import closing

    from craftsim.rendering.frames import Frames
    from craftsim.rendering.render import encode

    with closing(Frames(trajectory, look)) as frames:
        begun = time.perf_counter()
        encode(path, look.fps, map(frames.__getitem__, range(len(frames))))
        return time.perf_counter() - begun


def _shared(trajectory: Trajectory, look: Look, workers: int, n: int) -> float:
    """Return the time that so many processes, of one rasterizer thread each, take once all have begun."""
    from craftsim.rendering.processes import FrameProcesses

    with FrameProcesses(trajectory, look, workers, threads=1) as processes:
        processes.wait()
        begun = time.perf_counter()
        for _ in processes.frames(range(n)):
            pass
        return time.perf_counter() - begun


def _recording_cost(drive: str, seed: int) -> float:
    """Return what share recording adds to the CPU time of a run: the median over pairs."""
    from craftsim.checking.setup import setup_of
    from craftsim.validation.runs.choice import PLANNER, items_of, policy_pilot, subjects_of
    from craftsim.validation.runs.run import Terms, do_run

    subjects = subjects_of([TASK])
    setup = setup_of("none", "physical", drive="reduced" if drive == "reduced" else "rollers")
    pilot = policy_pilot(PLANNER, subjects, "concurrent")
    seconds: dict[bool, list[float]] = {False: [], True: []}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(1 + RUNS):  # the first pair loads compiled functions
            for record, found in seconds.items():
                (item,) = items_of(subjects, [pilot], 1, Terms(seed, setup, Path(folder), record=record))
                begun = time.process_time()
                do_run(item.job)
                found.append(time.process_time() - begun)
    pairs = zip(seconds[False][1:], seconds[True][1:], strict=True)
    return median(recorded / plain for plain, recorded in pairs) - 1.0
