"""Tasks and rewards, the paper's and one's own, and observations; those of worlds are recorded: test_conformance."""

from dataclasses import replace

import numpy as np
import pytest

from craftsim.discrete.files.blueprint import parse_blueprint
from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.kinds import Action
from craftsim.errors import CraftsimError, InputError
from craftsim.tasks import TASK_NAMES, Task, make_task, potentials
from craftsim.tasks.episodes import Episodes
from craftsim.tasks.observation import Layout, entity_rows, target_rows
from craftsim.tasks.potentials import GOALS
from craftsim.tasks.rewards import PotentialTerm, Reward
from craftsim.tasks.starts import targets_of

BLOCK, GEAR, FSLOPE, BODY, FOOT = Kind.BLOCK, Kind.GEAR, Kind.FSLOPE, Kind.BODY, Kind.FOOT


def worth(task, grid):
    """Return the potential of one world."""
    return task.potential(grid[None], targets_of(task.design)[None])[0]


def finished(task, rng):
    """Return the start with all targets of the design put in place."""
    grid = task.draw(rng)
    grid.kind[:, :, 1:] = 0
    for target in task.design.targets:
        grid.kind[target.cell] = target.kind
        grid.yaw[target.cell] = max(target.yaw, 0)
    return grid


def test_a_finished_building_is_worth_what_paper_and_code_say(rng):
    for name, paper, code in (
        ("strip", 8, 12),
        ("simple_two_story", 7, 13),
        ("complex_two_story", 16, 20),
    ):
        for reward, most in (("paper", paper), ("published_code", code)):
            task = make_task(name, reward=reward)
            grid = finished(task, rng)
            assert worth(task, grid) == most
            assert task.succeeded(grid)
            assert not task.succeeded(task.draw(rng))


def test_a_slope_pays_only_when_both_its_parts_are_in_place_the_right_way_round(rng):
    task = make_task("simple_two_story")
    grid = task.draw(rng)
    grid.kind[2, 2, 1], grid.yaw[2, 2, 1] = BODY, 3
    assert worth(task, grid) == 0
    grid.kind[2, 1, 1], grid.yaw[2, 1, 1] = FOOT, 3
    assert worth(task, grid) == 1
    grid.yaw[2, 1, 1] = 1
    assert worth(task, grid) == 0


def test_platforms_are_counted_level_by_level(scene):
    row = [
        (BLOCK, cell) for cell in ((0, 1, 1), (1, 1, 1), (2, 1, 1), (5, 5, 1), (0, 1, 2), (4, 1, 1))
    ]
    for objects, paper, code in (
        ([], 0, 0),
        (row[:1], 0, 0),
        (row, 2, 3),
        ([*row, (GEAR, (3, 1, 1))], 2, 5),
    ):
        assert _platforms(scene(objects)) == (paper, code)
    assert _platforms(scene([(BLOCK, (x, 1, 3)) for x in range(3)])) == (2, 0)


def _platforms(grid):
    return tuple(_number(name, grid) for name in ("platform", "published_platform"))


def _number(potential, grid):
    task = make_task("free_building")
    return getattr(potentials, potential)(
        grid[None], task.draw_starts(np.random.default_rng(0), 1).designs, task.layout
    )[0]


def test_free_building_succeeds_with_one_platform_of_all_blocks(rng):
    task = make_task("free_building")
    grid = task.draw(rng)
    grid.kind[:, :, 1:] = 0
    grid.kind[:, 0, 1] = BLOCK
    grid.kind[:, 1, 1] = BLOCK
    assert task.succeeded(grid)
    assert worth(task, grid) == 9
    grid.kind[0, 0, 1], grid.kind[4, 4, 1] = 0, BLOCK
    assert not task.succeeded(grid)


def test_the_barrier_pays_steps_arrival_and_time_as_the_paper_says(rng):
    task = make_task("breaking_barrier")
    before, after = np.array([-6.0, -5.0, -1.0, 0.0]), np.array([-5.0, -5.0, 0.0, 0.0])
    assert task.reward == Reward({"flag_nearness": 1.0, "flag_at_goal": 10.0, "tick": -1.0})
    assert worth(task, task.draw(rng)) == -5
    paid = task.reward.score([before], [after], np.arange(4), np.zeros(4, bool))
    assert paid.tolist() == [0, -1, 10, 9]


