"""A reward that is a function of a tick, on either backend; tasks of one's own in Gymnasium; masks for MaskablePPO."""

from contextlib import closing
from dataclasses import replace

import gymnasium
import numpy as np
import pettingzoo
import pytest
from registered import forget

import craftsim
import craftsim.envs
from craftsim import Action
from craftsim.discrete.schedule import nominal_durations
from craftsim.errors import InputError
from craftsim.tasks import make_task, register_task
from craftsim.tasks.rewards import Reward
from craftsim.tasks.starts import targets_of


@pytest.fixture
def free_names():
    yield
    forget()


class Watch:
    """A term that keeps what it has seen, and rewards cars that moved."""

    def __init__(self):
        self.seen = []

    def __call__(self, tick):
        self.seen.append(tick)
        moved = (tick.before.cars[..., :3] != tick.after.cars[..., :3]).any(axis=-1)
        return 2.0 * moved.sum(axis=1) - tick.duration_s


def _task(reward):
    return replace(make_task("strip"), name="own_strip", reward=Reward({reward: 1.0}))


def test_on_the_grid_a_reward_sees_actions_and_nominal_times():
    watch = Watch()
    env = craftsim.parallel_env(_task(watch), "grid")
    env.reset(seed=0)
    _, rewards, _, _, infos = env.step({"car_0": int(Action.MOVE_RIGHT), "car_1": int(Action.LIFT)})
    (first,) = watch.seen
    assert (first.t, first.actions.tolist()) == (0, [[Action.MOVE_RIGHT, Action.LIFT]])
    assert first.verdicts.tolist() == [[None, None]]
    assert (first.contacts, first.attempts, first.problems) == ((None,), ((None, None),), ((),))
    assert first.duration_s == first.durations_s.max() == infos["car_0"]["duration_s"]
    assert first.durations_s[0, 0] == pytest.approx(nominal_durations()[Action.MOVE_RIGHT, 0])
    assert rewards["car_0"] == 2.0 - first.duration_s[0]
    assert np.array_equal(first.designs[0], targets_of(make_task("strip").design))
    assert first.layout == make_task("strip").layout


def test_in_physics_it_sees_verdicts_times_and_contacts():
    watch = Watch()
    env = craftsim.parallel_env(_task(watch), "physics", check_contacts=True)
    env.reset(seed=0)
    env.step({"car_0": int(Action.MOVE_RIGHT), "car_1": int(Action.LIFT)})
    (tick,) = watch.seen
    assert tick.actions.tolist() == [[Action.MOVE_RIGHT, Action.LIFT]]
    assert tick.verdicts[0, 0] == "as predicted"
    assert tick.attempts[0][0].action == "MOVE_RIGHT"
    assert tick.applied[0, 0]
    assert tick.durations_s[0, 0] == tick.attempts[0][0].duration_s > 0
    touching = [{contact.first, contact.second} for contact in tick.contacts[0]]
    assert {"car 0", "ground"} in touching
    assert tick.after.cars[0, 0, 0] == tick.before.cars[0, 0, 0] + 1
    plain = craftsim.parallel_env(_task(watch), "physics")
    plain.reset(seed=0)
    plain.step({"car_0": int(Action.STOP), "car_1": int(Action.STOP)})
    assert watch.seen[-1].contacts == (None,)


def test_a_batch_is_scored_at_once():
    watch = Watch()
    envs = craftsim.vector_env(_task(watch), 4)
    observations, _ = envs.reset(seed=0)
    actions = np.full((4, 2), int(Action.STOP))
    actions[:, 0] = int(Action.MOVE_RIGHT)
    _, rewards, _, _, infos = envs.step(actions)
    (tick,) = watch.seen
    moved = (tick.before.cars[..., :3] != tick.after.cars[..., :3]).any(axis=(1, 2))
    assert rewards.tolist() == [
        2.0 * m - s for m, s in zip(moved, infos["duration_s"], strict=True)
    ]
    assert envs.action_masks().shape == (4, 30)
    assert np.array_equal(
        envs.action_masks().reshape(observations["action_mask"].shape), envs._masks == 1
    )


@pytest.mark.parametrize("value", [None, np.nan, "much", 1.0, [1.0, 2.0], [np.inf]])
def test_a_reward_that_is_no_number_is_refused(value):
    env = craftsim.parallel_env(_task(lambda tick: value), "grid")
    env.reset(seed=0)
    with pytest.raises(InputError, match="must return a finite number"):
        env.step({"car_0": 10, "car_1": 10})
    with pytest.raises(InputError, match="reward must be a Reward, such as"):
        replace(make_task("strip"), reward=lambda tick: tick.duration_s)


def test_a_registered_task_has_an_id_of_its_own_in_gymnasium_and_pettingzoo(free_names, recwarn):
    task = register_task(_task(Watch()))
    assert craftsim.envs.TASK_IDS["own_strip"] == "craftsim/OwnStrip-v0"
    env = gymnasium.make("craftsim/OwnStrip-v0", backend="grid")
    assert env.unwrapped.core.task.name == task.name
    assert gymnasium.make_vec("craftsim/OwnStrip-v0", num_envs=2).num_envs == 2
    register_task(replace(task, max_steps=3))
    assert gymnasium.make("craftsim/OwnStrip-v0", backend="grid").unwrapped.core.task.max_steps == 3
    env = pettingzoo.make("parallel", "craftsim/OwnStrip-v0", backend="grid")
    assert (env.core.task.name, env.core.task.max_steps) == ("own_strip", 3)
    assert not [warning for warning in recwarn if "Overriding" in str(warning.message)]
    with pytest.raises(InputError, match="the task 'own_strip' is craftsim/OwnStrip-v0 already"):
        register_task(replace(task, name="own_strip_"))
    with pytest.raises(InputError, match="the task 'strip' is craftsim/Strip-v0 already"):
        register_task(replace(task, name="Strip"))


def test_masks_are_flat_as_sb3_contrib_asks_for_them():
    env = gymnasium.make("craftsim/Strip-v0", backend="grid")
    observation, _ = env.reset(seed=0)
    masks = env.get_wrapper_attr("action_masks")()
    assert (masks.dtype, masks.shape) == (np.bool_, (env.action_space.nvec.sum(),))
    assert np.array_equal(masks, observation["action_mask"].ravel() == 1)
    with closing(craftsim.vector_env("strip", 2, "physics", workers=1)) as envs:
        observations, _ = envs.reset(seed=0)
        assert np.array_equal(envs.action_masks(), observations["action_mask"].reshape(2, -1) == 1)
