"""What is observed beside the rows: object choices, local views, entity sets, and camera images."""

from __future__ import annotations

from collections import deque
from contextlib import closing

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import craftsim
from craftsim.designs.tasks import with_reflections
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.envs import parallel_env, vector_env
from craftsim.envs.actions import ObjectChoice
from craftsim.envs.central import CentralConstruction
from craftsim.envs.observations import (
    FILLED,
    OWN,
    WHAT,
    Images,
    X,
    Y,
    Z,
    entity_sets,
    local_views,
    observe_entities,
)
from craftsim.errors import InputError
from craftsim.rendering.images import IMAGE_KINDS, take_images
from craftsim.tasks import as_task, make_task
from craftsim.tasks.asynchronous import BEGUN
from craftsim.testing import check_api, check_deterministic, random_policy

STOP, LIFT, DROP = int(Action.STOP), int(Action.LIFT), int(Action.DROP)
CONTINUE = len(Action)
EVERYWHERE = ObjectChoice(floor=True)
DRIVING = [*range(Action.ROTATE_LEFT, Action.MOVE_RIGHT + 1)]
SIZE = (32, 24)
EACH, SHARED = Images("front", SIZE, IMAGE_KINDS), Images("top", SIZE)
SHORT = make_task("strip", max_steps=0)
"""Two ticks an episode."""
MOVES = np.array([Action.MOVE_LEFT, Action.ROTATE_LEFT])


def _env(task, backend="grid", choice=EVERYWHERE, **options):
    return parallel_env(task, backend, helper_depth=20, object_choice=choice, **options)


@pytest.mark.parametrize("task", ["strip", "simple_two_story", "breaking_barrier"])
def test_the_forms_pass_the_tests_of_their_interfaces(task):
    options = {"helper_depth": 20, "object_choice": ObjectChoice(), "local_view": 2}
    check_api(lambda: parallel_env(task, "grid", **options))
    check_deterministic(lambda: parallel_env(task, "grid", **options), episodes=2)
    check_env(CentralConstruction(task, backend="grid", **options))


def _reached(grid, rules, car, radius):
    """Return, by a search in Python, the cells that a car could drive to without its load."""
    start = grid.copy()
    start.cars[car, CarField.LOAD] = Kind.AIR
    start.derive_marks()
    x, y = start.cars[car, :2].tolist()
    seen, rest = {tuple(start.cars[car, :4].tolist())}, deque([start])
    while rest:
        here = rest.popleft()
        for action in DRIVING:
            if rules.legal(here, car, action):
                after = rules.apply(here, car, action)
                pose = tuple(after.cars[car, :4].tolist())
                if pose not in seen and max(abs(pose[0] - x), abs(pose[1] - y)) <= radius:
                    seen.add(pose)
                    rest.append(after)
    return {pose[:3] for pose in seen}


@pytest.mark.parametrize(
    "choice", [ObjectChoice(radius=1), ObjectChoice(free=3, floor=True)], ids=str
)
def test_listed_are_the_objects_that_a_car_could_reach_in_the_order_of_their_cells(choice):
    env, act = _env("simple_two_story", choice=choice), random_policy(np.random.default_rng(0))
    for seed in range(3):
        observations, _ = env.reset(seed=seed)
        for _ in range(8):
            for car, seen in enumerate(observations.values()):
                reached = sorted(_reached(env.grid, env.core.rules, car, choice.radius))
                kinds = [env.grid.kind_at(cell) for cell in reached]
                groups = (
                    ((Kind.BLOCK,), 2),
                    ((Kind.FSLOPE, Kind.BODY), 1),
                    ((Kind.AIR,), choice.free),
                )
                expected = []
                for group, most in groups:
                    cells = [
                        cell
                        for cell, kind in zip(reached, kinds, strict=True)
                        if kind in group and (kind != Kind.AIR or choice.floor or cell[2] > 1)
                    ]
                    expected += (cells + [(0, 0, 0)] * most)[:most]
                np.testing.assert_array_equal(seen["choices"][:, :3], expected)
            observations = env.step(act(observations))[0]


