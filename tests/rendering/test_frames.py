"""Films show all of a trajectory, say what happened beside the picture, and do not depend on who renders them."""

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from recorded import record

from craftsim import Trajectory
from craftsim.checking.episode import Recipe, Step, do, start
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.errors import InputError
from craftsim.models.framing import box_corners
from craftsim.rendering.cameras import make_view, reached_m
from craftsim.rendering.film import IDLE, SPEEDS, Frames, Look, pace_of, predicted_worlds
from craftsim.rendering.layout import arrange
from craftsim.rendering.overlay import PAPER, caption_of
from craftsim.rendering.render import render
from craftsim.rendering.trajectory import Recorder

SMALL = Look((192, 128), 5, captions=True)


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    """Of a car that drives under a block, lifts it, and then rests for a while."""
    grid = Grid.empty((3, 2, 1), n_cars=1)
    grid.kind[1, 0, 1] = Kind.BLOCK
    return record(grid, Action.MOVE_RIGHT, Action.LIFT, title="lifting", rest=100)


def test_a_film_begins_with_the_first_sample_and_ends_with_the_last(trajectory: Trajectory) -> None:
    for fps in (1, 5, 30):
        for pace in (pace_of(trajectory, Look(fps=fps, speed=2.0)), pace_of(trajectory, Look(fps=fps))):
            assert pace.times[0] == trajectory.time[0]
            assert pace.times[-1] == pytest.approx(trajectory.time[-1])
            assert (np.diff(pace.times) >= 0).all()


def test_an_adapted_film_is_slow_where_something_is_lifted_and_fast_where_nobody_acts(
    trajectory: Trajectory,
) -> None:
    pace = pace_of(trajectory, Look())
    _, lift = trajectory.story.attempts
    lifting = (pace.times > lift.start_s + 0.5) & (pace.times < lift.start_s + lift.duration_s - 0.5)
    resting = pace.times > lift.start_s + lift.duration_s + 0.5
    assert pace.factors[lifting] == pytest.approx(SPEEDS["LIFT"])
    assert pace.factors[resting] == pytest.approx(IDLE)
    film_s = 2 * np.diff(pace.times) / (pace.factors[:-1] + pace.factors[1:])
    assert film_s[:-1].mean() == pytest.approx(1 / 30, rel=0.02), "the factor is the one that is shown"


def test_samples_that_are_close_to_each_other_are_not_smoothed_over_all_of_the_memory(
    trajectory: Trajectory,
) -> None:
    for period_s in (1e-9, 1e-300):
        close = replace(trajectory, time=period_s * np.arange(len(trajectory)))
        assert len(pace_of(close, Look()).times) == 1


def test_a_fitted_film_has_its_length_and_is_never_slower_than_life(trajectory: Trajectory) -> None:
    assert len(pace_of(trajectory, Look(length_s=2.0)).times) == 60
    assert pace_of(trajectory, Look(length_s=2.0)).times[-1] < trajectory.time[-1] + 1e-9
    assert pace_of(trajectory, Look(length_s=100.0)).factors[0] == 1.0


def test_captions_say_what_a_car_does_and_then_what_came_of_it(trajectory: Trajectory) -> None:
    move, lift = trajectory.story.attempts
    during = caption_of(trajectory, None, move.start_s + 0.1, 4.0)
    assert (during.step, during.n_steps, during.cars[0].action) == (1, 2, "move right")
    assert during.cars[0].verdict == ""
    after = caption_of(trajectory, None, lift.start_s + 0.1, 2.0).cars[0]
    assert (after.action, after.verdict, after.agrees) == ("lift", "move right: as predicted", True)
    assert caption_of(trajectory, None, float(trajectory.time[-1]), 12.0).cars[0].action == "waits"


