"""Images as observations: each car's own camera, in every form of the environment and in any number of processes."""

from contextlib import closing

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from craftsim.discrete.kinds import Action
from craftsim.discrete.tasks import make_task
from craftsim.envs import parallel_env, vector_env
from craftsim.envs.central import CentralConstruction
from craftsim.envs.observations import Images
from craftsim.rendering.images import IMAGE_KINDS, take_images
from craftsim.testing import check_api

pytestmark = pytest.mark.usefixtures("rendering")

SIZE = (32, 24)
OWN, SHARED = Images("front", SIZE, IMAGE_KINDS), Images("top", SIZE)
SHORT = make_task("strip", max_steps=0)
"""Two ticks an episode."""
MOVES = np.array([Action.MOVE_LEFT, Action.ROTATE_LEFT])


def test_each_agent_sees_through_its_own_camera_what_the_site_holds():
    with closing(parallel_env("strip", images=OWN)) as cars:
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


def test_batches_have_the_images_of_single_environments_in_several_processes():
    singles = [CentralConstruction(SHORT, images=OWN) for _ in range(2)]
    expected = [single.reset(seed=3 + world)[0] for world, single in enumerate(singles)]
    with closing(vector_env(SHORT, 2, "physics", workers=2, images=OWN)) as envs:
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


def test_all_cars_get_the_same_images_of_one_of_the_worlds_cameras():
    with closing(parallel_env(SHORT, images=SHARED)) as cars:
        seen = cars.reset(seed=0)[0]
        np.testing.assert_array_equal(seen["car_0"]["rgb"], seen["car_1"]["rgb"])
        with closing(CentralConstruction(SHORT, images=SHARED)) as central:
            np.testing.assert_array_equal(central.reset(seed=0)[0]["rgb"], seen["car_0"]["rgb"])


def test_the_checks_of_pettingzoo_and_gymnasium_pass():
    cars = parallel_env(SHORT, images=OWN)
    check_api(lambda: cars, cycles=2)
    check_env(CentralConstruction(SHORT, images=OWN), skip_render_check=True)


def test_without_images_nothing_is_rendered():
    with closing(parallel_env("strip")) as cars:
        seen = cars.reset(seed=0)[0]["car_0"]
        assert seen.keys() == {"observation", "action_mask"}
        assert cars.core.images == {}
