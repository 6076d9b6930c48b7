"""Films show all of a trajectory or a plan, say what happened, and do not depend on who renders them."""

from bisect import bisect_right
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image
from rendering.recorded import record

from craftsim import Trajectory
from craftsim.checking.attempt import SAME_TIME_S
from craftsim.checking.recipe import Recipe, Step, perform_step, start
from craftsim.cli import main
from craftsim.discrete.drawing import car_colour
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import make_schedule
from craftsim.errors import InputError
from craftsim.planning.plan_file import read_plan
from craftsim.rendering.cameras import make_view
from craftsim.rendering.encode import VideoWriter
from craftsim.rendering.film import (
    IDLE,
    VERB_SPEEDS,
    FilmOptions,
    Frames,
    pace_of,
    predicted_worlds,
)
from craftsim.rendering.layout import arrange, covered_by
from craftsim.rendering.overlay import PAPER, Caption, CarCaption, _unit, caption_of, draw_panel
from craftsim.rendering.render import (
    LONGEST_S,
    PLAN_FPS,
    plan_frames,
    plan_moments,
    plan_worlds,
    render,
)
from craftsim.rendering.trajectory import Recorder
from craftsim.tasks import make_task

SMALL = FilmOptions((192, 128), 5)
QUICK = replace(SMALL, cameras=("grid",))
RULES = Rules("physical")


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    """Of a car that drives under a block, lifts it, and then rests for a while."""
    grid = Grid.empty((3, 2, 1), n_cars=1)
    grid.kind[1, 0, 1] = Kind.BLOCK
    return record(grid, Action.MOVE_RIGHT, Action.LIFT, title="lifting", rest=100)


# When frames are, and what is said.


def test_a_film_begins_with_the_first_sample_and_ends_with_the_last(trajectory):
    for look in [FilmOptions(fps=fps, speed=speed) for fps in (1, 30) for speed in (2.0, None)]:
        times, _ = pace_of(trajectory, look)
        assert (times[0], times[-1]) == pytest.approx((trajectory.time[0], trajectory.time[-1]))
        assert (np.diff(times) >= 0).all()
    times, _ = pace_of(trajectory, FilmOptions(length_s=2.0))
    assert (len(times), times[-1] < trajectory.time[-1] + 1e-9) == (60, True)
    assert pace_of(trajectory, FilmOptions(length_s=100.0))[1][0] == 1.0, "never slower than life"


def test_an_adapted_film_is_slow_where_something_is_lifted_and_fast_where_nobody_acts(trajectory):
    times, factors = pace_of(trajectory, FilmOptions())
    _, lift = trajectory.story.attempts
    ends_s = lift.start_s + lift.duration_s
    lifting = (times > lift.start_s + 0.5) & (times < ends_s - 0.5)
    assert factors[lifting] == pytest.approx(VERB_SPEEDS["LIFT"])
    assert factors[times > ends_s + 0.5] == pytest.approx(IDLE)
    film_s = 2 * np.diff(times) / (factors[:-1] + factors[1:])
    assert film_s[:-1].mean() == pytest.approx(1 / 30, rel=0.02), (
        "the factor is the one that is shown"
    )
    close = replace(trajectory, time=1e-300 * np.arange(len(trajectory)))
    assert len(pace_of(close, FilmOptions())[0]) == 1, "smoothing does not take all of the memory"
    attempts = tuple(replace(attempt, result="unsafe") for attempt in trajectory.story.attempts)
    failed = replace(trajectory, story=replace(trajectory.story, attempts=attempts))
    moments, slow = pace_of(failed, FilmOptions())
    ends = [attempt.start_s + attempt.duration_s for attempt in attempts]
    assert np.interp(ends, moments, slow).max() < 1.0 < factors.min(), (
        "the end of a failed one in slow motion"
    )


