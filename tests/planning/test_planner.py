"""Plans from designs: legal, whole, reproducible, and refused with a reason."""

import re
import time
from functools import partial

import numpy as np
import pytest

from craftsim import cli
from craftsim.designs.drawn import random_start, random_structure
from craftsim.designs.library import make_design
from craftsim.designs.starts import make_start
from craftsim.discrete.files.blueprint import write_blueprint
from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import CarField, Grid, Kind, Piece
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import make_schedule
from craftsim.errors import InputError
from craftsim.planning import NoPlanError, plan_building
from craftsim.planning.assembly import Assembly, without_things
from craftsim.planning.plan_file import read_plan
from craftsim.planning.planned import platforms
from craftsim.tasks import TASK_NAMES, make_task

RULES = Rules("physical")
ROUNDS = 6


def yard(size, n_cars, blocks=()):
    """A world with things on its floor, and cars along its lower edge."""
    grid = Grid.empty(size, n_cars)
    for cell in blocks:
        grid.put(Piece(Kind.BLOCK, cell))
    grid.cars[:, CarField.X] = range(n_cars)
    grid.derive_marks()
    return grid


def obeys(grid, planned, reached):
    schedule = make_schedule(grid, planned.ticks, RULES)
    return not schedule.forbidden and reached(schedule.final)


@pytest.mark.parametrize("name", TASK_NAMES)
def test_a_task_is_planned_by_the_rules(name):
    task = make_task(name)
    grid = task.draw(np.random.default_rng(0))
    planned = plan_building(grid, task, RULES, rounds=8, time_s=60)
    assert obeys(grid, planned, task.succeeded)
    assert planned.bound_s <= planned.makespan_s <= planned.work_s


def test_a_structure_of_three_levels_is_planned_in_one_attempt_since_no_slope_goes_where_it_is_missed_later():
    rng = np.random.default_rng(1)
    start = make_start(random_structure((7, 7, 3), rng), 4, rng)
    planned = plan_building(start.grid, start.design, RULES, rounds=1)
    assert obeys(start.grid, planned, start.design.satisfied)


@pytest.mark.parametrize("seed", range(2))
def test_a_random_design_is_planned_by_the_rules(seed):
    start = random_start(np.random.default_rng(seed), 0.3)
    planned = plan_building(start.grid, start.design, RULES, rounds=ROUNDS)
    assert obeys(start.grid, planned, start.design.satisfied)


def test_the_same_seed_is_the_same_plan():
    task = make_task("simple_two_story")
    grid = task.draw(np.random.default_rng(0))
    # So many that the search has gone on from the first ones to neighbours.
    plans = [plan_building(grid, task, RULES, rounds=20, time_s=60, seed=3).ticks for _ in range(2)]
    assert plans[0] == plans[1]


def test_more_attempts_are_not_worse_and_who_has_enough_gets_the_best_so_far():
    task = make_task("block")
    grid = task.draw(np.random.default_rng(0))
    seen = []

    def report(number, best):
        seen.extend([best.makespan_s] if best is not None else ())
        return len(seen) == 12

    planned = plan_building(grid, task, RULES, rounds=100, time_s=60, report=report)
    assert len(seen) == 12
    assert seen == sorted(seen, reverse=True)
    assert planned.makespan_s == seen[-1]
    assert obeys(grid, planned, task.succeeded)


def test_no_plan_is_faster_than_the_bound_where_a_car_carries_what_is_needed():
    grid = yard((6, 6, 2), 1, blocks=[(5, 5, 1)])
    grid.cars[0, CarField.LOAD] = Kind.BLOCK
    planned = plan_building(grid, Design.of("one", [(1, 0, 1)], []), RULES, rounds=ROUNDS)
    assert planned.bound_s <= planned.makespan_s < 3


def test_what_stands_in_the_way_is_moved():
    # A corridor of walls, whose only way in leads through the cell of a block that stands there already.
    grid = yard((6, 3, 2), 1, blocks=[(1, 2, 1), (3, 0, 1), (5, 2, 1)])
    grid.cars[0, : CarField.YAW] = (0, 1, 1)
    grid.kind[2:, 1, 1] = Kind.WALL
    grid.derive_marks()
    design = Design.of("corridor", [(5, 0, 1), (4, 0, 1), (3, 0, 1)], [])
    assert obeys(grid, plan_building(grid, design, RULES, rounds=ROUNDS), design.satisfied)


def test_a_flag_is_brought_through_a_barrier_in_which_a_car_stands():
    task = make_task("breaking_barrier")
    barrier = [(3, y, 1) for y in range(5)]
    grid = yard((5, 5, 1), 2, blocks=[*barrier, (0, 3, 1), (2, 1, 1), (4, 0, 1)])
    grid.cars[0, :5] = (4, 2, 1, 3, Kind.FLAG)
    grid.cars[1, :4] = (3, 2, 1, 1)
    grid.derive_marks()
    assert obeys(grid, plan_building(grid, task, RULES, rounds=ROUNDS), task.succeeded)
    with pytest.raises(NoPlanError, match="a flag at"):
        plan_building(grid, task, RULES, rounds=ROUNDS, exact=False)


