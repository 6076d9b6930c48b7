"""The scripts for other trainers run, where their libraries are installed, and say what their texts promise."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import craftsim

TRAINERS = Path(__file__).parents[1] / "examples" / "trainers"
NEEDS = {
    "ppo": "torch",
    "torchrl_batched": "torchrl",
    "maskable_ppo": "sb3_contrib",
    "rllib": "ray.rllib.algorithms",
    "benchmarl_ippo": "benchmarl",
    "minari_dataset": "minari",
}
"""What each needs; some want other versions than craftsim's, and run in environments of their own only."""
SAYS = {
    "ppo": r"greedy success: 1\.00\n",
    "torchrl_batched": r"TorchRL: (?:[5-9]|\d{2,}),\d{3} frames",
}
"""What the output of some must match: the strip is learned; 5,000 frames a CPU second and more."""


def test_every_script_is_tested():
    assert {path.stem for path in TRAINERS.glob("*.py")} == set(NEEDS)


@pytest.mark.parametrize("name", NEEDS)
def test_a_script_runs_and_says_what_it_promises(name, tmp_path):
    """In a process of its own, as its reader starts it: its folder comes first where modules are looked for."""
    pytest.importorskip(NEEDS[name])
    words = [sys.executable, TRAINERS / f"{name}.py"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert re.search(SAYS.get(name, ""), done.stdout), done.stdout


def test_torchrl_is_told_what_the_batch_says():
    pytest.importorskip("torchrl")
    from torchrl.envs.utils import check_env_specs

    script = runpy.run_path(str(TRAINERS / "torchrl_batched.py"))
    env = script["BatchedEnv"]("strip", 4)
    check_env_specs(env)
    env.set_seed(3)
    actor, _ = script["masked_actor"](env)
    rollout = env.rollout(50, actor, break_when_any_done=False).detach()
    envs = craftsim.vector_env("strip", 4)
    observation, _ = envs.reset(seed=3)
    n_ended = 0
    for tick in range(50):
        step = rollout[:, tick]
        np.testing.assert_array_equal(step["agents", "observation"], envs.car_vectors())
        np.testing.assert_array_equal(step["agents", "action_mask"], observation["action_mask"])
        actions = step["agents", "action"].numpy()
        observation, reward, terminated, truncated, infos = envs.step(actions)
        later = step["next"]
        np.testing.assert_allclose(later["agents", "reward"][:, 1, 0], reward, rtol=1e-6)
        np.testing.assert_array_equal(later["terminated"][:, 0], terminated)
        np.testing.assert_array_equal(later["truncated"][:, 0], truncated)
        for world in range(4):
            state = observation["observation"][world]
            if terminated[world] or truncated[world]:
                state = infos["final_obs"][world]["observation"]
                n_ended += 1
            np.testing.assert_array_equal(later["state"][world], state)
    assert n_ended >= 8


def test_torchrl_is_told_which_worlds_can_be_reset():
    pytest.importorskip("torchrl")
    env = runpy.run_path(str(TRAINERS / "torchrl_batched.py"))["BatchedEnv"]("strip", 2)
    start = env.reset()
    start["_reset"] = start["done"] | True
    with pytest.raises(ValueError, match="whose episode has ended"):
        env.reset(start)


def test_torchrl_plays_in_physics():
    pytest.importorskip("torchrl")
    from torchrl.envs.utils import check_env_specs

    script = runpy.run_path(str(TRAINERS / "torchrl_batched.py"))
    env = script["BatchedEnv"]("strip", 2, "physics", workers=1, drive="wheels")
    check_env_specs(env)
    env.close()
    assert env.is_closed
