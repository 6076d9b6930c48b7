"""A reward of your own, which sees what happened in a tick: actions, verdicts, durations, contacts.

The task has its own Gymnasium id, and ``action_masks()`` is what MaskablePPO of sb3-contrib asks an environment for.
"""

from dataclasses import replace

import gymnasium
import numpy as np

import craftsim
import craftsim.envs  # registers tasks with Gymnasium
from craftsim import Action
from craftsim.tasks.rewards import Transition


def careful_work(tick: Transition) -> float:
    """Return a point for each block that was put down, less time, and much less for what goes wrong in physics."""
    reward = -0.1 * tick.duration_s
    reward += sum(
        applied
        for action, applied in zip(tick.actions, tick.applied, strict=True)
        if action == Action.DROP
    )
    reward -= 5.0 * sum(verdict not in (None, "as predicted") for verdict in tick.verdicts)
    for contact in tick.contacts or ():  # None on the grid
        if contact.first.startswith("car") and contact.second.startswith("car"):
            reward -= contact.peak_n
    return reward


TASK = replace(craftsim.make_task("strip"), name="careful_strip", reward=careful_work)
craftsim.register_task(TASK)

if __name__ == "__main__":
    for backend in ("grid", "physics"):
        options = {"check_contacts": True} if backend == "physics" else {}
        env = gymnasium.make("craftsim/CarefulStrip-v0", backend=backend, **options)
        rng = np.random.default_rng(3)
        env.reset(seed=3)
        total = 0.0
        for _ in range(8):
            masks = env.get_wrapper_attr("action_masks")()  # (30,): two cars, 15 actions each
            chosen = [rng.choice(np.flatnonzero(mask)) for mask in masks.reshape(2, -1)]
            _, reward, terminated, truncated, _ = env.step(np.array(chosen))
            total += reward
        print(f"{backend}: {total:.2f} in 8 ticks")
        env.close()
