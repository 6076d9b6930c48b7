"""Evaluation of a policy: whole episodes on the grid or in physics, from the task's own starts.

What differs among the episodes is counted: of a deterministic policy that always starts in the same world, a thousand
episodes may be a single one, repeated.
"""

from __future__ import annotations

from contextlib import closing
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.kinds import Execution
from craftsim.discrete.rules import RuleSet
from craftsim.envs.physics_vector import PhysicsVectorEnv
from craftsim.errors import check_choice
from craftsim.learning.config import IS_SAMPLED, IS_VARIED, Acting, TrainConfig
from craftsim.learning.curve import EvaluationResult
from craftsim.learning.exploration import hashes
from craftsim.learning.features import decided, with_hidden
from craftsim.learning.networks import CarNet, RecurrentState
from craftsim.learning.worlds import TIMINGS
from craftsim.tasks import Task
from craftsim.tasks.asynchronous import AsynchronousEpisodes, make_episodes
from craftsim.tasks.episodes import Steps
from craftsim.tasks.kernel import ROW
from craftsim.tasks.starts import Starts

_FACTOR: Final = np.int64(6364136223846793005)
"""Of Knuth's linear congruential generator; numbers are taken modulo 2**64."""


_VARIED: Final = 3.0
"""By how much the logarithm of an action's probability is rated lower. From 2 to 6 makes little difference; without
it cars may go in circles for ever."""


class Tried:
    """How often each car did what in a situation: where it saw itself, and all but the other cars, as it does now."""

    def __init__(self) -> None:
        self._situations: list[NDArray[np.int64]] = []  # by tick, (..., n)
        self._did: list[NDArray[np.int64]] = []

    def counts(self, vectors: NDArray[np.integer]) -> NDArray[np.float32]:
        """Return (..., n, 15) for what cars see now, (..., n, vector_length); what they do is added next."""
        n = vectors.shape[-2]
        car_vectors = np.concatenate([vectors[..., :ROW], vectors[..., ROW * n :]], axis=-1)
        situations = hashes(car_vectors.reshape(-1, car_vectors.shape[-1])).reshape(
            car_vectors.shape[:-1]
        )
        counts = np.zeros((*situations.shape, N_ACTIONS), np.float32)
        for situation, actions in zip(self._situations, self._did, strict=True):
            np.add.at(counts, (*(same := np.nonzero(situation == situations)), actions[same]), 1)
        self._situations.append(situations)
        return counts

    def add(self, actions: NDArray[np.int64]) -> None:
        """Add what cars do now, (..., n)."""
        self._did.append(actions)

    def keep(self, which: NDArray[np.bool_]) -> None:
        """Forget all episodes but those of a mask."""
        self._situations, self._did = (
            [rows[which] for rows in history] for history in (self._situations, self._did)
        )


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
    check_choice("way of acting", acting, IS_VARIED)
    check_choice("execution", execution, TIMINGS)
    worlds = make_episodes(
        task, np.random.default_rng(seed), episodes, rules, helper_depth, timing=TIMINGS[execution]
    )
    if task.split == "test":
        listed = task.sampler
        if isinstance(listed, Starts):
            rows = np.arange(episodes)
            worlds.begin(rows, listed.take(rows % len(listed)))
    running = np.arange(episodes)
    tally = Tally(worlds.designs)
    draws = np.random.default_rng([seed, 1])
    memory = net.memory(episodes, worlds.n_cars)
    tried = None
    if IS_VARIED[acting]:
        tried = Tried()
    steps: Steps
    while len(running):
        vectors = worlds.vectors()
        offered = worlds.offered()
        if net.encoder.ticks:
            vectors = with_hidden(vectors, worlds.t, worlds.busy)
            offered = decided(offered, worlds.busy)
        noise = None
        if IS_SAMPLED[acting]:
            noise = draws.gumbel(size=offered.shape)
        chosen = choose_actions(net, vectors, offered, noise, memory, tried)
        tally.add(running, vectors[running], chosen[running])
        if isinstance(worlds, AsynchronousEpisodes):
            event = worlds.step(chosen, offered=offered)
            steps = event
            over = event.done | event.deadlock
        else:
            steps = worlds.step(chosen)
            over = steps.done
        tally.count(running, steps.reward[running], steps.success[running])
        running = running[~over[running]]
    return tally.result()


