"""Tasks that vary, in all forms of the environment and on both backends."""

from contextlib import closing

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from craftsim.cli import main
from craftsim.discrete.tasks import as_task
from craftsim.envs import GYMNASIUM_IDS, env, parallel_env, vector_env
from craftsim.errors import InputError


@pytest.mark.parametrize("task", ["random_strip", "designs"])
def test_the_gymnasium_form_obeys_its_own_checker(task):
    check_env(gymnasium.make(GYMNASIUM_IDS[task], backend="grid").unwrapped)


@pytest.mark.parametrize("task", ["random_strip@test", "designs@test"])
def test_one_episode_starts_as_another_and_the_same_seed_as_before(task):
    one, other = parallel_env(task, "grid"), parallel_env(task, "grid")
    starts = [one.reset(seed=seed)[0]["car_0"]["observation"] for seed in (0, 1, 0)]
    assert np.array_equal(starts[0], starts[2])
    assert not np.array_equal(starts[0], starts[1])
    assert np.array_equal(other.reset(seed=0)[0]["car_0"]["observation"], starts[0])
    turns = env(task, "grid")
    turns.reset(seed=0)
    assert np.array_equal(turns.observe("car_0")["observation"], starts[0])


def test_a_batch_of_worlds_varies_and_goes_on_with_other_starts():
    envs = vector_env("designs", 6)
    first = envs.reset(seed=0)[0]["observation"]
    assert len({row.tobytes() for row in first}) == 6
    designs = envs.episodes.designs.copy()
    for _ in range(envs.task.max_steps + 2):
        envs.step(np.full((6, 2), 14))
    assert not np.array_equal(envs.episodes.designs, designs)


def test_an_episode_shows_its_own_design_and_a_given_start_needs_one():
    made = parallel_env("designs", "grid")
    made.reset(seed=0)
    first, played = made.core.episodes.designs.copy(), made.core.played
    assert first.shape == (1, 8, 5)
    grid, design = made.core.grid, played.design
    made.reset(seed=1)
    assert not np.array_equal(first, made.core.episodes.designs)
    made.reset(options={"grid": grid, "design": design})
    assert np.array_equal(first, made.core.episodes.designs)
    with pytest.raises(InputError, match="give the option 'design'"):
        made.reset(options={"grid": grid})
    with pytest.raises(InputError, match="has its own goal"):
        parallel_env("strip", "grid").reset(
            options={"grid": as_task("strip").draw(np.random.default_rng(0)), "design": design}
        )


def test_physics_starts_as_the_grid_does_and_marks_the_design_of_the_episode():
    with closing(parallel_env("designs", "physics")) as real:
        grid = parallel_env("designs", "grid")
        for seed in (0, 1):
            real.reset(seed=seed)
            grid.reset(seed=seed)
            assert real.core.grid.same_visible(grid.core.grid)
            assert real.core.backend.recipe.goals == tuple(real.core.played.goal_cells)
        *_, infos = real.step(dict.fromkeys(real.agents, 14))
        assert not any(info["problems"] for info in infos.values())


def test_show_names_a_task_that_varies(capsys):
    assert main(["show", "designs@test", "--seed", "3"]) == 0
    assert "6 x 6 cells, 2 levels: 2 cars" in capsys.readouterr().out
