"""Tasks that vary, and the large ones: sound starts, none in two splits, and each world judged by its own design."""

import math

import numpy as np
import pytest

from craftsim.designs.tasks import DrawnDesigns, designs_task, shape_digest, with_reflections
from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import Grid, Kind, Piece, check_grid
from craftsim.discrete.move_graph import UNREACHABLE, MoveGraph
from craftsim.discrete.rules import Rules
from craftsim.errors import InputError
from craftsim.planning import plan_building
from craftsim.tasks import (
    VARIED_NAMES,
    Task,
    as_task,
    make_task,
    random_task,
    random_tasks,
    register_task,
)
from craftsim.tasks.episodes import Episodes
from craftsim.tasks.potentials import GOALS, complexity, platform
from craftsim.tasks.potentials import structure as structures_of
from craftsim.tasks.random_tasks import LARGE_NAMES, back_to_back, large_task
from craftsim.tasks.starts import Starts, belongs, read_split, targets_of

LISTED = dict.fromkeys(random_tasks.RANDOM_NAMES, 1000) | {"designs": 800}
"""How many held-out starts each task is shipped with."""


def test_distinct_starts_are_held_out_and_none_is_ever_trained_from():
    for name in LISTED:
        held_out, ticks = read_split(name, "test")
        digests = held_out.digests()
        assert len(set(digests)) == len(digests) == LISTED[name]
        drawn = as_task(name).draw_starts(np.random.default_rng(0), 600).digests()
        assert not set(digests) & set(drawn)
        if name != "designs":
            assert belongs(digests, "test").all()
            assert belongs(drawn, "train").all()
        assert (ticks > 0).all()
        assert (ticks <= as_task(name).max_steps + 2).all()


def test_every_start_is_a_sound_world_with_work_to_do():
    for split in ("train", "test"):
        for name in VARIED_NAMES:
            task = as_task(f"{name}@{split}")
            starts = task.draw_starts(np.random.default_rng(1), 120)
            layout = task.layout
            blocks, slopes = (
                (starts.grids.kind == kind).sum((1, 2, 3)) for kind in (Kind.BLOCK, Kind.FSLOPE)
            )
            assert (blocks <= layout.n_blocks).all()
            assert (slopes <= layout.n_slopes).all()
            assert not task.reached(starts.grids, starts.designs).any()
            for i in range(0, len(starts), 10):
                grid = starts.grid(i)
                check_grid(grid)
                derived = grid.copy()
                derived.derive_marks()
                assert derived.same_marks(grid)
                at = grid.cars[:, :3].tolist()
                assert len(set(map(tuple, at))) == grid.n_cars
                assert all(grid.kind[tuple(cell)] == Kind.AIR for cell in at)


def test_the_same_seed_draws_the_same_starts():
    for name in VARIED_NAMES:
        one, other = (as_task(name).draw_starts(np.random.default_rng(3), 10) for _ in range(2))
        assert one.grids.same_visible(other.grids)
        assert one.grids.same_marks(other.grids)
        assert np.array_equal(one.designs, other.designs)


def test_things_and_cars_start_anywhere_and_turned_anyhow():
    starts = as_task("random_simple_two_story").draw_starts(np.random.default_rng(0), 3000)
    kind, slope = starts.grids.kind[..., 1], starts.grids.kind[..., 1] == Kind.FSLOPE
    assert (kind == Kind.BLOCK).any(0).all()
    # A slope needs a cell before it and one behind it, which corners do not have.
    assert slope.any(0).sum() == 16 - 4
    assert set(starts.grids.yaw[..., 1][slope]) == {0, 1, 2, 3}
    x, y, yaw = (starts.grids.cars[..., column].ravel() for column in (0, 1, 3))
    shares = np.bincount(x * 16 + y * 4 + yaw, minlength=64) / len(x)
    assert np.allclose(shares, 1 / 64, atol=0.006)