def test_captions_say_what_a_car_does_and_then_what_came_of_it(trajectory):
    move, lift = trajectory.story.attempts
    during = caption_of(trajectory, move.start_s + 0.1, 4.0)
    assert (during.step, during.n_steps, during.cars[0][:3]) == (1, 2, (0, "move right", ""))
    after = caption_of(trajectory, lift.start_s + 0.1, 2.0).cars[0]
    assert after[1:] == ("lift", "move right: as predicted", True)
    assert caption_of(trajectory, float(trajectory.time[-1]), 12.0).cars[0].action == "waits"


def test_what_begins_or_ends_at_a_moment_has_begun_or_ended_whatever_the_last_digits(trajectory):
    move, lift = trajectory.story.attempts
    expected = (caption_of(trajectory, lift.start_s, 1.0), trajectory.at(lift.start_s))
    assert expected[0].step == 2
    for off_s in (-1e-7, -1e-12, 1e-12, 1e-7):
        caption = caption_of(trajectory, lift.start_s + off_s, 1.0)
        assert (
            caption._replace(time_s=lift.start_s),
            trajectory.at(lift.start_s + off_s),
        ) == expected
        assert move.has_ended(move.start_s + move.duration_s + off_s)
        assert move.has_begun(move.start_s + off_s)
    assert not lift.has_begun(lift.start_s - 1e-3)
    assert not lift.has_ended(lift.start_s + lift.duration_s - 1e-3)


def test_the_prediction_follows_each_car_where_cars_act_at_once():
    grid = Grid.empty((3, 2, 1), n_cars=2)
    grid.cars[1, :2] = 0, 1
    step, recorder = Step.of_ticks(0, [(0, Action.ROTATE_LEFT), (1, Action.MOVE_RIGHT)]), Recorder()
    recipe = Recipe(blueprint_text(grid), (step,))
    judge = start(recipe)
    recorder.begin(judge)
    attempts = perform_step(judge, step)
    times, grids = predicted_worlds(recorder.trajectory("at once", recipe, attempts))
    ends = [attempt.start_s + attempt.duration_s for attempt in attempts]
    assert ends[0] != ends[1]
    for time_s, car in ((ends[0], 0), (ends[1], 1)):
        number = bisect_right(times, time_s)
        before, after = grids[number - 2], grids[number - 1]
        assert np.flatnonzero((before.cars != after.cars).any(axis=1)).tolist() == [car]


# Where on a frame things are.


def test_captions_of_two_cars_stand_beside_each_other_where_one_below_the_other_would_be_cut():
    cars = (CarCaption(0, "waits", "unfold: done"), CarCaption(1, "move left", "drop: done"))
    panel = draw_panel(Caption("in ticks", 9, 24, cars, (), 16.7, 1.5), (479, 150), 480)
    assert (panel[-8:] == PAPER).all()
    assert (panel[90:, 240:] != PAPER).any()


@pytest.mark.parametrize("size", [(1280, 720), (720, 1280), (640, 480)])
@pytest.mark.parametrize("n", [1, 2, 5])
@pytest.mark.parametrize("layout", ["side", "main"])
def test_views_and_captions_are_in_the_frame_and_do_not_overlap(layout, n, size):
    boxes, panel = arrange(size, (1.3, 2.0, 0.4, 1.3, 9.0)[:n], layout, captions=True)
    covered = np.zeros(size[::-1], int)
    for box in (*boxes, panel):
        covered[box.place] += 1
        assert covered[box.place].size == box.width * box.height
    assert (covered.max(), len(boxes)) == (1, n)
    # They fill a frame as far as their shapes allow.
    (one, other), _ = arrange((1280, 720), (1.3, 2.0), layout, captions=False)
    shown = [
        min(b.width, b.height * a) * min(b.height, b.width / a)
        for b, a in ((one, 1.3), (other, 2.0))
    ]
    assert sum(shown) > 0.5 * 1280 * 720


def test_captions_fill_what_a_narrow_view_leaves_and_are_large_enough_to_read():
    (wide,), beside_wide = arrange((1280, 720), (1.6,), "side", captions=True)
    (narrow,), beside_narrow = arrange((1280, 720), (1.0,), "side", captions=True)
    assert wide.width == 1280 - beside_wide.width
    assert narrow.width == round(1.15 * 720)
    assert beside_narrow.width > beside_wide.width
    # At a width of 480 pixels letters are then 10 pixels high.
    assert _unit(beside_wide.size, 720, 2) * 480 / 1280 >= 9.5
    assert _unit((300, 300), 300, 40) == 9


