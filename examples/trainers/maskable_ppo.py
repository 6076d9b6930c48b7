"""MaskablePPO of sb3-contrib: one agent acts for all cars."""

import gymnasium
import numpy as np
from sb3_contrib import MaskablePPO

import craftsim.envs  # noqa: F401  (registers the environments)

env = gymnasium.make("craftsim/Strip-v0", backend="grid")
model = MaskablePPO("MultiInputPolicy", env, n_steps=64, batch_size=32, seed=0, device="cpu")
model.learn(total_timesteps=64)

observation, info = env.reset(seed=1)
actions, _ = model.predict(
    observation, action_masks=env.get_wrapper_attr("action_masks")(), deterministic=True
)
assert info["action_mask"][np.arange(2), actions].all()
