"""Many parallel worlds of a task to learn in, on the grid or in physics, and playing a rollout in them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from craftsim.discrete.kinds import Execution
from craftsim.discrete.rules import RuleSet
from craftsim.envs.physics_vector import PhysicsVectorEnv
from craftsim.errors import check_choice
from craftsim.learning.exploration import hashes
from craftsim.learning.features import decided, joined, with_hidden
from craftsim.learning.learner import Learner
from craftsim.learning.rollouts import Rollout
from craftsim.learning.shape import Shape
from craftsim.tasks import Task
from craftsim.tasks.asynchronous import USUAL_TICK_S, AsynchronousEpisodes, Timing, make_episodes
from craftsim.tasks.episodes import Steps
from craftsim.tasks.kernel import ROW
from craftsim.tasks.observation import car_vectors

_BUCKETS: Final = 1 << 20
"""Counts of :class:`Novelty`."""
_TRAINED_JITTER: Final = 0.24
"""Standard deviation of the logarithm of durations in asynchronous training, as measured on rollers and a workshop
floor (``scripts/measure_durations.py --spread``)."""
_TRAINED_FAILURES: Final = 0.001
"""Probability there that an action has no effect: 6 of 4,191 on that floor and behind a network
(``scripts/network_causes.py``)."""


class BatchStep(NamedTuple):
    """The result of a step of B worlds."""

    reward: NDArray[np.float64]  # (B,): team reward
    terminated: NDArray[np.bool_]  # (B,): the episode ended, and nothing follows
    done: NDArray[np.bool_]  # (B,): the episode is over
    elapsed: NDArray[np.float64] | None = None  # (B,): elapsed time in usual ticks; None: one each


TIMINGS: Final[Mapping[Execution, Timing | None]] = {
    "synchronous": None,
    "asynchronous": Timing(jitter=_TRAINED_JITTER, failures=_TRAINED_FAILURES),
}
"""How long actions take in training, where that plays a part."""


class GridWorlds:
    """B parallel worlds of one task on the grid."""

    def __init__(
        self,
        task: Task,
        n: int,
        rules: RuleSet = "physical",
        helper_depth: int | None = None,
        execution: Execution = "synchronous",
        queue_survives: bool = False,
        shows_hidden: bool = False,
    ) -> None:
        """Make them; where the queue survives, the helper goes on in a new episode with what was left of the last.

        Observations may have a row more, of what is hidden otherwise (:func:`craftsim.learning.features.with_hidden`).
        """
        check_choice("execution", execution, TIMINGS)
        setting = rules, helper_depth
        self.episodes = make_episodes(
            task, np.random.default_rng(), n, *setting, timing=TIMINGS[execution]
        )
        self._over = np.zeros(n, np.bool_)
        self._queue_survives = queue_survives
        self._shows_hidden = shows_hidden

    @property
    def decides(self) -> NDArray[np.bool_] | None:
        """(B, n): which cars decide next; None: all, in ticks."""
        if isinstance(self.episodes, AsynchronousEpisodes):
            return self.episodes.decides
        return None

    def reset(self, seed: int) -> None:
        """Start new episodes everywhere; all further random draws follow from the seed."""
        self.episodes.rng = np.random.default_rng(seed)
        self._begin(np.arange(len(self._over)))

    def observe(self) -> tuple[NDArray[np.integer], NDArray[np.bool_]]:
        """Return observations (B, n, vector_length) and masks (B, n, 15)."""
        self._offered = self.episodes.offered()
        vectors = self.episodes.vectors()
        if self._shows_hidden:
            busy = self.episodes.busy
            return with_hidden(vectors, self.episodes.t, busy), decided(self._offered, busy)
        return vectors, self._offered

    def step(self, actions: NDArray[np.int64]) -> BatchStep:
        """Let the cars that decide act, ``actions`` (B, n)."""
        if isinstance(self.episodes, AsynchronousEpisodes):
            event = self.episodes.step(actions, offered=self._offered)
            self._over = event.done | event.deadlock
            elapsed = event.duration_s / USUAL_TICK_S
            return BatchStep(event.reward, self._terminated(event), self._over, elapsed)
        steps = self.episodes.step(actions)
        self._over = steps.done
        return BatchStep(steps.reward, self._terminated(steps), steps.done)

    def _terminated(self, steps: Steps) -> NDArray[np.bool_]:
        """Return (B,): after which episodes nothing follows.

        Those are the ones that have ended with success, and where the tick is shown those that are out of time, too
        (Pardo et al., "Time limits in reinforcement learning", ICML 2018).
        """
        if self._shows_hidden:
            return steps.done
        return steps.success & self.episodes.task.ends_on_success

    def restart(self) -> None:
        """Start new episodes where they are over."""
        self._begin(np.flatnonzero(self._over))

    def _begin(self, rows: NDArray[np.integer]) -> None:
        queue = self.episodes.queue[rows]
        self.episodes.reset(rows)
        if self._queue_survives:
            self.episodes.queue[rows] = queue

    def close(self) -> None:
        """Free nothing: all of it is in arrays."""


class PhysicsWorlds:
    """The same in physics over worker processes; results do not depend on their number.

    Options are those of :class:`craftsim.envs.physics_vector.PhysicsVectorEnv`.
    """

    decides: NDArray[np.bool_] | None = None

    def __init__(self, task: Task, n: int, **options: Any) -> None:
        self.envs = PhysicsVectorEnv(task, n, **options)

    def reset(self, seed: int) -> None:
        """Start all episodes anew."""
        self._next = self._seen = self._look(self.envs.reset(seed=seed)[0])

    def _look(
        self, observation: dict[str, NDArray[Any]]
    ) -> tuple[NDArray[np.integer], NDArray[np.bool_]]:
        return self.envs.car_vectors(), observation["action_mask"] != 0

    def observe(self) -> tuple[NDArray[np.integer], NDArray[np.bool_]]:
        """Return observations and masks."""
        return self._seen

    def step(self, actions: NDArray[np.int64]) -> BatchStep:
        """Let all cars act."""
        observation, reward, terminated, truncated, infos = self.envs.step(actions)
        # A world whose episode has ended stands at the start of the next one already.
        self._next = self._look(observation)
        vectors, masks = self._seen = self._next[0].copy(), self._next[1].copy()
        done = terminated | truncated
        for world in np.flatnonzero(done):
            last = infos["final_obs"][world]
            vectors[world] = car_vectors(last["observation"].reshape(1, -1, ROW), masks.shape[1])[0]
            masks[world] = last["action_mask"] != 0
        return BatchStep(reward, terminated, done)

    def restart(self) -> None:
        """Go on with the episodes that have begun in the place of those that are over."""
        self._seen = self._next

    def close(self) -> None:
        """End the processes."""
        self.envs.close()


class Novelty:
    """A bonus: a weight divided by the root of how often an arrangement of things was seen.

    Count-based exploration by hashing (Tang et al., "#Exploration", NeurIPS 2017): it fades as ``counts``
    grow; evaluations never see it. Where the cars are plays no part.
    """

    def __init__(self, weight: float, shape: Shape) -> None:
        self.weight = weight
        self._skip = ROW * (1 + shape.n_cars)
        self._end = shape.vector_length - ROW * bool(shape.ticks)
        self.counts = np.zeros(_BUCKETS, np.int32)

    def __call__(self, vectors: NDArray[np.integer]) -> NDArray[np.float64]:
        """Count what is observed, (B, n, vector_length), and return (B,)."""
        buckets = (hashes(vectors[:, 0, self._skip : self._end]) >> 20) % _BUCKETS
        np.add.at(self.counts, buckets, 1)
        bonus: NDArray[np.float64] = self.weight / np.sqrt(self.counts[buckets])
        return bonus


WorldBatch = GridWorlds | PhysicsWorlds


@torch.no_grad()
def play_rollout(worlds: WorldBatch, learner: Learner, bonus: Novelty | None = None) -> Rollout:
    """Return what a learner plays in all worlds, from their present states, until its next update."""
    columns: list[tuple[Any, ...]] = []
    encoder = learner.net.encoder
    before = encoder.look(*worlds.observe())
    learner.begin(torch.ones(len(before.places), dtype=torch.bool))
    for _ in range(learner.ticks):
        decides = worlds.decides
        actions = learner.act(before)
        reward, terminated, done, elapsed = worlds.step(actions.cpu().numpy())
        vectors, masks = worlds.observe()
        if bonus is not None:
            reward = reward + bonus(vectors)
        arrays = reward.astype(np.float32), terminated, done, decides, elapsed
        step_tensors = [None if a is None else torch.from_numpy(a.copy()) for a in arrays]
        begins = np.flatnonzero(done)
        if len(begins):
            # The last and the first that is seen of episodes are looked at together.
            worlds.restart()
            first = worlds.observe()
            vectors = np.concatenate([vectors, first[0][begins]])
            masks = np.concatenate([masks, first[1][begins]])
        after = encoder.look(vectors, masks)
        n = len(done)
        columns.append((before, after[:n], actions, *step_tensors))
        before = after
        if len(begins):
            rows = np.arange(n)
            rows[begins] = np.arange(n, len(vectors))
            before = after[torch.from_numpy(rows)]
            learner.begin(torch.from_numpy(rows >= n))
    nows, afters, *tensor_columns = zip(*columns, strict=True)
    device = before.places.device
    stacked: Any = (
        None if column[0] is None else torch.stack(column).to(device) for column in tensor_columns
    )
    return Rollout(joined(nows, torch.stack), joined(afters, torch.stack), *stacked)