def test_a_carried_flag_counts_where_its_car_is_and_a_lost_one_is_far(rng):
    task = make_task("breaking_barrier")
    grid = task.draw(rng)
    grid.kind[4, 1, 1] = Kind.AIR
    grid.cars[0, CarField.LOAD] = Kind.FLAG
    assert worth(task, grid) == 0
    assert task.succeeded(grid)
    grid.cars[0, CarField.LOAD] = Kind.AIR
    assert worth(task, grid) < -10
    assert not task.succeeded(grid)


def test_complexity_counts_platform_storeys_and_ramps(scene):
    objects = [(BLOCK, (2, 3, 1)), (BLOCK, (2, 4, 1)), (BLOCK, (2, 4, 2)), (BODY, (3, 3, 1), 0)]
    assert _number("complexity", scene(objects)) == 1 + 1 + 1
    assert _number("complexity", scene(objects[1:])) == 0 + 1
    assert make_task("free_building", reward="complexity").reward == Reward({"complexity": 1.0})


def test_rewards_of_an_episode_add_up_to_the_change_of_worth(rng):
    for name in [name for name in TASK_NAMES if name != "breaking_barrier"]:
        task = make_task(name)
        episodes = Episodes(task, rng)
        start, total = worth(task, episodes.grid(0)), 0.0
        for _ in range(40):
            mask = episodes.legal()
            total += episodes.step((rng.random(mask.shape) * mask).argmax(-1)).reward[0]
        assert total == worth(task, episodes.grid(0)) - start


def test_an_episode_has_max_steps_and_two_more_ticks(rng):
    for max_steps in (0, 18):
        episodes = Episodes(make_task("strip", max_steps=max_steps), rng)
        dones = [episodes.step([[Action.STOP, Action.STOP]]).done[0] for _ in range(max_steps + 2)]
        assert dones == [False] * (max_steps + 1) + [True]
        episodes.reset()
        assert episodes.t[0] == 0
        assert not episodes.step([[Action.STOP, Action.STOP]]).done[0] or max_steps == 0


OWN = """\
area_length: 3
area_width: 3
area_height: 2
block_num: 2
slope_num: 0
smartcar_num: 1
"""


def test_a_task_of_ones_own_takes_a_few_lines(rng):
    def height(grids, designs=None, layout=None):
        return (grids.kind[..., 1:] == Kind.BLOCK).any(axis=(-3, -2)).sum(axis=-1)

    task = Task(
        name="tower",
        starts=(parse_blueprint(OWN, "tower.yaml"),),
        reward=Reward({PotentialTerm(height): 1.0}),
        success=lambda grid: height(grid) == 2,
        max_steps=30,
    )
    episodes = Episodes(task, rng)
    grid = episodes.grid(0)
    assert not task.succeeded(grid)
    grid.kind[1, 1, 1:] = BLOCK
    episodes.put(0, grid)
    steps = episodes.step([[Action.STOP]])
    assert (steps.reward, steps.success, steps.done) == (1.0, True, True)


def test_a_potential_a_goal_and_a_payment_of_ones_own_look_at_all_worlds_at_once(monkeypatch, rng):
    def blocks(grids, designs, layout):
        return (grids.kind == BLOCK).sum((1, 2, 3))

    monkeypatch.setitem(GOALS, "always", lambda grids, designs, layout: np.ones(len(grids), bool))

    def twice(before, after, t, given):
        return 2 * after

    reward = Reward({PotentialTerm(blocks, twice): 1.0})
    task = replace(make_task("strip"), reward=reward, success="always")
    steps = Episodes(task, rng, 3).step(np.full((3, 2), Action.STOP))
    assert steps.reward.tolist() == [8.0] * 3
    assert steps.done.all()


def test_what_cannot_be_a_task_is_told():
    def parts(starts):
        return "t", starts, Reward({"tick": 1.0}), lambda grid: False

    one, other = (parse_blueprint(OWN.replace("m: 2", f"m: {n}"), f"{n}.yaml") for n in (2, 1))
    for make, message in (
        (lambda: Task(*parts((one, other))), r"1\.yaml: .* must agree"),
        (lambda: Task(*parts(())), "at least one start file"),
        (lambda: make_task("stripe"), "did you mean 'strip'"),
        (lambda: make_task("strip", reward="papr"), "unknown reward 'papr'; did you mean 'paper'"),
        (
            lambda: Reward({"plattform": 1.0}),
            "unknown reward term 'plattform'; did you mean 'platform'",
        ),
        (lambda: Reward("platform"), "a reward is a mapping of terms and weights"),
        (lambda: Reward({}), "a reward is a mapping of terms and weights"),
        (lambda: Reward({"platform": "1"}), "the weight of the reward term 'platform' is '1'"),
        (lambda: Reward({"platform": np.nan}), "the weight of .* is nan; allowed: a finite number"),
        (
            lambda: replace(make_task("strip"), success="build"),
            "unknown goal 'build'; did you mean 'built'",
        ),
        (lambda: make_task("strip", max_steps=-1), "max_steps is -1"),
    ):
        with pytest.raises(InputError, match=message):
            make()