def test_the_flag_starts_behind_a_whole_barrier():
    starts = as_task("random_breaking_barrier").draw_starts(np.random.default_rng(0), 500)
    assert (starts.grids.kind[:, 3, :, 1] == Kind.BLOCK).all()
    assert (starts.grids.kind[:, 4:, :, 1] == Kind.FLAG).any(0).all()
    assert (starts.grids.kind[:, :3] != Kind.FLAG).all()


def test_a_held_out_start_has_a_plan_that_ends_in_success_in_time(rng):
    for name in ("random_strip", "designs"):
        task, (starts, ticks) = as_task(f"{name}@test"), read_split(name, "test")
        i = int(np.argmin(ticks))
        one = task.starting_from(
            [starts.grid(i)], starts.design(i, name) if task.draws_designs else None
        )
        planned = plan_building(starts.grid(i), one, Rules("physical"), rounds=2)
        assert len(planned.ticks) <= task.max_steps + 2
        assert one.succeeded(planned.schedule.final)


def test_each_world_of_a_batch_is_judged_by_its_own_design_as_if_it_were_alone(rng):
    for reward in ("paper", "published_code", "complexity"):
        task = designs_task(reward=reward)
        starts = task.draw_starts(np.random.default_rng(1), 12)
        assert len({design.tobytes() for design in starts.designs}) > 6
        for i in range(4):
            _finish(starts, i)
        batch = Episodes(task, np.random.default_rng(0), 12)
        batch.begin(np.arange(12), starts)
        alone = []
        for i in range(12):
            one = task.starting_from([starts.grid(i)], starts.design(i, "one"))
            alone.append(Episodes(one, np.random.default_rng(0)))
        order, rewarded, finished = np.tile([0, 1], (12, 1)), 0, 0
        for _ in range(15):
            mask = batch.offered()
            actions = (rng.random(mask.shape) * mask).argmax(-1)
            steps = batch.step(actions, order)
            for i, one in enumerate(alone):
                step = one.step(actions[i : i + 1], order[:1])
                for name in ("reward", "success", "done"):
                    assert getattr(step, name)[0] == getattr(steps, name)[i]
            rewarded, finished = (
                rewarded + np.count_nonzero(steps.reward),
                finished + steps.success.sum(),
            )
        assert rewarded
        assert finished


def _finish(starts: Starts, i: int) -> None:
    """Put the finished building into a world in place of its things, so that success is seen, too."""
    starts.grids.kind[i, :, :, 1:], starts.grids.yaw[i] = Kind.AIR, 0
    for kind, x, y, z, yaw in starts.designs[i][starts.designs[i, :, 0] != 0].tolist():
        starts.grids.kind[i, x, y, z], starts.grids.yaw[i, x, y, z] = kind, max(yaw, 0)
    grid = starts.grid(i)
    grid.derive_marks()
    starts.grids.cells[i] = grid.cells


def test_the_designs_of_a_batch_are_those_of_its_running_episodes():
    episodes = Episodes(as_task("designs"), np.random.default_rng(0), 8)
    before = episodes.designs.copy()
    assert before.shape == (8, 8, 5)
    episodes.reset([1, 3])
    assert np.array_equal(before[[0, 2, 4]], episodes.designs[[0, 2, 4]])
    assert not np.array_equal(before[[1, 3]], episodes.designs[[1, 3]])
    fixed = Episodes(make_task("strip"), np.random.default_rng(0), 3).designs
    assert fixed[2].tolist() == [[Kind.BLOCK, 3, y, 1, -1] for y in range(4)]


def test_no_held_out_design_turned_reflected_or_moved_is_trained_from():
    train, test = (read_split("designs", split)[0].designs[::8] for split in ("train", "test"))
    assert belongs(list(map(shape_digest, train)), "train").all()
    assert belongs(list(map(shape_digest, test)), "test").all()
    starts = DrawnDesigns().fresh(np.random.default_rng(0), 6)
    turned = with_reflections(starts)
    assert len(turned) == 8 * 6
    for i in range(6):
        assert len({shape_digest(turned.designs[i + 6 * k]) for k in range(8)}) == 1
        assert len({turned.grids.kind[i + 6 * k].tobytes() for k in range(8)}) > 1
        for k in range(8):
            grid = turned.grid(i + 6 * k)
            check_grid(grid)
            derived = grid.copy()
            derived.derive_marks()
            assert derived.same_marks(grid)


