"""Tasks that vary: every start is sound, no start is in two splits, and each world is judged by its own design."""

import numpy as np
import pytest

from craftsim.designs.tasks import DrawnDesigns, designs_task, shape_digest, with_reflections
from craftsim.discrete.grid import Kind, check_grid
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks import (
    VARIED_NAMES,
    Task,
    as_task,
    make_task,
    random_task,
    random_tasks,
    register_task,
)
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.discrete.tasks.starts import Starts, belongs, read_split
from craftsim.errors import InputError
from craftsim.planning import plan_building

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
        one = task.starting_from([starts.grid(i)], starts.design(i, name) if task.draws_designs else None)
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
            rewarded, finished = rewarded + np.count_nonzero(steps.reward), finished + steps.success.sum()
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
    easy, hard = (DrawnDesigns(difficulty=(d, d)).fresh(np.random.default_rng(0), 20).designs for d in (0, 1))
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
    assert not set(starts.digests()) & set(held_out.draw_starts(np.random.default_rng(0), 50).digests())
    assert as_task("random_free_building", n_blocks=5).layout.n_blocks == 5
    wide = random_task("breaking_barrier", area=(6, 7)).draw(np.random.default_rng(0))
    assert (wide.kind[3, :, 1] == Kind.BLOCK).all()
    assert (wide.kind == Kind.BLOCK).sum() == 10


def test_what_cannot_be_is_refused_with_what_is_allowed():
    parts = make_task("strip").starts, make_task("strip").reward, make_task("strip").success
    for make, message in (
        (lambda: as_task("random_strip@tset"), "unknown split 'tset'; did you mean 'test'"),
        (lambda: as_task("strip@test"), "unknown task 'strip@test'"),
        (lambda: random_task("strip", area=(3, 4)), r"area is \(3, 4, 3\); allowed: at least \(4, 4, 1\)"),
        (lambda: random_task("strip", n_blocks=3), "3 blocks; allowed: at least 4"),
        (lambda: random_task("strip", n_cars=14).draw(np.random.default_rng(0)), "no room for 14 cars"),
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