def walled_in():
    """A place between four walls, which no car reaches."""
    grid = yard((8, 6, 2), 2, [(7, 5, 1), (7, 4, 1)])
    for cell in ((3, 2, 1), (5, 2, 1), (4, 1, 1), (4, 3, 1)):
        grid.kind[cell] = Kind.WALL
    grid.derive_marks()
    return grid, Design.of("walled_in", [(4, 2, 1), (0, 5, 1)], [])


def too_few_slopes():
    """A tower of three blocks, and a single slope."""
    grid = yard((8, 6, 3), 2, [(7, 5, 1), (7, 4, 1), (7, 3, 1), (6, 3, 1)])
    grid.put(Piece(Kind.FSLOPE, (6, 1, 1), 0))
    grid.derive_marks()
    return grid, Design.of("tower", [(1, 1, 1), (1, 1, 2), (1, 1, 3)], [])


def locked_up():
    """A place that any car reaches, and a block between walls that none does."""
    grid = yard((8, 6, 2), 2, [(4, 2, 1)])
    for cell in ((3, 2, 1), (5, 2, 1), (4, 1, 1), (4, 3, 1)):
        grid.kind[cell] = Kind.WALL
    grid.derive_marks()
    return grid, Design.of("out", [(1, 1, 1)], [])


def long_wall(length):
    start = make_start(make_design("wall", (length, 2, 2)), 8, np.random.default_rng(0))
    return start.grid, start.design


def small_corridor():
    """A world that is small enough for the exact search, and a place behind a wall."""
    grid = yard((12, 2, 2), 1, [(2, 1, 1), (4, 1, 1)])
    grid.kind[8, :, 1] = Kind.WALL
    grid.derive_marks()
    return grid, Design.of("behind", [(10, 0, 1)], [])


LIMIT_S = 0.5
WITHOUT_PLAN = {
    "walled in": (walled_in, {"rounds": 1_000_000}),
    "too few slopes": (too_few_slopes, {}),
    "an attempt that takes long": (partial(long_wall, 25), {}),
    "a first order that takes long": (partial(long_wall, 60), {}),
    "a goal without a drawing": (
        lambda: (yard((6, 6, 2), 2, [(1, 1, 1), (2, 2, 1)]), lambda grid: False),
        {},
    ),
    "a small world": (small_corridor, {}),
    "a small world, least work": (small_corridor, {"objective": "work"}),
}


@pytest.mark.parametrize("case", WITHOUT_PLAN)
def test_the_time_limit_is_that_of_the_whole_search(case):
    make, options = WITHOUT_PLAN[case]
    start, goal = make()
    with pytest.raises(NoPlanError):
        plan_building(
            start, goal, RULES, time_s=0.01
        )  # what is compiled at the first use is not timed
    begun_s = time.process_time()
    with pytest.raises(NoPlanError):
        plan_building(start, goal, RULES, time_s=LIMIT_S, **options)
    assert time.process_time() - begun_s < LIMIT_S + 1


@pytest.mark.parametrize(
    ("make", "options", "says"),
    [
        (
            walled_in,
            {"rounds": 3},
            "a block at (4, 2, 1): no car can drive there with it (3 attempts in ",
        ),
        (
            too_few_slopes,
            {"rounds": 3},
            "3 objects, among them a block at (1, 1, 3): no ramp leads to level 3; one takes four cells in line on "
            "level 2, on blocks of the design (3 ",
        ),
        (
            walled_in,
            {"time_s": 0.3, "rounds": 1_000_000},
            "no plan found in time: no order to build in was found",
        ),
        (
            locked_up,
            {"rounds": 3},
            "of its 1 steps no attempt made more than 0, and a block at (1, 1, 1) was not",
        ),
    ],
)
def test_where_there_is_no_plan_the_message_names_a_thing_that_could_not_be_placed(
    make, options, says
):
    with pytest.raises(NoPlanError) as caught:
        plan_building(*make(), RULES, **options)
    assert says in str(caught.value)


def test_a_platform_larger_than_any_part_of_the_floor_is_refused_at_once():
    # Ten blocks on two parts of the floor with nine cells each.
    grid = yard((7, 3, 1), 1, [(x, y, 1) for x in (1, 2, 4, 5, 6) for y in (1, 2)])
    grid.kind[3, :, 1] = Kind.WALL
    grid.derive_marks()
    begun_s = time.process_time()
    with pytest.raises(
        NoPlanError, match=r"10 blocks .* no part of the floor between walls has more than 9 cells"
    ):
        plan_building(grid, make_task("free_building"), RULES, time_s=LIMIT_S)
    assert time.process_time() - begun_s < LIMIT_S + 1