def test_the_prediction_follows_each_car_where_cars_act_at_once() -> None:
    grid = Grid.empty((3, 2, 1), n_cars=2)
    grid.cars[1, :2] = 0, 1
    joint = [(0, Action.ROTATE_LEFT), (1, Action.MOVE_RIGHT)]
    step, recorder = Step.joint(0, joint), Recorder()
    recipe = Recipe(blueprint_text(grid), (step,))
    judge = start(recipe)
    recorder.begin(judge)
    attempts = do(judge, step)
    times, grids = predicted_worlds(recorder.trajectory("at once", recipe, attempts))
    ends = [attempt.start_s + attempt.duration_s for attempt in attempts]
    assert ends[0] != ends[1]
    for time_s, one in ((ends[0], 0), (ends[1], 1)):
        number = bisect_right(times, time_s)
        before, after = grids[number - 2], grids[number - 1]
        changed = np.flatnonzero((before.cars != after.cars).any(axis=1))
        assert changed.tolist() == [one]


def test_views_and_captions_do_not_overlap() -> None:
    for layout in ("side", "main"):
        for n in (1, 2, 3, 5):
            for size in ((1280, 720), (720, 1280), (640, 480), (3840, 2160)):
                boxes, panel = arrange(size, n, layout, captions=True)
                covered = np.zeros(size[::-1], int)
                for box in (*boxes, panel):
                    covered[box.rows, box.columns] += 1
                    assert covered[box.rows, box.columns].size == box.width * box.height, (
                        "inside of the frame"
                    )
                assert covered.max() == 1
                assert len(boxes) == n


@pytest.mark.parametrize("size", [(1280, 720), (640, 640)])
def test_insets_hide_none_of_the_area_and_go_into_a_column_where_they_would(
    trajectory: Trajectory, size: tuple[int, int]
) -> None:
    corners = box_corners(trajectory.story.recipe.grid.size, reached_m(trajectory))
    for camera in ("overview", "top"):
        frames = Frames(trajectory, Look(size, cameras=(camera, "grid"), layout="inset"))
        (first, _), (inset, _) = frames._views
        frames.close()
        beside = inset.left >= first.left + first.width
        aspect = first.width / first.height
        seen = make_view(camera, trajectory, aspect).aim(0.0).project(corners, aspect)
        x, y = (first.width * (1 + seen[:, 0]) / 2, first.height * (1 - seen[:, 1]) / 2)
        inside = (
            (x > inset.left)
            & (x < inset.left + inset.width)
            & (y > inset.top)
            & (y < inset.top + inset.height)
        )
        assert beside or not inside.any()
    assert not arrange(size, 2, "inset", False, lambda first: lambda tile: 1)[0][1].left < size[0] / 2


def test_the_captions_leave_the_picture_alone(trajectory: Trajectory, rendering: None) -> None:
    frames = Frames(trajectory, SMALL)
    (box,), panel = arrange(SMALL.size, 1, "side", captions=True)
    picture, words = frames.at(1.0), frames.at(1.0, 3.0)
    frames.close()
    assert np.array_equal(picture[box.rows, box.columns], words[box.rows, box.columns])
    assert (picture[panel.rows, panel.columns] != PAPER).any()


@pytest.fixture(scope="module")
def film(trajectory: Trajectory, tmp_path_factory: pytest.TempPathFactory, rendering: None) -> Path:
    return render(trajectory, tmp_path_factory.mktemp("film") / "film.mp4", SMALL)[0]


def _decoded(path: Path) -> Iterator[av.VideoFrame]:
    with av.open(str(path)) as container:
        yield from container.decode(video=0)


def test_a_film_has_the_frames_that_were_promised(trajectory: Trajectory, film: Path) -> None:
    decoded = list(_decoded(film))
    assert len(decoded) == Frames.count(trajectory, SMALL)
    assert (decoded[0].width, decoded[0].height, decoded[0].format.name) == (192, 128, "yuv420p")


def test_two_processes_render_the_same_bytes(trajectory: Trajectory, film: Path, tmp_path: Path) -> None:
    again = render(trajectory, tmp_path / "film.mp4", SMALL, workers=2)[0]
    assert again.read_bytes() == film.read_bytes()


