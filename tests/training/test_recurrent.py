"""Recurrent policies: what is learnt from is what was acted by, and each episode begins without a memory."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from craftsim.cli import main
from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.tasks import make_task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.envs import parallel_env
from craftsim.errors import InputError
from craftsim.training.config import TrainConfig
from craftsim.training.evaluation import choose_actions
from craftsim.training.policy import load_policy
from craftsim.training.trainer import Trainer


@pytest.fixture(scope="module")
def trained():
    trainer = Trainer(TrainConfig("strip", "vdn", worlds=6, width=8, recurrent=True))
    steps = 2 * trainer.steps_an_iteration
    list(trainer.run(steps, until=2.0))
    return trainer


def test_values_to_learn_from_are_those_of_acting_tick_by_tick(trained):
    net, rollout = trained.learner.net, trained.play(1)
    rollout = replace(rollout, done=torch.rand(rollout.done.shape, generator=torch.manual_seed(0)) < 0.1)
    memory, found, ends = net.memory(*rollout.actions.shape[1:]), [], []
    with torch.no_grad():
        now, after = net.of_rollouts(rollout)
        for t, actions in enumerate(rollout.actions):
            found.append(net(rollout.now[t], memory))
            memory.last.copy_(actions)
            ends.append(net(rollout.after[t], type(memory)(memory.hidden.clone(), memory.last)))
            memory.forget(rollout.done[t])
    torch.testing.assert_close(now, torch.stack(found))
    torch.testing.assert_close(after, torch.stack(ends))
    goes_on = ~rollout.done[:-1]
    torch.testing.assert_close(after[:-1][goes_on], now[1:][goes_on])
    assert net.of_rollouts(rollout)[0].requires_grad


def test_a_policy_forgets_the_episode_before(trained, tmp_path):
    trained.save(tmp_path)
    policy, env, episodes = load_policy(tmp_path), parallel_env("strip", "grid"), []
    torch.manual_seed(0)
    for weight in policy.net.parameters():
        weight.data.normal_()  # so that what is remembered decides
    for _ in range(2):
        observations, done = env.reset(seed=3)[0], []
        while env.agents:
            done.append(policy(observations))
            observations = env.step(done[-1])[0]
        episodes.append(done)
    assert episodes[0] == episodes[1]
    worlds = Episodes(make_task("strip"), np.random.default_rng(0), 1)
    memory, first = trained.learner.net.memory(1, worlds.n_cars), []
    looks = enumerate(zip(worlds.vectors()[0], worlds.offered()[0], strict=True))
    seen = {f"car_{car}": {"observation": row, "action_mask": mask} for car, (row, mask) in looks}
    for _ in range(2):
        policy.reset()
        first.append(policy(seen))
    assert first[0] == first[1]
    assert [*first[0].values()] == choose_actions(
        policy.net, worlds.vectors(), worlds.offered(), memory=memory
    )[0].tolist()
    assert (memory.last < N_ACTIONS).all()


def test_policies_that_learnt_values_are_evaluated_on_the_grid(trained, tmp_path):
    trained.save(tmp_path)
    words = ["validate", "strip", "--backend", "grid", "--trials", "2", "--policy"]
    assert main([*words, str(tmp_path), "--out", str(tmp_path / "out")]) == 0


def test_settings_of_a_command_may_be_true_or_false(tmp_path):
    words = ["--steps", "80", "--set", "recurrent=true", "worlds=1", "width=4", "--episodes", "1", "--out"]
    assert main(["train", "strip", "--algo", "vdn", *words, str(tmp_path)]) == 0
    assert load_policy(tmp_path).net.recurrent


def test_other_algorithms_have_no_memory():
    with pytest.raises(InputError, match=r"ippo has no recurrent policy.*iql, vdn, qmix, qtran"):
        TrainConfig("strip", recurrent=True)