def test_a_car_below_a_block_has_an_outline(trajectory, rendering):
    look = FilmOptions((192, 128), 5, cameras=("top",), captions=False)
    frames = Frames(trajectory, look)
    beside, below = frames.at(0.0), frames.at(float(trajectory.time[-1]))
    frames.close()
    red = np.array([255 * channel for channel in car_colour(0)])
    near = [(np.abs(picture - red).max(axis=2) < 40).sum() for picture in (beside, below)]
    assert near[1] > 20


def test_insets_hide_nothing_and_go_into_a_column_where_they_would(trajectory):
    size, view = (1280, 720), make_view("overview", trajectory, 16 / 9)
    (first, inset), _ = arrange(
        size, (1, 1), "inset", False, lambda size: covered_by(trajectory, view, size)
    )
    assert (first.size, first.size > inset.size) == (size, True)
    assert not covered_by(trajectory, view, size)[inset.place].any()
    (first, inset), _ = arrange(
        size, (1, 1), "inset", False, lambda size: np.ones(size[::-1], bool)
    )
    assert inset.left >= first.left + first.width > size[0] / 2


def test_trajectories_side_by_side_show_the_same_time_and_the_shorter_one_its_end(
    trajectory, rendering
):
    cut = trajectory.at(0.5 * float(trajectory.time[-1]))
    names = ("time", "qpos", "ctrl", "force", "measured", "path", "contact")
    short = replace(
        trajectory.titled("short"), **{name: getattr(trajectory, name)[:cut] for name in names}
    )
    look = FilmOptions((192, 96), 5, captions=False, speed=1.0)
    both, alone = (
        Frames([short, trajectory], look),
        Frames(trajectory, replace(look, size=(94, 96))),
    )
    moments_s = trajectory.time[[cut - 1, -1]].tolist()
    early, late = map(both.at, moments_s)
    assert len(both) == len(alone)
    assert np.array_equal(late[:, -94:], alone.at(moments_s[1]))
    assert np.array_equal(late[:, :94], early[:, :94])
    assert not np.array_equal(late[:, -94:], early[:, -94:])
    for frames in (both, alone):
        frames.close()
    said = caption_of(short, float(trajectory.time[-1]), 1.0)
    assert (said.title, said.time_s, said.cars[0].action) == (
        "short",
        float(short.time[-1]),
        "has finished",
    )


# Files.


@pytest.mark.usefixtures("rendering")
def test_a_film_has_the_frames_that_were_promised_and_two_processes_render_the_same_bytes(
    trajectory, tmp_path
):
    (film,) = render(trajectory, tmp_path / "film.mp4", SMALL)
    with av.open(str(film)) as container:
        decoded = list(container.decode(video=0))
    assert len(decoded) == len(Frames(trajectory, SMALL))
    assert (decoded[0].width, decoded[0].height, decoded[0].format.name) == (192, 128, "yuv420p")
    (again,) = render(trajectory, tmp_path / "again.mp4", SMALL, workers=2)
    assert again.read_bytes() == film.read_bytes()


@pytest.mark.parametrize("name", ["film.webm", "film.webp", "film.gif"])
def test_other_formats_last_as_long(trajectory, name, tmp_path, rendering):
    look = replace(QUICK, fps=7)
    (path,) = render(trajectory, tmp_path / name, look)
    if name == "film.webm":
        with av.open(str(path)) as container:
            assert sum(1 for _ in container.decode(video=0)) == len(Frames(trajectory, look))
        return
    shown_ms = 0.0
    with Image.open(path) as picture:
        for number in range(picture.n_frames):
            picture.seek(number)
            picture.load()
            shown_ms += picture.info["duration"]
        assert picture.size == look.size
    assert shown_ms == pytest.approx(1000 * len(Frames(trajectory, look)) / look.fps, abs=10)


