"""MaskablePPO of sb3-contrib: one agent acts for all cars."""

import gymnasium
import numpy as np
from gymnasium.wrappers import TransformObservation
from sb3_contrib import MaskablePPO
from sb3_contrib.common.wrappers import ActionMasker

import craftsim.envs  # noqa: F401  (registers the environments)

env = gymnasium.make("craftsim/Strip-v0", backend="grid")
env = TransformObservation(
    env, lambda seen: seen["observation"], env.observation_space["observation"]
)
env = ActionMasker(env, lambda env: env.unwrapped.core.masks.astype(bool).ravel())
model = MaskablePPO("MlpPolicy", env, n_steps=64, batch_size=32, seed=0, device="cpu")
model.learn(total_timesteps=64)

observation, info = env.reset(seed=1)
mask = info["action_mask"].astype(bool)
actions, _ = model.predict(observation, action_masks=mask.ravel(), deterministic=True)
assert mask[np.arange(2), actions].all()
