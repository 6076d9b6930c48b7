"""The plan of least work in small worlds: as good as a plain search's, and a proof where there is none."""

import time

import numpy as np
import pytest
from planning.by_force import least_work_by_force
from planning.tiny_worlds import tiny_world

from craftsim.discrete.files.design import design_in
from craftsim.discrete.grid import CarField, Grid, Kind, Piece
from craftsim.discrete.rules import Rules
from craftsim.planning import NoPlanError, plan_building
from craftsim.planning.exact import is_small, least_work
from craftsim.planning.planned import make_goal
from craftsim.tasks import make_task

PHYSICAL = Rules("physical")


def corridor(*things, size=(3, 1, 2), car=(0, 0, 1)):
    """Return a world with one car and (kind, cell) things."""
    grid = Grid.empty(size, n_cars=1)
    grid.cars[0, :3] = car
    for kind, cell in things:
        grid.kind[cell] = kind
    grid.derive_marks()
    return grid


@pytest.mark.parametrize("seed", [3, 8, 24, 26])
def test_no_plan_takes_less_work_than_the_planner_s(seed):
    world = tiny_world(np.random.default_rng(seed))
    planned = plan_building(world.grid, world.design, PHYSICAL, objective="work")
    assert planned.optimal
    assert round(1000 * planned.work_s) == least_work_by_force(
        world.grid, world.design.satisfied, PHYSICAL, 30_000
    )


@pytest.mark.parametrize(
    ("objective", "thing", "reached"),
    [
        ("work", Kind.FSLOPE, lambda grid: bool((grid.kind == Kind.BODY).any())),
        (
            "makespan",
            Kind.BLOCK,
            lambda grid: bool(grid.kind[3, 0, 1] == Kind.BLOCK and grid.cars[0, CarField.X] == 0),
        ),
    ],
)
def test_a_goal_without_a_drawing_is_reached_with_the_least_work(objective, thing, reached):
    start = Grid.empty((4, 2, 2), n_cars=1)
    start.put(Piece(thing, (2, 0, 1)))
    start.derive_marks()
    planned = plan_building(start, reached, PHYSICAL, objective=objective)
    assert reached(planned.schedule.final)
    assert round(1000 * planned.work_s) == least_work_by_force(start, reached, PHYSICAL)


def test_what_cannot_be_is_proved_impossible():
    start = corridor((Kind.BLOCK, (0, 0, 1)), (Kind.BLOCK, (2, 0, 1)))
    with pytest.raises(NoPlanError, match=r"none of the \d+ worlds that can be reached will do"):
        plan_building(start, lambda grid: grid.kind[1, 0, 2] == Kind.BLOCK, PHYSICAL)
    walled = corridor((Kind.BLOCK, (1, 0, 1)), (Kind.WALL, (3, 0, 1)), size=(5, 1, 2))
    beyond = walled.copy()
    beyond.kind[1, 0, 1], beyond.kind[4, 0, 1] = Kind.AIR, Kind.BLOCK
    for objective in ("work", "makespan"):
        with pytest.raises(
            NoPlanError, match=r"none of the \d+ worlds that can be reached will do"
        ):
            plan_building(walled, design_in(beyond), PHYSICAL, objective=objective)


def test_the_search_is_bounded_and_only_by_rules_whose_marks_follow_from_what_is_there():
    start, nothing = (
        corridor((Kind.BLOCK, (0, 0, 1)), size=(6, 6, 1)),
        make_goal(lambda grid: False),
    )
    steps, n_worlds, complete = least_work(start, nothing, PHYSICAL, 500)
    assert (steps, complete) == (None, False)
    assert 500 < n_worlds <= 500 + 15 * start.n_cars
    assert is_small(start, PHYSICAL)
    assert not is_small(start, Rules("published"))
    with pytest.raises(ValueError, match="marks"):
        least_work(start, nothing, Rules("published"))


def test_the_search_ends_in_time_however_long_it_takes_to_ask_for_the_goal():
    start, n_asked = corridor((Kind.BLOCK, (0, 0, 1)), size=(6, 6, 1)), []
    with pytest.raises(NoPlanError, match=r"none of the first \d+ worlds .* more time"):
        plan_building(start, lambda grid: n_asked.append(time.sleep(0.05)), PHYSICAL, time_s=0.05)
    assert 2 <= len(n_asked) <= 8


def test_the_plan_of_least_work_is_one_to_begin_with_where_the_makespan_counts():
    world = tiny_world(
        np.random.default_rng(1)
    )  # the design's slope may have its gear beside the area
    least = plan_building(world.grid, world.design, PHYSICAL, objective="work")
    quick = plan_building(world.grid, world.design, PHYSICAL, rounds=1)
    assert quick.makespan_s <= least.makespan_s
    assert not quick.schedule.forbidden


def test_the_search_for_least_work_can_be_left_out(monkeypatch):
    task = make_task("simple_two_story")
    start = task.draw(np.random.default_rng(0))
    assert is_small(start, PHYSICAL)
    monkeypatch.setattr("craftsim.planning.planner.least_work", None)
    assert task.succeeded(plan_building(start, task, rounds=1, exact=False).schedule.final)
    with pytest.raises(TypeError, match="not callable"):
        plan_building(start, task, rounds=1)
