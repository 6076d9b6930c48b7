"""Look ahead in physics: copies of an environment try actions before it acts, here or in other processes."""

import copy
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np

from craftsim.envs.central import CentralConstruction


def value(env: CentralConstruction, actions: np.ndarray) -> float:
    """Return the reward of a tick. The environment is changed: give it a copy, or a pickle's."""
    return float(env.step(actions)[1])


def main() -> None:
    """Let an environment do what was best in copies of it; time has a cost."""
    env = CentralConstruction("strip", drive="wheels", time_weight=0.01)
    observation, _ = env.reset(seed=0)
    rng = np.random.default_rng(0)
    for tick in range(2):
        masks = observation["action_mask"]
        choices = [np.array([rng.choice(np.flatnonzero(mask)) for mask in masks]) for _ in range(4)]
        values = [value(copy.deepcopy(env), actions) for actions in choices]
        best = int(np.argmax(values))
        observation, reward, *_ = env.step(choices[best])
        print(f"tick {tick}: foreseen {values[best]:.4f}, came {reward:.4f}")

    # What is sent to another process is pickled, and arrives there as a copy.
    choices = [
        np.array([rng.choice(np.flatnonzero(mask)) for mask in observation["action_mask"]])
        for _ in range(2)
    ]
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        elsewhere = list(pool.map(value, [env] * len(choices), choices))
    here = [value(copy.deepcopy(env), actions) for actions in choices]
    print(f"in other processes the same: {elsewhere == here}")


if __name__ == "__main__":
    main()
