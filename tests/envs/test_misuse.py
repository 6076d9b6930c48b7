"""Wrong starts, seeds and actions are refused in words that say what is allowed, and change nothing."""

import gymnasium
import numpy as np
import pytest

from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.tasks import make_task
from craftsim.envs import GYMNASIUM_IDS, parallel_env
from craftsim.envs.vector import GridVectorEnv
from craftsim.errors import InputError

STOP = int(Action.STOP)


def _start(change):
    grid = make_task("strip").draw(np.random.default_rng(0))
    change(grid)
    return grid


def _one_block_more(grid):
    grid.kind[0, 0, 1] = Kind.BLOCK


def _a_slope(grid):
    grid.cars[0, 4] = Kind.FSLOPE


def _a_car_outside(grid):
    grid.cars[1, 0] = 77


def test_starts_that_do_not_fit_are_refused_and_the_next_reset_works():
    for options, words in [
        ({"grid": "strip"}, "must be a Grid"),
        ({"grid": Grid.empty((3, 3, 2), 2)}, r"task 'strip' has \(4, 4, 3\)"),
        ({"grid": Grid.empty((4, 4, 3), 3)}, "3 cars"),
        ({"grid": _start(_one_block_more)}, "has 5 blocks; task 'strip' observes at most 4"),
        ({"grid": _start(_a_slope)}, "has 1 slopes"),
        ({"grid": _start(_a_car_outside)}, r"car 1 is at \(77, 3, 1\)"),
        ({"blueprint": "no-such-file.yaml"}, "no such file"),
        ({"blueprint": 3}, "must be a path"),
        ({"grid": _start(lambda grid: None), "blueprint": "strip.yaml"}, "give one of them"),
    ]:
        env = parallel_env("strip", "grid")
        with pytest.raises(InputError, match=words):
            env.reset(seed=0, options=options)
        env.reset(seed=0)
        assert env.grid.same_visible(_start(lambda grid: None))


@pytest.mark.parametrize("seed", [-1, "one"])
def test_a_seed_is_a_whole_number_from_0(seed):
    with pytest.raises(InputError, match="the seed is"):
        parallel_env("strip", "grid").reset(seed=seed)


def test_stored_starts_are_held_to_the_same():
    with pytest.raises(InputError, match="outside the map"):
        make_task("strip").starting_from([_start(_a_car_outside)])


def _central():
    return gymnasium.make(GYMNASIUM_IDS["strip"], backend="grid").unwrapped


@pytest.mark.parametrize(
    "make", [lambda: parallel_env("strip", "grid"), _central], ids=["parallel", "central"]
)
def test_before_a_reset_and_after_the_end_a_reset_is_asked_for(make):
    env = make()
    stop = {"car_0": STOP, "car_1": STOP} if hasattr(env, "possible_agents") else [STOP, STOP]
    for act in (lambda: env.step(stop), lambda: env.core.grid, lambda: env.core.state()):
        with pytest.raises(InputError, match=r"reset\(\)"):
            act()
    env.reset(seed=0)
    for _ in range(20):
        env.step(stop)
    with pytest.raises(InputError, match=r"the episode is over; call reset\(\)"):
        env.step(stop)
    env.reset()
    env.step(stop)


def test_actions_that_are_none_are_refused_and_change_nothing():
    for actions, words in [
        ([STOP], r"shape \(2,\), not \(1,\)"),
        ([[STOP], [STOP, STOP]], r"shape \(2,\)"),
        ([-1, STOP], "0 to 14"),
        ([15, STOP], "0 to 14"),
        ([1.5, STOP], "whole numbers"),
        (["LIFT", "STOP"], "whole numbers"),
    ]:
        env = _central()
        env.reset(seed=0)
        before = env.core.grid
        with pytest.raises(InputError, match=words):
            env.step(actions)
        assert env.core.grid.same_visible(before)
        envs = GridVectorEnv("strip", 1)
        envs.reset(seed=0)
        with pytest.raises(InputError, match=words.replace("2,", "1, 2").split(", not")[0]):
            envs.step([actions])


def test_every_agent_needs_an_action():
    env = parallel_env("strip", "grid")
    env.reset(seed=0)
    with pytest.raises(InputError, match="no action for car_1"):
        env.step({"car_0": STOP})
    with pytest.raises(InputError, match="must be a dictionary"):
        env.step([STOP, STOP])
    with pytest.raises(InputError, match="0 to 14"):
        env.step({"car_0": 15, "car_1": STOP})


def test_a_batch_of_grid_worlds_begins_with_a_reset():
    envs = gymnasium.make_vec(GYMNASIUM_IDS["strip"], 2, backend="grid")
    with pytest.raises(InputError, match=r"reset\(\)"):
        envs.step(np.full((2, 2), STOP))
