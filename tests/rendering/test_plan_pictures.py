"""Plans as Gantt charts and as films on the grid: what they show, and that the same plan gives the same bytes."""

import re

import av
import numpy as np
import pytest

from craftsim.cli import main
from craftsim.discrete.files.plan import read_plan
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import make_schedule
from craftsim.discrete.tasks import make_task
from craftsim.errors import InputError
from craftsim.rendering.plan_film import FPS, LONGEST_S, PlanFilm
from craftsim.rendering.plots.gantt import VERB_COLOURS, draw_gantt

RULES = Rules("physical")


def _shipped(name):
    grid = make_task(name).draw(np.random.default_rng(0))
    return make_schedule(grid, read_plan(shipped_plan(name), grid.n_cars).ticks, RULES)


def _css(rgb):
    return "#" + "".join(f"{round(255 * part):02x}" for part in rgb)


def test_a_gantt_chart_has_a_row_for_each_car_the_makespan_and_the_colours_of_its_verbs(tmp_path):
    schedule = _shipped("complex_two_story")
    text = draw_gantt(tmp_path / "a.svg", schedule, "mine").read_text()
    words = re.findall(r"<!-- (.*?) -->", text)
    took = schedule.makespan()
    assert f"mine: {len(schedule.steps)} actions, makespan {took:.1f} s" in words
    assert [word for word in words if word.startswith("car ")] == [f"car {car}" for car in range(4)]
    assert "loaded" in words
    there = {verb for verb, colour in VERB_COLOURS.items() if _css(colour) in text}
    assert there == {"move", "rotate", "lift", "drop", "unfold"}
    again = draw_gantt(tmp_path / "b.svg", schedule, "mine").read_text()
    assert again == text


def test_the_film_of_a_plan_shows_the_world_as_the_rules_predict_it_and_ends_with_the_last_one():
    schedule = _shipped("complex_two_story")
    film = PlanFilm(schedule, RULES, "mine")
    seen = list(film.worlds())
    assert len(seen) == len(film)
    assert seen[0][1].same_visible(schedule.steps[0].before)
    assert seen[-1][1].same_visible(schedule.final)
    assert seen[-1][2] == {}
    times = schedule.times()
    for moment, _, running in seen[::10]:
        expected = {s.car: i for i, s in enumerate(schedule.steps) if times[i, 0] <= moment < times[i, 1]}
        assert running == expected


def test_a_long_plan_makes_no_long_film():
    turns = [[(0, Action.ROTATE_LEFT)] for _ in range(600)]
    film = PlanFilm(make_schedule(Grid.empty((1, 1, 1), n_cars=1), turns, RULES), RULES, "turns")
    assert len(film) / FPS < LONGEST_S + 3


def test_a_car_glides_between_its_cells():
    schedule = make_schedule(Grid.empty((3, 1, 1), n_cars=1), [[(0, Action.MOVE_RIGHT)]], RULES)
    frames = list(PlanFilm(schedule, RULES, "a move").frames())
    assert all(frame.shape == (720, 1280, 3) for frame in frames)
    red = [np.argwhere((frame[100:, :900] == (204, 61, 56)).all(axis=2))[:, 1].mean() for frame in frames[:6]]
    assert (np.diff(red) >= 0).all()
    assert len({round(x) for x in red}) > 3


def test_show_says_what_a_plan_takes_and_writes_its_pictures(tmp_path, capsys):
    (tmp_path / "p.plan").write_text("0 0 MOVE_RIGHT\n0 1 ROTATE_LEFT after 0:0\n")
    assert main(["show", "strip", "--plan", str(tmp_path / "p.plan"), "--out", str(tmp_path / "out")]) == 0
    assert "plan p: 2 actions in 1 ticks, makespan 1.9 s" in capsys.readouterr().out
    assert (tmp_path / "out" / "p-gantt.png").read_bytes()[:4] == b"\x89PNG"
    with av.open(tmp_path / "out" / "p-plan.mp4") as film:
        assert sum(1 for _ in film.decode(video=0)) == 10 + 1 + round(1.5 * FPS)


def test_show_names_what_the_rules_forbid_and_says_so_with_its_exit_status(tmp_path, capsys):
    (tmp_path / "p.plan").write_text("0 0 DROP\n1 1 ROTATE_LEFT\n")
    assert main(["show", "strip", "--plan", str(tmp_path / "p.plan")]) == 1
    assert "forbidden: car 0 DROP in tick 0: the car carries nothing" in capsys.readouterr().out


def test_a_gantt_chart_that_the_disk_does_not_take_is_told(tmp_path):
    schedule = make_schedule(Grid.empty((1, 1, 1), n_cars=1), [], RULES)
    with pytest.raises(InputError, match="nowhere"):
        draw_gantt(tmp_path / "nowhere" / "a.png", schedule, "nothing")