@pytest.mark.parametrize("rule_set", ["physical", "published"])
def test_a_choice_that_is_offered_leads_a_car_there_and_nothing_but_continue_is_offered_meanwhile(
    rule_set,
):
    env, act = _env("simple_two_story", rule_set=rule_set), random_policy(np.random.default_rng(1))
    tried = 0
    for seed in range(4):
        observations, _ = env.reset(seed=seed)
        for _ in range(4):
            observations = env.step(act(observations))[0]
        before = env.grid
        for choice in range(len(observations["car_0"]["choices"])):
            seen = env.reset(seed=seed, options={"grid": before})[0]["car_0"]
            if not seen["action_mask"][CONTINUE + 1 + choice]:
                continue
            goal, action, ticks = seen["choices"][choice, :3].tolist(), CONTINUE + 1 + choice, 0
            while env.agents:
                seen, _, _, _, infos = env.step({"car_0": action, "car_1": STOP})
                assert not infos["car_0"]["illegal"]
                mask, action, ticks = seen["car_0"]["action_mask"], CONTINUE, ticks + 1
                if not mask[CONTINUE]:
                    break
                assert mask.sum() == 1
            else:
                continue
            assert env.grid.cars[0, :3].tolist() == goal
            tried += 1
    assert tried > 20


class Strip:
    """Builds the strip: each car in turn chooses a block, lifts it, chooses a free cell of the design, and drops it."""

    def __init__(self, env):
        self.env, self.turn = env, 0

    def __call__(self, observations):
        actions = {
            agent: self._act(car, seen) for car, (agent, seen) in enumerate(observations.items())
        }
        if actions[f"car_{self.turn}"] == DROP:
            actions[f"car_{self.turn}"], self.turn = DROP, 1 - self.turn
        return actions

    def _act(self, car, seen):
        mask, grid = seen["action_mask"], self.env.grid
        targets = [target.cell for target in self.env.core.task.design.targets]
        here, is_loaded = (
            tuple(grid.cars[car, :3].tolist()),
            grid.cars[car, CarField.LOAD] != Kind.AIR,
        )
        if mask[CONTINUE]:
            return CONTINUE
        if car != self.turn:
            return STOP
        if is_loaded and here in targets and mask[DROP]:
            return DROP
        if not is_loaded and here not in targets and mask[LIFT]:
            return LIFT
        for number, row in enumerate(seen["choices"]):
            cell = tuple(row[:3].tolist())
            wanted = cell in targets if is_loaded else cell not in targets
            is_kind = grid.kind_at(cell) == (Kind.AIR if is_loaded else Kind.BLOCK)
            if mask[CONTINUE + 1 + number] and wanted and is_kind:
                return CONTINUE + 1 + number
        self.turn = 1 - car  # the other one is in the way, or has more within reach
        return STOP


@pytest.mark.parametrize("backend", ["grid", "physics"])
def test_a_scripted_policy_builds_the_strip_by_object_choices(backend):
    with closing(_env(make_task("strip", max_steps=80), backend)) as env:
        policy = Strip(env)
        observations, _ = env.reset(seed=0)
        while env.agents:
            observations, _, _, _, infos = env.step(policy(observations))
            assert not any(info["illegal"] for info in infos.values())
        assert infos["car_0"]["success"]


def test_batches_offer_choices_and_views_and_show_the_last_ones_before_a_reset():
    options = {"helper_depth": 20, "object_choice": EVERYWHERE, "local_view": 1}
    envs = vector_env(make_task("simple_two_story", max_steps=3), 4, **options)
    rng, ended = np.random.default_rng(0), 0
    observations, _ = envs.reset(seed=0)
    masks, before = observations["action_mask"], envs.episodes.grids.copy()
    unoffered = masks.shape[-1] - 1 - (masks == 0)[..., ::-1].argmax(-1)
    assert (unoffered > CONTINUE).all()
    assert envs.step(unoffered)[4]["illegal"].all()
    np.testing.assert_array_equal(before.cars, envs.episodes.grids.cars)
    observations, _ = envs.reset(seed=0)
    for _ in range(12):
        assert envs.observation_space.contains(observations)
        last = observations
        chosen = (rng.random(last["action_mask"].shape) * last["action_mask"]).argmax(-1)
        queued = last["action_mask"][..., CONTINUE] == 1
        assert (last["action_mask"].sum(-1)[queued] == 1).all()
        observations, *_, infos = envs.step(chosen)
        for world in np.flatnonzero(infos.get("_final_obs", [])):
            ended += 1
            assert envs.single_observation_space.contains(infos["final_obs"][world])
    assert ended == 8
    with closing(vector_env("strip", 2, "physics", workers=1, **options)) as physics:
        seen, _ = physics.reset(seed=0)
        assert physics.observation_space.contains(seen)