def test_pictures_of_moments_and_a_contact_sheet(trajectory, tmp_path, rendering):
    stills = render(trajectory, tmp_path / "still.png", QUICK, at=(0.5, 1.23456, 1.234561))
    (panel,) = render(trajectory, tmp_path / "panel.png", replace(QUICK, captions=True), at=(0.5,))
    assert panel.read_bytes() != stills[0].read_bytes()
    assert (len({path.name for path in stills}), stills[0].name) == (3, "still-0.5.png")
    assert render(trajectory, tmp_path / "sheet.png", QUICK)[0].stat().st_size > 1000
    # Samples are sums of time steps: the end that a message names is allowed, and so are 2 digits of it.
    last = float(trajectory.time[-1])
    for moment in (round(last, 6), last + 1e-9):
        (end,) = render(trajectory, tmp_path / "end.png", QUICK, at=(moment,))
        assert (
            end.read_bytes()
            == render(trajectory, tmp_path / "last.png", QUICK, at=(last,))[0].read_bytes()
        )
    with pytest.raises(InputError, match=rf"no moment 99 s; allowed: 0.3 to {round(last, 6):g} s"):
        render(trajectory, tmp_path / "late.png", QUICK, at=(1.0, 99.0))
    assert not list(tmp_path.glob("late*"))


def test_a_film_that_breaks_off_leaves_nothing(trajectory, tmp_path, rendering):
    def stop(done: bool) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        render(trajectory, tmp_path / "film.mp4", QUICK, progress=lambda n: nullcontext(stop))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "changes", "words"),
    [
        ("film.avi", {}, "no format ends in '.avi'"),
        ("film.mp4", {"cameras": ("iso",)}, "unknown camera 'iso'"),
        ("film.mp4", {"size": (128, 96), "cameras": ("grid",) * 9}, "do not fit"),
        ("film.mp4", {"size": (641, 480)}, "641 x 480 pixels; allowed: even"),
        ("film.mp4", {"size": (8192, 8192)}, "pixels at most"),
        ("film.mp4", {"fps": 0}, "fps is 0"),
        ("film.mp4", {"speed": 0.0}, "speed is 0.0"),
        ("film.mp4", {"cameras": ()}, "no camera"),
        ("long.webp", {"size": (3840, 2160)}, "million pixels in all"),
        ("quick.gif", {"fps": 60}, "a GIF has 50"),
    ],
)
def test_what_no_film_is_is_refused_before_it_is_rendered(
    trajectory, tmp_path, name, changes, words
):
    with pytest.raises(InputError, match=words):
        render(trajectory, tmp_path / name, replace(SMALL, **{"fps": 30} | changes))
    assert not list(tmp_path.iterdir())


def test_what_several_runs_cannot_have_is_refused(capsys):
    for words, said in (
        (("--title", "one"), "--title names 1 of 2 runs; give a title for each, or none"),
        (("--out", "figures/"), "figures are of one run"),
    ):
        assert main(["render", "a.npz", "--beside", "b.npz", *words]) == 2
        assert said in " ".join(capsys.readouterr().err.split())


# The writer of films.


def _frames(count: int, height: int = 48, width: int = 64) -> list[np.ndarray]:
    ramp = np.linspace(0, 255, width, dtype=np.uint8)
    frames = np.zeros((count, height, width, 3), np.uint8)
    for number, frame in enumerate(frames):
        frame[..., 0], frame[..., 2] = np.roll(ramp, 3 * number), 255 - ramp
    return list(frames)


def _write(path: Path, frames: list[np.ndarray]) -> bytes:
    with VideoWriter(path, 25) as writer:
        for frame in frames:
            writer.write(frame)
    return path.read_bytes()