def test_a_platform_is_planned_where_the_blocks_lie_in_a_part_of_the_floor_that_is_too_small():
    # Two cells are parted off by a wall at their side, and hold a block that no car reaches.
    grid = yard((6, 4, 1), 1, [(5, 3, 1)])
    grid.kind[4, 3, 1] = grid.kind[5, 2, 1] = Kind.WALL
    grid.derive_marks()
    drawn = next(platforms(grid, 3, np.random.default_rng(0)))
    assert len(drawn) == 3
    assert Piece(Kind.BLOCK, (5, 3, 1)) not in drawn


def test_a_search_that_takes_long_says_how_far_it_is(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("craftsim.cli.show._PLAN_EVERY_S", 0.1)
    grid, design = too_few_slopes()
    write_blueprint(grid, tmp_path / "start.yaml")
    cells = [target.cell for target in design.targets]
    lines = [f"  - {{id: {i}, x: {x}, y: {y}, z: {z}}}\n" for i, (x, y, z) in enumerate(cells)]
    (tmp_path / "goal.yaml").write_text("block:\n" + "".join(lines))
    begun_s = time.process_time()
    words = (
        f"plan {tmp_path}/start.yaml --goal {tmp_path}/goal.yaml --time-limit 1 --attempts 1000000"
    )
    status = cli.main([*words.split(), "--out", f"{tmp_path}/out.plan"])
    assert time.process_time() - begun_s < 4
    assert status == 2
    printed = capsys.readouterr()
    assert re.search(r"\d s  \d+ attempts done: no plan yet", printed.out)
    assert "among them a block at (1, 1, 3): no ramp leads to level 3" in printed.err


def after_order(assembly, goal, n_slopes):
    """Return what stands after an order of assembly, whose steps can all be made."""
    state = frozenset()
    for step in assembly.find_order(goal, state, n_slopes, np.random.default_rng(0)):
        assert assembly.possible(state, step)
        state = step.after(state)
    return state


def test_a_ramp_that_nobody_could_take_away_stays():
    # The last block of the fourth level stands on the landing of the ramp to it.
    rng = np.random.default_rng(2)
    start = make_start(random_structure((10, 10, 4), rng), 4, rng)
    goal = frozenset(target._replace(yaw=0) for target in start.design.targets)
    assert after_order(Assembly(without_things(start.grid), RULES), goal, 3) > goal


def test_a_pyramid_has_an_order_whose_steps_can_be_made():
    goal = frozenset(make_design("pyramid").moved(3, 3).targets)
    assert after_order(Assembly(without_things(yard((12, 12, 4), 0)), RULES), goal, 2) == goal


def test_nothing_is_done_where_the_goal_is_reached():
    grid = yard((4, 4, 2), 1, blocks=[(2, 2, 1)])
    assert plan_building(grid, Design.of("one", [(2, 2, 1)], []), RULES).ticks == ()


@pytest.mark.parametrize(
    ("reason", "blocks"),
    [
        ("not enough blocks", [(1, 1, 1), (2, 1, 1), (3, 1, 1)]),
        ("nothing below", [(1, 1, 2), (2, 2, 1)]),
        ("outside", [(1, 9, 1)]),
        ("no slope", [(2, 2, 1), (2, 2, 2)]),
        ("a wall", [(4, 4, 1)]),
    ],
)
def test_why_there_is_no_plan_is_said(reason, blocks):
    grid = yard((5, 5, 2), 1, blocks=[(3, 0, 1), (3, 1, 1)])
    grid.kind[4, 4, 1] = Kind.WALL
    with pytest.raises(NoPlanError, match=reason):
        plan_building(grid, Design.of("it", blocks, []), RULES, rounds=2)


def test_a_goal_by_name_is_refused_with_what_is_allowed():
    with pytest.raises(
        InputError, match="the goal is 'strip'; allowed: a Design, a Task, or a function"
    ):
        plan_building(make_task("strip").draw(np.random.default_rng(0)), "strip")


def test_the_command_writes_a_plan_that_can_be_read(tmp_path, capsys):
    assert cli.main(["plan", "strip", "--attempts", "3", "--out", str(tmp_path / "made")]) == 0
    plan = read_plan(tmp_path / "made" / "strip.plan", 2)
    assert plan.after
    assert (tmp_path / "made" / "report.json").exists()
    assert (tmp_path / "made" / "strip-gantt.svg").exists()
    assert cli.main(["plan", "strip", "--attempts", "1", "--out", str(tmp_path / "only.plan")]) == 0
    assert [path.name for path in tmp_path.glob("*.plan")] == ["only.plan"]
    goal = tmp_path / "goal.yaml"
    goal.write_text(
        "block:\n" + "".join(f"  - {{id: {i}, x: {i}, y: 0, z: 1}}\n" for i in range(4))
    )
    assert (
        cli.main(["plan", "simple_two_story", "--goal", str(goal), "--out", str(tmp_path / "x")])
        == 2
    )
    assert "not enough blocks" in capsys.readouterr().err