def test_a_local_view_shows_the_cells_around_each_car():
    task = make_task("simple_two_story")
    env, act = parallel_env(task, "grid", local_view=2), random_policy(np.random.default_rng(0))
    observations, _ = env.reset(seed=0)
    for _ in range(10):
        grid = env.grid
        design = {target.cell: target.kind for target in task.design.targets}
        cars = {tuple(row[:3].tolist()): car for car, row in enumerate(grid.cars)}
        for car, seen in enumerate(observations.values()):
            for place in np.ndindex(seen["local_view"].shape[:3]):
                x, y, z = cell = tuple(
                    (grid.cars[car, :3] * (1, 1, 0) + place - (2, 2, -1)).tolist()
                )
                found, other = seen["local_view"][place], cars.get(cell)
                outside = not (0 <= x < grid.size[0] and 0 <= y < grid.size[1])
                there = (
                    Kind.WALL if outside else Kind.AIR if z > grid.size[2] else grid.kind_at(cell)
                )
                assert found[0] == there
                row = (
                    [0, 0, 0] if other is None else [1 + (other == car), *grid.cars[other, [3, 4]]]
                )
                assert found[2:5].tolist() == row
                assert found[5] == design.get(cell, Kind.AIR)
        observations = env.step(act(observations))[0]
    far = Grid.empty((2, 2, 1), n_cars=0)
    assert local_views(far[None], np.zeros((1, 0, 5), np.int64), 1).shape == (1, 0, 3, 3, 2, 6)


def test_a_choice_that_a_running_action_stands_against_is_not_offered():
    task = make_task("strip", max_steps=20)
    env = craftsim.env(
        task, "grid", execution="asynchronous", helper_depth=20, object_choice=EVERYWHERE
    )
    rng, core, withheld = np.random.default_rng(0), env.core, 0
    for seed in range(10):
        env.reset(seed)
        while core.turns:
            car, mask = core.turns[0], env.observe(env.agent_selection)["action_mask"]
            free = core.episodes.some(np.array([0]))
            free.running.n_claims[:] = 0
            withheld += int((core.form.masks(free)[0, car] > mask)[CONTINUE + 1 :].sum())
            action = int(rng.choice(np.flatnonzero(mask)))
            env.step(action)
            if action > CONTINUE:
                assert core.episodes.running.outcome[0, car] == BEGUN
    assert withheld


def _sorted(rows):
    return rows[np.lexsort(rows.T)]


def test_in_the_cars_frame_a_turned_world_looks_the_same():
    task = as_task("designs")
    starts = task.draw_starts(np.random.default_rng(0), 8)
    turned = with_reflections(starts)
    seen = entity_sets(turned.grids, task.layout, turned.designs)
    for turn in (16, 32, 48):  # the reflected ones stand between
        for i in range(8):
            for car in range(2):
                np.testing.assert_array_equal(_sorted(seen[i, car]), _sorted(seen[turn + i, car]))
    on_map = entity_sets(turned.grids, task.layout, turned.designs, "map")
    assert any((_sorted(on_map[i, 0]) != _sorted(on_map[16 + i, 0])).any() for i in range(8))


def test_own_row_stands_at_the_origin_and_nothing_beyond_the_radius_is_seen():
    task = as_task("designs")
    starts = task.draw_starts(np.random.default_rng(1), 8)
    everything = entity_sets(starts.grids, task.layout, starts.designs)
    near = entity_sets(starts.grids, task.layout, starts.designs, radius=1)
    own = everything[everything[..., OWN] == 1]
    assert len(own) == 16
    assert not own[:, X : Z + 1].any()
    far = np.abs(everything[..., [X, Y]]).max(-1) > 1
    assert far.any()
    assert not near[far].any()
    np.testing.assert_array_equal(near[~far], everything[~far])


