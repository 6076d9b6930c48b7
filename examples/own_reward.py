"""A reward of your own, of terms that see what happened in a tick: actions, verdicts, durations, contacts.

The task has its own Gymnasium id, and ``action_masks()`` is what MaskablePPO of sb3-contrib asks an environment for.
"""

from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np

import craftsim
import craftsim.envs  # registers tasks with Gymnasium
from craftsim import Action
from craftsim.tasks.rewards import Reward, Transition, register_term


def blocks_dropped(tick: Transition) -> Any:
    """Return in how many actions something was put down, in each world of a batch."""
    return ((tick.actions == Action.DROP) & tick.applied).sum(axis=1)


def bumps(tick: Transition) -> Any:
    """Return the sum of the forces with which cars touched, in N; there are no contacts on the grid."""
    forces_n = np.zeros(len(tick.t))
    for world, contacts in enumerate(tick.contacts):
        for contact in contacts or ():
            if contact.first.startswith("car") and contact.second.startswith("car"):
                forces_n[world] += contact.peak_n
    return forces_n


# By these names task files can have them, too:  reward: {paper: 1, bumps: -0.5}
register_term("blocks_dropped", blocks_dropped)
register_term("bumps", bumps)

REWARD = Reward({"blocks_dropped": 1.0, "seconds": -0.1, "failures": -5.0, "bumps": -1.0})
TASK = replace(craftsim.make_task("strip"), name="careful_strip", reward=REWARD)
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