def test_a_harder_difficulty_has_more_blocks_and_more_second_levels():
    easy, hard = (
        DrawnDesigns(difficulty=(d, d)).fresh(np.random.default_rng(0), 20).designs for d in (0, 1)
    )
    assert (easy[..., 3] <= 1).all()
    assert (hard[..., 3] == 2).any(1).mean() > 0.9
    assert (easy[..., 0] == Kind.BLOCK).sum() < (hard[..., 0] == Kind.BLOCK).sum()


def test_numbers_and_area_can_be_others():
    task = random_task("strip", n_cars=4, n_blocks=6, area=(6, 5))
    starts = task.draw_starts(np.random.default_rng(0), 50)
    assert starts.grids.kind.shape == (50, 6, 5, 4)
    assert ((starts.grids.kind == Kind.BLOCK).sum((1, 2, 3)) == 6).all()
    assert starts.grids.cars.shape == (50, 4, 7)
    held_out = random_task("strip", "test", n_cars=4, n_blocks=6, area=(6, 5))
    assert not set(starts.digests()) & set(
        held_out.draw_starts(np.random.default_rng(0), 50).digests()
    )
    assert as_task("random_free_building", n_blocks=5).layout.n_blocks == 5
    wide = random_task("breaking_barrier", area=(6, 7)).draw(np.random.default_rng(0))
    assert (wide.kind[3, :, 1] == Kind.BLOCK).all()
    assert (wide.kind == Kind.BLOCK).sum() == 10


def test_what_cannot_be_is_refused_with_what_is_allowed():
    parts = make_task("strip").starts, make_task("strip").reward, make_task("strip").success
    for make, message in (
        (lambda: as_task("random_strip@tset"), "unknown split 'tset'; did you mean 'test'"),
        (lambda: as_task("strip@test"), "unknown task 'strip@test'"),
        (
            lambda: random_task("strip", area=(3, 4)),
            r"area is \(3, 4, 3\); allowed: at least \(4, 4, 1\)",
        ),
        (lambda: random_task("strip", n_blocks=3), "3 blocks; allowed: at least 4"),
        (
            lambda: random_task("strip", n_cars=14).draw(np.random.default_rng(0)),
            "no room for 14 cars",
        ),
        (lambda: designs_task(area=(4, 6)), "allowed: 2 blocks or more, 6 cells a side"),
        (lambda: designs_task(difficulty=(0.5, 2)), "difficulty is 2; allowed: 0 to 1"),
        (lambda: register_task(Task("designs", *parts)), "a task of craftsim's own"),
        (
            lambda: as_task("designs").succeeded(make_task("strip").draw(np.random.default_rng(0))),
            "for_episode",
        ),
        (lambda: as_task("strip", area=(6, 6)), "only those that vary take one"),
        (lambda: as_task("designs", area=(6,)), "length and width, perhaps height"),
    ):
        with pytest.raises(InputError, match=message):
            make()


def test_the_task_of_one_episode_goes_on_to_show_its_design():
    task = as_task("designs@test")
    one = task.for_episode(np.random.default_rng(3))
    assert one.layout == task.layout
    episodes = Episodes(one, np.random.default_rng(0), 2)
    assert episodes.designs.shape == (2, task.layout.n_targets, 5)
    shown = {tuple(row[1:4]) for row in episodes.designs[0].tolist() if row[0]}
    assert shown == {target.cell for target in one.design.targets}


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
    return float(structures_of(grid[None], np.zeros((1, 0, 5), np.int64), None)[0])


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


