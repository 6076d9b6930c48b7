"""The large tasks: what free building is rewarded for, sound and distinct starts, and a tower that cars can build."""

import math

import numpy as np
import pytest

from craftsim.designs.tasks import with_reflections
from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import Grid, Kind, Piece
from craftsim.discrete.move_graph import UNREACHABLE, MoveGraph
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks import as_task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.discrete.tasks.random_tasks import LARGE_NAMES, back_to_back, large_task
from craftsim.discrete.tasks.rewards import GOALS, POTENTIALS
from craftsim.discrete.tasks.starts import Starts, belongs, targets_of
from craftsim.errors import InputError
from craftsim.planning import plan_building


def block(x, y, z=1):
    return Piece(Kind.BLOCK, (x, y, z))


def ramp(x, y, z, yaw):
    return Piece(Kind.BODY, (x, y, z), yaw)


FLOOR = [block(x, 2) for x in range(1, 5)]
"""Four blocks in a row along x."""


def world(pieces):
    grid = Grid.empty((6, 5, 4))
    for piece in pieces:
        grid.put(piece)
    grid.derive_marks()
    return grid


def structure(grid):
    return float(POTENTIALS["structure"](grid[None], np.zeros((1, 0, 5), np.int64), None)[0])


def finished():
    """Return the tower, built, in an area without cars."""
    design = large_task("large_tower_4").design
    grid = Grid.empty((10, 10, 4))
    for target in sorted(design.targets, key=lambda target: target.cell[2]):
        if target.kind != Kind.FOOT:
            grid.put(Piece(target.kind, target.cell, max(target.yaw, 0)))
    grid.derive_marks()
    return grid, design


SCORED = (
    (FLOOR, 0),
    ([*FLOOR, block(2, 2, 2), block(2, 2, 3)], 1 + 1 + 50),
    ([block(0, 0), block(0, 0, 2), block(0, 0, 3), block(0, 0, 4)], 3 + 50),
    ([*FLOOR, ramp(1, 1, 1, 3)], 1),
    ([*FLOOR, ramp(1, 1, 1, 2)], 0),
    ([block(2, 2), ramp(1, 2, 1, 2), ramp(2, 1, 1, 3)], 1),
    ([*FLOOR, Piece(Kind.FSLOPE, (2, 2, 2), 2)], 5),
    ([*FLOOR, block(4, 2, 2), ramp(2, 2, 2, 2)], 10 + 1),
    ([*FLOOR, block(3, 2, 2), ramp(2, 2, 2, 2), ramp(0, 2, 1, 2)], 10 + 25 + 1 + 1 + 1),
)


def test_a_structure_is_worth_what_its_parts_weigh():
    for pieces, score in SCORED:
        assert structure(world(pieces)) == score, pieces


def test_three_blocks_from_the_floor_are_a_success_and_what_hangs_or_lies_is_none():
    def reached(pieces, grid=None):
        grid = world(pieces) if grid is None else grid
        return bool(GOALS["three_high"](grid[None], np.zeros((1, 0, 5), np.int64), None)[0])

    stack = [block(2, 2, z) for z in (1, 2, 3)]
    assert reached(stack)
    assert not any(reached([piece for piece in stack if piece != one]) for one in stack)
    assert not reached(FLOOR)
    low = Grid.empty((1, 1, 2))
    low.kind[0, 0, 1:] = Kind.BLOCK
    assert not reached((), low)


def test_the_finished_tower_is_worth_the_same_turned_and_reflected():
    grid, design = finished()
    forms = with_reflections(Starts.of([grid], targets_of(design)))
    scores = POTENTIALS["structure"](forms.grids, forms.designs, None)
    # Four landings, eight blocks on blocks, two ramps on blocks that lead to blocks, two stacks.
    assert scores.tolist() == [4 + 8 + 2 * (10 + 25) + 2 * 50] * 8
    task = large_task("large_tower_4")
    towers = task.potential(forms.grids, forms.designs)
    assert towers.tolist() == [12 + 8 * 3 + 4 + 4] * 8
    assert task.reached(forms.grids, forms.designs).all()


def test_two_slopes_back_to_back_leave_a_car_no_way_under_either():
    for yaw, (dx, dy) in enumerate(DIRECTIONS.tolist()):
        folded = [Piece(Kind.FSLOPE, (2, 2, 1), yaw), Piece(Kind.FSLOPE, (2 - dx, 2 - dy, 1), yaw ^ 2)]
        for slopes, stuck in ((folded, True), (folded[:1], False)):
            grid = world(slopes)
            graph = MoveGraph(grid, Rules("physical"))
            reached = graph.distances_from(graph.floor_nodes(grid.kind[..., 1] == Kind.AIR)) < UNREACHABLE
            under = [node for slope in slopes for node in graph.nodes(slope)]
            assert reached[under].any() != stuck
            assert back_to_back(grid[None]).tolist() == [stuck]


def test_starts_have_all_their_things_on_the_floor_and_are_distinct():
    for name in LARGE_NAMES:
        task, other = as_task(name), as_task(f"{name}@test")
        starts, held_out = (one.draw_starts(np.random.default_rng(0), 200) for one in (task, other))
        digests = starts.digests() + held_out.digests()
        assert len(set(digests)) == len(digests)
        assert belongs(digests, "test").tolist() == [False] * 200 + [True] * 200
        for kind, count in ((Kind.BLOCK, 20), (Kind.FSLOPE, 4), (Kind.GEAR, 4)):
            assert ((starts.grids.kind == kind).sum((1, 2, 3)) == count).all()
            assert ((starts.grids.kind[..., 1] == kind).sum((1, 2)) == count).all()
        assert starts.grids.size == (10, 10, 4)
        assert not back_to_back(starts.grids).any()
        assert starts.grids.n_cars == int(name[-1])


def test_what_free_building_pays_adds_up_and_goes_on_after_success():
    task = large_task("large_free_building_4")
    episodes = Episodes(task, np.random.default_rng(0), 2)
    start = episodes.potential.copy()
    grid, _ = finished()
    episodes.grids.cells[1] = grid.cells
    steps = episodes.step(np.full((2, 4), 10))
    assert steps.reward.tolist() == [0, structure(grid) - start[1]]
    assert steps.success.tolist() == [False, True]
    assert not steps.done.any()


@pytest.mark.parametrize("n_cars", [4, pytest.param(8, marks=pytest.mark.slow)])
def test_the_planner_builds_the_tower_from_a_drawn_start_in_time(n_cars):
    task = large_task(f"large_tower_{n_cars}", "test")
    planned = plan_building(task.draw(np.random.default_rng(0)), task, rounds=2, time_s=math.inf)
    assert task.succeeded(planned.schedule.final)
    assert len(planned.ticks) <= task.max_steps + 2
    assert len({car for tick in planned.ticks for car, _ in tick}) > n_cars // 2


def test_their_numbers_are_their_own_and_names_are_suggested():
    with pytest.raises(InputError, match="has its own area and numbers"):
        as_task("large_tower_4", n_cars=6)
    with pytest.raises(InputError, match="did you mean 'large_tower_8'"):
        large_task("large_tower8")
    with pytest.raises(InputError, match="unknown split 'tset'"):
        as_task("large_tower_4@tset")
