"""The TorchRL environment plays the same worlds as the grid's episodes, and keeps what it handed out."""

import numpy as np
import torch
from torchrl.envs.utils import check_env_specs

from craftsim.discrete.grid import CarField
from craftsim.discrete.kinds import Action
from craftsim.discrete.tasks import make_task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.training.grid_env import GridEnv


def test_it_keeps_to_its_specs():
    check_env_specs(GridEnv(make_task("simple_two_story"), 4))


def test_a_rollout_is_what_the_episodes_do():
    task = make_task("simple_two_story", max_steps=3)
    env, twin = GridEnv(task, 8), Episodes(task, np.random.default_rng(5), 8)
    env.set_seed(5)
    choices = np.random.default_rng(0)

    def random_legal(tensordict):
        mask = tensordict["agents", "action_mask"].numpy()
        tensordict["agents", "action"] = torch.from_numpy((choices.random(mask.shape) * mask).argmax(-1))
        return tensordict

    played = env.rollout(12, random_legal, break_when_any_done=False)
    twin.reset()
    for t in range(12):
        tick = played[:, t]
        assert np.array_equal(tick["agents", "observation"].numpy(), twin.vectors())
        assert np.array_equal(tick["agents", "action_mask"].numpy(), twin.offered())
        steps = twin.step(tick["agents", "action"].numpy())
        assert np.allclose(tick["next", "reward"][:, 0].numpy(), steps.reward)
        assert np.array_equal(tick["next", "done"][:, 0].numpy(), steps.done)
        assert np.array_equal(tick["next", "agents", "observation"].numpy(), twin.vectors())
        twin.reset(steps.done.nonzero()[0])
    assert played["next", "truncated"].sum() == 8 * 2  # every five ticks, though worlds are reset meanwhile


def test_a_car_that_can_do_nothing_is_offered_stop():
    task = make_task("simple_two_story")
    episodes = Episodes(task, np.random.default_rng(0), 1)
    cars = episodes.grids.cars
    cars[0, 0, [CarField.YAW, CarField.SLOPE]] = 2, 1  # as if on a slope that leads up to the edge of the map
    assert not episodes.legal()[0, 0].any()
    assert episodes.offered()[0, 0].nonzero()[0].tolist() == [Action.STOP]