def test_several_processes_say_of_a_wrong_camera_what_one_says(
    trajectory: Trajectory, tmp_path: Path
) -> None:
    for workers in (1, 2):
        with pytest.raises(InputError, match="unknown camera 'iso'"):
            render(trajectory, tmp_path / "film.mp4", replace(SMALL, cameras=("iso",)), workers=workers)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["film.webm", "film.webp", "film.gif"])
def test_other_formats_hold_as_many_frames(
    trajectory: Trajectory, name: str, tmp_path: Path, rendering: None
) -> None:
    look = replace(SMALL, fps=7, cameras=("grid",))
    path = render(trajectory, tmp_path / name, look)[0]
    if name == "film.webm":
        assert len(list(_decoded(path))) == Frames.count(trajectory, look)
    else:
        from PIL import Image

        with Image.open(path) as picture:
            # Equal frames in a row may be one that stays longer.
            assert 2 <= picture.n_frames <= Frames.count(trajectory, look)
            assert picture.size == SMALL.size
            shown_ms = 0.0
            for number in range(picture.n_frames):
                picture.seek(number)
                picture.load()
                shown_ms += picture.info["duration"]
        assert shown_ms == pytest.approx(1000 * Frames.count(trajectory, look) / look.fps, abs=10)


def test_pictures_of_moments_and_a_contact_sheet(
    trajectory: Trajectory, tmp_path: Path, rendering: None
) -> None:
    look = replace(SMALL, cameras=("grid",))
    stills = render(trajectory, tmp_path / "still.png", look, at=(0.5, 1.5))
    assert [path.name for path in stills] == ["still-0.5.png", "still-1.5.png"]
    assert render(trajectory, tmp_path / "sheet.png", look)[0].stat().st_size > 1000
    close = render(trajectory, tmp_path / "close.png", look, at=(1.23456, 1.234561))
    assert len({path.name for path in close if path.is_file()}) == 2
    with pytest.raises(InputError, match="no moment 99 s"):
        render(trajectory, tmp_path / "late.png", look, at=(1.0, 99.0))
    assert not list(tmp_path.glob("late*"))


def test_an_animation_that_cannot_be_is_refused_before_it_is_rendered(
    trajectory: Trajectory, tmp_path: Path
) -> None:
    for name, changes, words in (
        ("long.webp", {"size": (3840, 2160)}, "million pixels in all"),
        ("quick.gif", {"fps": 60}, "a GIF has 50"),
    ):
        with pytest.raises(InputError, match=words):
            render(trajectory, tmp_path / name, replace(SMALL, **{"fps": 30, **changes}))


def test_a_film_that_breaks_off_leaves_nothing(
    trajectory: Trajectory, tmp_path: Path, rendering: None
) -> None:
    class Stop(Exception):
        pass

    def stop(done: bool) -> None:
        raise Stop

    from contextlib import nullcontext

    with pytest.raises(Stop):
        render(
            trajectory,
            tmp_path / "film.mp4",
            replace(SMALL, cameras=("grid",)),
            progress=lambda n: nullcontext(stop),
        )
    assert list(tmp_path.iterdir()) == []


def test_a_look_that_no_film_has_is_refused() -> None:
    for changes, words in (
        ({"size": (641, 480)}, "641 x 480 pixels; allowed: even"),
        ({"size": (8192, 8192)}, "pixels at most"),
        ({"fps": 0}, "fps is 0"),
        ({"speed": 0.0}, "speed is 0.0"),
        ({"cameras": ()}, "no camera"),
    ):
        with pytest.raises(InputError, match=words):
            Look(**changes)


def test_views_that_do_not_fit_are_refused(trajectory: Trajectory) -> None:
    with pytest.raises(InputError, match="do not fit"):
        Frames(trajectory, Look((128, 96), cameras=("grid",) * 9))


def test_an_unknown_format_is_refused(trajectory: Trajectory) -> None:
    for name, words in (("film.avi", "no format ends in '.avi'"), ("film", "no format")):
        with pytest.raises(InputError, match=words):
            render(trajectory, name)