def _by_words(grid):
    """Return what ``structure`` and ``complexity`` count beside platforms, and the stacks, cell by cell."""
    structure_score = 0.0
    complexity_score = 0.0
    stacks = 0
    landings = set()
    for x, y, z in np.ndindex(*grid.kind.shape):
        kind = grid.kind[x, y, z]
        dx, dy = DIRECTIONS[grid.yaw[x, y, z]]
        below = grid.kind_at((x, y, z - 1)) if z > 0 else Kind.AIR
        behind = (int(x - dx), int(y - dy), z)
        foot = (int(x + dx), int(y + dy), z)
        if kind == Kind.BLOCK:
            complexity_score += z - 1
            structure_score += below == Kind.BLOCK
            stacks += z == 3 and below == Kind.BLOCK and grid.kind_at((x, y, 1)) == Kind.BLOCK
        if kind == Kind.FSLOPE:
            structure_score += 5 * (below == Kind.BLOCK)
        if kind == Kind.BODY:
            structure_score += 10 * (below == Kind.BLOCK)
            if grid.inside(behind) and grid.kind[behind] == Kind.BLOCK:
                landings.add(behind)
                structure_score += 25 * (below == Kind.BLOCK)
                has_foot = grid.inside(foot) and grid.kind[foot] == Kind.FOOT
                complexity_score += has_foot and grid.yaw[foot] == grid.yaw[x, y, z]
    return structure_score + len(landings) + 50 * stacks, complexity_score, stacks


def test_scores_of_free_buildings_are_what_they_say_of_any_world():
    """Of 600 crowded arrangements, possible ones or not, in areas of all shapes."""
    rng = np.random.default_rng(0)
    no_designs = np.zeros((4, 0, 5), np.int64)
    for _ in range(150):
        size = tuple(int(side) for side in rng.integers(1, 7, 3))
        grids = Grid.stack([Grid.empty(size) for _ in range(4)])
        shape = grids.kind[..., 1:].shape
        grids.kind[..., 1:] = rng.choice(
            [Kind.AIR, Kind.BLOCK, Kind.FSLOPE, Kind.BODY, Kind.FOOT], shape
        )
        grids.yaw[..., 1:] = rng.integers(0, 4, shape)
        expected = np.array([_by_words(grids[i]) for i in range(4)])
        structures = structures_of(grids, no_designs, None)
        complexities = complexity(grids, no_designs, None)
        platforms = platform(grids, no_designs, None)
        assert structures.tolist() == expected[:, 0].tolist()
        assert (complexities - platforms).tolist() == expected[:, 1].tolist()
        assert (
            GOALS["three_high"](grids, no_designs, None).tolist() == (expected[:, 2] > 0).tolist()
        )
        one = structures_of(grids[:1], no_designs[:1], None)
        assert one.tolist() == expected[:1, 0].tolist()


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
    scores = structures_of(forms.grids, forms.designs, None)
    # Four landings, eight blocks on blocks, two ramps on blocks that lead to blocks, two stacks.
    assert scores.tolist() == [4 + 8 + 2 * (10 + 25) + 2 * 50] * 8
    task = large_task("large_tower_4")
    towers = task.potential(forms.grids, forms.designs)
    assert towers.tolist() == [12 + 8 * 3 + 4 + 4] * 8
    assert task.reached(forms.grids, forms.designs).all()


def test_two_slopes_back_to_back_leave_a_car_no_way_under_either():
    for yaw, (dx, dy) in enumerate(DIRECTIONS.tolist()):
        folded = [
            Piece(Kind.FSLOPE, (2, 2, 1), yaw),
            Piece(Kind.FSLOPE, (2 - dx, 2 - dy, 1), yaw ^ 2),
        ]
        for slopes, stuck in ((folded, True), (folded[:1], False)):
            grid = world(slopes)
            graph = MoveGraph(grid, Rules("physical"))
            reached = (
                graph.distances_from(graph.floor_nodes(grid.kind[..., 1] == Kind.AIR)) < UNREACHABLE
            )
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