def test_cells_of_the_design_are_filled_exactly_when_it_is_built_within_their_space():
    task = as_task("strip")
    grid = task.draw(np.random.default_rng(0))
    targets = observe_entities(task).of(grid, 0)[task.layout.n_rows - 1 :]
    assert (targets[:, WHAT] > 0).all()
    built = [grid.kind[target.cell] == target.kind for target in task.design.targets]
    assert targets[:, FILLED].sum() == sum(built) < len(built)
    env = parallel_env("strip", "grid", observe=observe_entities(task, "map", 2))
    seen, _ = env.reset(seed=0)
    assert env.observation_space("car_0").contains(seen["car_0"])


@pytest.mark.parametrize(
    ("task", "bad", "said"),
    [
        ("strip", {"frame": "world"}, "there are car, map"),
        ("strip", {"radius": -1}, "allowed: None, or 0"),
        ("designs", {}, "design of its own"),
    ],
)
def test_entity_sets_that_make_no_sense_are_refused(task, bad, said):
    with pytest.raises(InputError, match=said):
        observe_entities(as_task(task), **bad)


@pytest.mark.usefixtures("rendering")
def test_each_agent_sees_through_its_own_camera_what_the_site_holds():
    with closing(parallel_env("strip", images=EACH)) as cars:
        seen = cars.reset(seed=0)[0]
        before = seen["car_1"]["rgb"].copy()
        for tick in range(2):
            physics = cars.core.backend.judge.physics
            for car, agent in enumerate(cars.agents):
                assert cars.observation_space(agent).contains(seen[agent])
                for kind, array in take_images(physics, f"front:{car}", SIZE).items():
                    np.testing.assert_array_equal(seen[agent][kind], array)
            if tick == 0:
                seen = cars.step(dict(zip(cars.agents, MOVES.tolist(), strict=True)))[0]
        assert (seen["car_1"]["rgb"] != before).any()


@pytest.mark.usefixtures("rendering")
def test_batches_have_the_images_of_single_environments_in_several_processes():
    singles = [CentralConstruction(SHORT, images=EACH) for _ in range(2)]
    expected = [single.reset(seed=3 + world)[0] for world, single in enumerate(singles)]
    with closing(vector_env(SHORT, 2, "physics", workers=2, images=EACH)) as envs:
        seen = envs.reset(seed=3)[0]
        assert envs.observation_space.contains(seen)
        assert seen["rgb"].shape == (2, 2, 24, 32, 3)
        for tick in range(2):
            for world, single in enumerate(singles):
                for kind in IMAGE_KINDS:
                    np.testing.assert_array_equal(seen[kind][world], expected[world][kind])
                expected[world] = single.step(MOVES)[0]
            seen, _, _, truncated, infos = envs.step(np.tile(MOVES, (2, 1)))
            assert truncated.all() == (tick == 1)
        for world, single in enumerate(singles):
            np.testing.assert_array_equal(infos["final_obs"][world]["rgb"], expected[world]["rgb"])
            np.testing.assert_array_equal(seen["rgb"][world], single.reset()[0]["rgb"])
            single.close()


@pytest.mark.usefixtures("rendering")
def test_all_cars_get_the_same_images_of_one_of_the_worlds_cameras_and_the_interfaces_hold():
    with closing(parallel_env(SHORT, images=SHARED)) as cars:
        seen = cars.reset(seed=0)[0]
        np.testing.assert_array_equal(seen["car_0"]["rgb"], seen["car_1"]["rgb"])
        with closing(CentralConstruction(SHORT, images=SHARED)) as central:
            np.testing.assert_array_equal(central.reset(seed=0)[0]["rgb"], seen["car_0"]["rgb"])
    cars = parallel_env(SHORT, images=EACH)
    check_api(lambda: cars, cycles=2)
    check_env(CentralConstruction(SHORT, images=EACH), skip_render_check=True)