def test_a_reset_empties_the_helpers_queue_and_the_slope_state(rng):
    task = make_task("simple_two_story")
    episodes = Episodes(task, rng, 3, helper_depth=20)
    for _ in range(200):
        mask = episodes.reachable()
        episodes.step((rng.random(mask.shape) * mask).argmax(-1))
        if (episodes.queue >= 0).any(axis=(1, 2)).all():
            break
    assert (episodes.queue >= 0).any(axis=(1, 2)).all()
    kept = episodes.grid(2)
    episodes.reset([0, 1])
    assert (episodes.queue[:2] == -1).all()
    assert (episodes.queue[2] >= 0).any()
    assert episodes.grid(2).same_visible(kept)
    assert episodes.grid(0).same_visible(task.draw(rng))
    assert episodes.t.tolist()[:2] == [0, 0]


def test_a_batch_does_what_single_worlds_do(rng):
    for depth in (None, 10):
        for rule_set in ("published", "physical"):
            task = make_task("complex_two_story")
            batch = Episodes(task, np.random.default_rng(1), 5, rule_set, depth)
            singles = [
                Episodes(task, np.random.default_rng(1), 1, rule_set, depth) for _ in range(5)
            ]
            for _ in range(15):
                legal, reachable, vectors = batch.legal(), batch.reachable(), batch.vectors()
                mask = legal if depth is None else reachable
                actions = (rng.random(mask.shape) * mask).argmax(-1)
                order = batch.draw_order()
                steps = batch.step(actions, order)
                for i, single in enumerate(singles):
                    assert np.array_equal(single.legal()[0], legal[i])
                    assert np.array_equal(single.reachable()[0], reachable[i])
                    assert np.array_equal(single.vectors()[0], vectors[i])
                    step = single.step(actions[i : i + 1], order[i : i + 1])
                    for name in ("reward", "done", "success", "applied"):
                        assert np.array_equal(getattr(step, name)[0], getattr(steps, name)[i])
                    assert single.grid(0).same_visible(batch.grid(i))


def test_wrong_shapes_and_orders_are_refused(rng):
    episodes = Episodes(make_task("strip"), rng, 3)
    good, order = np.zeros((3, 2), int), np.tile([1, 0], (3, 1))
    episodes.step(good, order)
    for actions, turns in ((good[:2], order), (good[:, :1], order), (good, order[:2])):
        with pytest.raises(ValueError, match=r"must have shape \(3, 2\)"):
            episodes.step(actions, turns)
    for turns in (order * 0, order - 1, order + 1):
        with pytest.raises(ValueError, match="each of the cars 0 to 1 once"):
            episodes.step(good, turns)


def test_more_things_than_rows_are_told(scene):
    for kind in (Kind.BLOCK, Kind.FSLOPE):
        with pytest.raises(CraftsimError, match="more than the 0 slopes and 0 blocks announced"):
            entity_rows(
                scene([(kind, (3, 3, 1), 0)])[None],
                Layout(0, 0, 0, None, shows_flag=False),
                targets_of(None)[None],
            )


def test_a_cars_vector_is_its_own_row_and_then_all_rows(rng):
    episodes = Episodes(make_task("complex_two_story"), rng)
    vectors, layout = episodes.vectors()[0], episodes.layout
    assert vectors.shape == (4, layout.vector_length) == (4, 13 * (1 + 4 + 3 * 2 + 6 + 2))
    rows = episodes.entity_rows()[0]
    for car in range(4):
        assert vectors[car].tolist() == [*rows[car], *rows.ravel()]


def test_what_is_to_be_built_has_rows_as_things_there_would_have_and_is_marked():
    design = make_task("simple_two_story").design
    rows = dict(zip(design.targets, target_rows(targets_of(design)).tolist(), strict=True))
    assert {(target.kind, *row) for target, row in rows.items()} == {
        (Kind.BODY, 2, 2, 1, 0, 0, 1, 0, 0, 0, 1, 1, 1, 0),
        (Kind.FOOT, 2, 1, 1, 0, 0, 0, 1, 0, 0, 1, 1, 1, 0),
        (Kind.BLOCK, 2, 3, 1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0),
        (Kind.BLOCK, 2, 3, 2, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0),
    }