def test_a_film_is_h264_yuv420p_with_its_index_first_all_frames_and_always_the_same_bytes(tmp_path):
    frames = _frames(10)
    content = _write(tmp_path / "film.mp4", frames)
    assert content.index(b"moov") < content.index(b"mdat")
    assert content == _write(tmp_path / "again.mp4", frames)
    with av.open(str(tmp_path / "film.mp4")) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt, stream.average_rate) == (
            "h264",
            "yuv420p",
            25,
        )
        assert float(stream.duration * stream.time_base) == pytest.approx(10 / 25)
        decoded = [picture.to_ndarray(format="rgb24") for picture in container.decode(stream)]
    for written, read in zip(frames, decoded, strict=True):
        assert (
            np.abs(written.astype(int) - read).mean() < 12
        )  # lossy, and colour at half resolution


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([], "at least one frame"),
        ([np.zeros((48, 63, 3), np.uint8)], "even sizes"),
        ([np.zeros((48, 64), np.uint8)], "height, width, 3"),
        ([np.zeros((48, 64, 3))], "uint8"),
        ([*_frames(1), *_frames(1, 32, 32)], "this film is 64 x 48"),
    ],
)
def test_frames_that_cannot_be_encoded_are_refused_and_the_previous_film_stays(
    tmp_path, frames, message
):
    before = _write(tmp_path / "film.mp4", _frames(3))
    with pytest.raises(ValueError, match=message):
        _write(tmp_path / "film.mp4", frames)
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [before]


# Plans.


def test_the_film_of_a_plan_shows_the_world_as_the_rules_predict_it_and_ends_with_the_last_one():
    grid = make_task("complex_two_story").draw(np.random.default_rng(0))
    ticks = read_plan(shipped_plan("complex_two_story"), grid.n_cars).ticks
    schedule = make_schedule(grid, ticks, RULES)
    moments, _ = plan_moments(schedule)
    seen = list(plan_worlds(schedule, RULES, moments))
    assert len(seen) == len(moments)
    assert seen[0][0].same_visible(schedule.steps[0].before)
    assert seen[-1][0].same_visible(schedule.final)
    assert seen[-1][1] == {}
    times = schedule.times()
    for moment, (_, running) in zip(moments[::10], seen[::10], strict=True):
        now_s = moment + SAME_TIME_S
        expected = {
            s.car: i for i, s in enumerate(schedule.steps) if times[i, 0] <= now_s < times[i, 1]
        }
        assert running == expected


def test_a_long_plan_makes_no_long_film_and_in_a_short_one_a_car_glides_between_its_cells():
    turns = make_schedule(Grid.empty((1, 1, 1), n_cars=1), [[(0, Action.ROTATE_LEFT)]] * 600, RULES)
    assert len(plan_moments(turns)[0]) / PLAN_FPS < LONGEST_S + 3
    move = make_schedule(Grid.empty((3, 1, 1), n_cars=1), [[(0, Action.MOVE_RIGHT)]], RULES)
    frames = [frame for frame, _ in zip(plan_frames(move, RULES, "a move"), range(6), strict=False)]
    red = [
        np.argwhere((frame[100:, :900] == (204, 61, 56)).all(axis=2))[:, 1].mean()
        for frame in frames
    ]
    assert (np.diff(red) >= 0).all()
    assert len({round(x) for x in red}) > 3


def test_show_says_what_a_plan_takes_writes_its_pictures_and_names_what_is_forbidden(
    tmp_path, capsys
):
    (tmp_path / "p.plan").write_text("0 0 MOVE_RIGHT\n0 1 ROTATE_LEFT after 0:0\n")
    assert (
        main(["show", "strip", "--plan", str(tmp_path / "p.plan"), "--out", str(tmp_path / "out")])
        == 0
    )
    assert "plan p: 2 actions in 1 ticks, makespan 1.7 s" in capsys.readouterr().out
    assert (tmp_path / "out" / "p-gantt.png").read_bytes()[:4] == b"\x89PNG"
    with av.open(tmp_path / "out" / "p-plan.mp4") as film:
        assert sum(1 for _ in film.decode(video=0)) == 9 + 1 + round(1.5 * PLAN_FPS)
    (tmp_path / "p.plan").write_text("0 0 DROP\n1 1 ROTATE_LEFT\n")
    assert main(["show", "strip", "--plan", str(tmp_path / "p.plan")]) == 1
    assert "forbidden: car 0 DROP in tick 0: the car carries nothing" in capsys.readouterr().out