def evaluate_in_physics(
    net: CarNet, worlds: PhysicsVectorEnv, episodes: int, seed: int, acting: Acting = "greedy"
) -> EvaluationResult:
    """Play so many episodes, as many at once as there are worlds.

    Episode i is seeded with ``seed + i``; how many worlds there are decides nothing.
    """
    check_choice("way of acting", acting, IS_VARIED)
    tally = Tally(np.zeros((episodes, 0, 5), np.int64))
    for first in range(0, episodes, worlds.num_envs):
        masks = worlds.reset(seed=seed + first)[0]["action_mask"]
        ids = np.arange(min(worlds.num_envs, episodes - first))
        draws = [np.random.default_rng([seed + first + i, 1]) for i in range(len(ids))]
        memory = net.memory(*masks[ids].shape[:2])
        tried = None
        if IS_VARIED[acting]:
            tried = Tried()
        while len(ids):
            vectors = worlds.car_vectors()[ids]
            noise = None
            if IS_SAMPLED[acting]:
                noise = np.stack([draws[i].gumbel(size=masks[i].shape) for i in ids])
            chosen = choose_actions(net, vectors, masks[ids], noise, memory, tried)
            tally.add(first + ids, vectors, chosen)
            worlds.send(chosen, ids)
            observation, reward, terminated, truncated, infos = worlds.recv(len(ids))
            masks[ids] = observation["action_mask"]
            goes_on = ~(terminated | truncated)
            tally.count(first + ids, reward, infos["success"])
            ids = ids[goes_on]
            if tried is not None:
                tried.keep(goes_on)
            if memory is not None:
                memory = RecurrentState(*(state[torch.from_numpy(goes_on)] for state in memory))
    return tally.result()


def evaluate_as_trained(
    config: TrainConfig, net: CarNet, task: Task, episodes: int, seed: int
) -> EvaluationResult:
    """Play so many episodes of a task as a configuration plays in training: on the grid, or in physics by itself."""
    if config.backend == "grid":
        setting = config.rules, config.helper_depth, config.acting, config.execution
        return evaluate(net, task, episodes, seed, *setting)
    options: dict[str, Any] = {"drive": config.drive, "randomization": config.randomize}
    with closing(PhysicsVectorEnv(task, config.n_worlds, workers=1, **options)) as worlds:
        return evaluate_in_physics(net, worlds, episodes, seed, config.acting)


@torch.no_grad()
def choose_actions(
    net: CarNet,
    observations: NDArray[np.integer],
    masks: NDArray[np.generic],
    noise: NDArray[np.float64] | None = None,
    memory: RecurrentState | None = None,
    tried: Tried | None = None,
) -> NDArray[np.int64]:
    """Return (..., n): for every car the offered action that the network rates highest.

    With Gumbel noise (..., n, 15) on top that is one drawn as often as the policy gives it probability.
    ``observations`` are (..., n, vector_length) and ``masks`` (..., n, 15); ``memory`` is that of a recurrent policy,
    ``tried`` is for varied actions.
    """
    values = net(net.encoder.look(observations, masks), memory)
    if noise is not None:
        values = values + torch.from_numpy(noise).to(values.device)
    if tried is not None:
        situations = observations
        if net.encoder.ticks:
            situations = observations[
                ..., :-ROW
            ]  # situations differ by what is where, not by the tick
        values = values - _VARIED * torch.from_numpy(tried.counts(situations)).to(values.device)
    actions = values.argmax(-1)
    if memory is not None:
        memory.last.copy_(actions)
    chosen: NDArray[np.int64] = actions.cpu().numpy()
    if tried is not None:
        tried.add(chosen)
    return chosen


class Tally:
    """What n episodes came to, and digests of how each began, and of all that its cars saw and did."""

    def __init__(self, designs: NDArray[np.integer]) -> None:
        """Begin; ``designs`` (n, T, 5) is what is to be built in each."""
        n = len(designs)
        self.starts = hashes(designs)
        self.trajectories = self.starts.copy()
        self.won, self.total, self.ticks = (np.zeros(n) for _ in range(3))

    def add(
        self, which: NDArray[np.integer], vectors: NDArray[np.integer], actions: NDArray[np.integer]
    ) -> None:
        """Add a tick of some episodes: what was seen, (k, ...), and then done, (k, n)."""
        with np.errstate(over="ignore"):
            world = hashes(vectors)
            done = hashes(actions)
            new = self.ticks[which] == 0
            self.starts[which[new]] = self.starts[which[new]] * _FACTOR + world[new]
            self.trajectories[which] = (self.trajectories[which] * _FACTOR + world) * _FACTOR + done
        self.ticks[which] += 1

    def count(
        self, which: NDArray[np.integer], reward: NDArray[np.floating], success: NDArray[np.bool_]
    ) -> None:
        """Count what that tick brought, (k,)."""
        self.total[which] += reward
        self.won[which] = np.maximum(self.won[which], success)

    def result(self) -> EvaluationResult:
        """Return it: a start is solved if all of its episodes succeeded."""
        _, start = np.unique(self.starts, return_inverse=True)
        failures = np.bincount(start, weights=self.won == 0)
        means = float(self.total.mean()), float(self.ticks.mean())
        solved = int((failures == 0).sum())
        trajectories = len(np.unique(self.trajectories))
        return EvaluationResult(
            len(self.won), int(self.won.sum()), *means, len(failures), solved, trajectories
        )
