"""Evaluation of a policy: whole episodes on the grid or in physics, from the task's own starts.

What differs among the episodes is counted: of a deterministic policy that always starts in the same world, a thousand
episodes may be a single one, repeated.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from craftsim.choices import Execution
from craftsim.discrete.asynchronous import AsynchronousEpisodes, Timing
from craftsim.discrete.rules import RuleSet
from craftsim.discrete.tasks import Task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.discrete.tasks.starts import Starts
from craftsim.envs.physics_vector import PhysicsVectorEnv
from craftsim.training.config import Acting
from craftsim.training.curve import EvaluationResult
from craftsim.training.networks import CarNet, RecurrentState
from craftsim.training.rollouts import TRAINED_JITTER, Seen

_FACTOR: Final = np.int64(6364136223846793005)
"""Of Knuth's linear congruential generator; numbers are taken modulo 2**64."""


def evaluate(
    net: CarNet,
    task: Task,
    episodes: int,
    seed: int,
    rules: RuleSet = "physical",
    helper_depth: int | None = None,
    acting: Acting = "greedy",
    execution: Execution = "synchronous",
) -> EvaluationResult:
    """Play so many episodes, all at once; ``seed`` draws starts and orders, and actions where they are sampled.

    Where a task has a list of held-out starts, episodes take one after the other. In asynchronous execution a tick is
    an event, and a deadlock ends an episode.
    """
    rng = np.random.default_rng(seed)
    worlds = (
        Episodes(task, rng, episodes, rules, helper_depth)
        if execution == "synchronous"
        else AsynchronousEpisodes(
            task, rng, episodes, rules, helper_depth, timing=Timing(jitter=TRAINED_JITTER)
        )
    )
    if task.split == "test" and isinstance(listed := task.sampler, Starts):
        rows = np.arange(episodes)
        worlds.begin(rows, listed.take(rows % len(listed)))
    running = np.ones(episodes, np.bool_)
    won, total, ticks = (np.zeros(episodes) for _ in range(3))
    repetitions = Repetitions(worlds.designs)
    draws = np.random.default_rng([seed, 1])
    memory = net.memory(episodes, worlds.n_cars)
    while running.any():
        seen, offered = worlds.vectors(), worlds.offered()
        noise = draws.gumbel(size=offered.shape) if acting == "sampled" else None
        chosen = choose_actions(net, seen, offered, noise, memory)
        repetitions.add(np.flatnonzero(running), seen[running], chosen[running])
        event = worlds.step(chosen, offered=offered) if isinstance(worlds, AsynchronousEpisodes) else None
        steps = event or worlds.step(chosen)
        won[running & steps.success] = 1
        total += steps.reward * running
        ticks += running
        running &= ~steps.done
        if event is not None:
            running &= ~event.deadlock
    return _played(won, total, ticks, repetitions)


def evaluate_in_physics(
    net: CarNet, worlds: PhysicsVectorEnv, episodes: int, seed: int, acting: Acting = "greedy"
) -> EvaluationResult:
    """Play so many episodes, as many at once as there are worlds.

    Episode i is seeded with ``seed + i``; how many worlds there are decides nothing.
    """
    won, total, ticks = (np.zeros(episodes) for _ in range(3))
    repetitions = Repetitions(np.zeros((episodes, 0, 5), np.int64))
    for first in range(0, episodes, worlds.num_envs):
        masks = worlds.reset(seed=seed + first)[0]["action_mask"]
        ids = np.arange(min(worlds.num_envs, episodes - first))
        draws = [np.random.default_rng([seed + first + i, 1]) for i in range(len(ids))]
        memory = net.memory(*masks[ids].shape[:2])
        while len(ids):
            seen = worlds.car_vectors()[ids]
            noise = None
            if acting == "sampled":
                noise = np.stack([draws[i].gumbel(size=masks[i].shape) for i in ids])
            chosen = choose_actions(net, seen, masks[ids], noise, memory)
            repetitions.add(first + ids, seen, chosen)
            worlds.send(chosen, ids)
            observation, reward, terminated, truncated, infos = worlds.recv(len(ids))
            masks[ids] = observation["action_mask"]
            won[first + ids] += infos["success"] & (terminated | truncated)
            total[first + ids] += reward
            ticks[first + ids] += 1
            goes_on = ~(terminated | truncated)
            ids = ids[goes_on]
            if memory is not None:
                memory = RecurrentState(*(part[torch.from_numpy(goes_on)] for part in memory))
    return _played(won, total, ticks, repetitions)


def _played(
    won: NDArray[np.float64], total: NDArray[np.float64], ticks: NDArray[np.float64], repetitions: Repetitions
) -> EvaluationResult:
    solved, starts = repetitions.solved(won)
    trajectories = len(np.unique(repetitions.trajectories))
    means = float(total.mean()), float(ticks.mean())
    return EvaluationResult(len(won), int(won.sum()), *means, starts, solved, trajectories)


@torch.no_grad()
def choose_actions(
    net: CarNet,
    observations: NDArray[np.integer],
    masks: NDArray[np.generic],
    noise: NDArray[np.float64] | None = None,
    memory: RecurrentState | None = None,
) -> NDArray[np.int64]:
    """Return (..., n): for every car the offered action that the network rates highest.

    With Gumbel noise (..., n, 15) on top that is one drawn as often as the policy gives it probability.
    ``observations`` are (..., n, vector_length) and ``masks`` (..., n, 15); ``memory`` is that of a recurrent policy.
    """
    places = net.encoder.places(torch.from_numpy(observations.astype(np.int64)))
    values = net(Seen(places, torch.from_numpy(masks.astype(np.bool_))), memory)
    if noise is not None:
        values = values + torch.from_numpy(noise)
    actions = values.argmax(-1)
    if memory is not None:
        memory.last.copy_(actions)
    chosen: NDArray[np.int64] = actions.numpy()
    return chosen


class Repetitions:
    """Digests of n episodes: of how each began, and of all that its cars saw and did."""

    def __init__(self, designs: NDArray[np.integer]) -> None:
        """Begin; ``designs`` (n, T, 5) is what is to be built in each."""
        self._designs = _digests(designs.reshape(len(designs), -1))
        self.starts = self._designs.copy()
        self.trajectories = self._designs.copy()
        self._begun = np.zeros(len(designs), np.bool_)

    def add(
        self, which: NDArray[np.integer], seen: NDArray[np.integer], actions: NDArray[np.integer]
    ) -> None:
        """Add a tick of some episodes: what was seen, (k, ...), and then done, (k, n)."""
        with np.errstate(over="ignore"):
            world = _digests(seen.reshape(len(which), -1))
            new = which[~self._begun[which]]
            self.starts[new] = self.starts[new] * _FACTOR + world[~self._begun[which]]
            self._begun[new] = True
            done = _digests(actions.reshape(len(which), -1))
            self.trajectories[which] = (self.trajectories[which] * _FACTOR + world) * _FACTOR + done

    def solved(self, won: NDArray[np.generic]) -> tuple[int, int]:
        """Return of how many starts each episode succeeded, and how many starts there are."""
        _, start = np.unique(self.starts, return_inverse=True)
        failures = np.bincount(start, weights=won == 0)
        return int((failures == 0).sum()), len(failures)


def _digests(rows: NDArray[np.integer]) -> NDArray[np.int64]:
    factors = np.random.default_rng(1).integers(-(2**62), 2**62, rows.shape[1])
    with np.errstate(over="ignore"):
        sums: NDArray[np.int64] = (rows.astype(np.int64) * factors).sum(axis=1)
    return sums
