"""How fast films are made, by the clock, beside a bare loop over MuJoCo's renderer; and what recording a run costs."""

import time
from contextlib import closing
from functools import cache

import mujoco
import pytest

from craftsim.checking.setup import setup_of
from craftsim.learning.policies import PLANNER
from craftsim.rendering.cameras import make_view
from craftsim.rendering.encode import encode
from craftsim.rendering.film import FilmOptions, Frames, pace_of
from craftsim.rendering.layout import arrange
from craftsim.rendering.offscreen import make_renderer
from craftsim.rendering.render import frames_in_order
from craftsim.rendering.stage import Stage
from craftsim.rendering.trajectory import show_at
from craftsim.validation.rollout import run_job
from craftsim.validation.sources import policy_source, record_once, rollout_trials, rollout_worlds

TASK = "simple_two_story"
FRAMES = 60


@cache
def recorded():
    return record_once(TASK, setup_of("none", "physical", drive="wheels"), 0)


def bare(trajectory, look):
    """Render the frames with the same stage, camera, samples and size, without captions."""
    (tile,), _ = arrange(look.size, (1.0,), look.layout, look.captions)
    stage = Stage(trajectory, look.quality)
    data, view = (
        mujoco.MjData(stage.model),
        make_view("overview", trajectory, tile.size[0] / tile.size[1]),
    )
    stage.model.vis.global_.fovy = view.fovy_deg
    renderer = make_renderer(stage.model, tile.size, stage.shadows)

    def loop():
        for moment in map(float, pace_of(trajectory, look)[0]):
            show_at(stage.model, data, trajectory.qpos[trajectory.at(moment)])
            renderer.update_scene(data, view.camera(moment))
            stage.finish(renderer.scene, data.qpos)
            renderer.render()

    return loop, renderer.close


@pytest.mark.benchmark(timer=time.perf_counter)
@pytest.mark.parametrize("quality", ["draft", "paper"])
@pytest.mark.parametrize("what", ["bare", "film", "one process", "two processes"])
def test_sixty_frames(benchmark, tmp_path, what, quality):
    """``film`` has captions and is encoded; processes make its frames alone, their start included."""
    trajectory = recorded()
    look = FilmOptions(quality=quality, speed=trajectory.duration_s / (FRAMES / 30), cards=False)
    if what == "bare":
        work, close = bare(trajectory, look)
        benchmark.pedantic(work, rounds=2)
        close()
    elif what == "film":
        with closing(Frames(trajectory, look)) as frames:
            film = tmp_path / "film.mp4"
            benchmark.pedantic(
                lambda: encode(film, look.fps, map(frames.__getitem__, range(len(frames)))),
                rounds=2,
            )
    else:
        workers = 1 + what.startswith("two")
        with closing(Frames(trajectory, look)) as frames:
            benchmark.pedantic(lambda: list(frames_in_order(frames, workers)), rounds=2)


@pytest.mark.parametrize("drive", ["rollers", "wheels"])
@pytest.mark.parametrize("record", [False, True])
def test_recording_a_run(benchmark, tmp_path, drive, record):
    """CPU time of a run with and without what is recorded of it, its files included."""
    worlds = rollout_worlds([TASK])
    source = policy_source(PLANNER, worlds)
    setup = setup_of("none", "physical", drive=drive)
    (item,) = rollout_trials(worlds, [source], 1, 0, setup, out=tmp_path, record=record)
    benchmark.pedantic(run_job, args=(item.job,), rounds=5, warmup_rounds=1)
