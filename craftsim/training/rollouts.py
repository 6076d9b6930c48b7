"""Rollouts: what the cars of many worlds, on the grid or in physics, observe, do and get, tick by tick."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from craftsim.discrete.asynchronous import AsynchronousEpisodes, Timing
from craftsim.discrete.kernel.tasks import ROW
from craftsim.discrete.rules import RuleSet
from craftsim.discrete.tasks import Task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.discrete.tasks.observation import car_vectors
from craftsim.envs.vector import PhysicsVectorEnv
from craftsim.training.features import Encoder, RelativeEncoder

_HASH_SEED: Final = 2
USUAL_TICK_S: Final = 1.0
"""About what a move takes: a discount of a tick is one of so much time where cars decide one by one."""
TRAINED_JITTER: Final = 0.1
"""By about what share durations vary where cars are trained asynchronously."""


class BatchStep(NamedTuple):
    """What a step of B worlds brought."""

    reward: NDArray[np.float64]
    """(B,): one number for the team."""
    terminated: NDArray[np.bool_]
    """(B,): the task was completed."""
    done: NDArray[np.bool_]
    """(B,): the episode is over."""
    elapsed: NDArray[np.float64] | None = None
    """(B,): how long it took, in usual ticks; None where all take one."""


@dataclass(frozen=True)
class Seen:
    """What cars observe, as a network takes it."""

    places: Tensor
    """(..., n, rows) int32: the row of the encoder's table of every thing, see :meth:`.features.Encoder.places`."""
    offers: Tensor
    """(..., n, 15) bool: the actions that are offered, at least one a car."""

    def __getitem__(self, index: Any) -> Seen:
        """Return some of them, by an index of the leading dimensions."""
        return Seen(self.places[index], self.offers[index])

    def flat(self, dims: int = 2) -> Seen:
        """Return the same with so many leading dimensions joined."""
        return Seen(self.places.flatten(0, dims - 1), self.offers.flatten(0, dims - 1))


def joined(parts: Sequence[Seen], join: Callable[..., Tensor] = torch.cat) -> Seen:
    """Return one after the other along the first dimension, or joined by torch.stack."""
    return Seen(join([part.places for part in parts]), join([part.offers for part in parts]))


@dataclass(frozen=True)
class Rollout:
    """T ticks of B worlds with n cars."""

    now: Seen
    """(T, B): before each tick."""
    after: Seen
    """(T, B): after it; where an episode ends there, its last observation."""
    actions: Tensor
    """(T, B, n) int64."""
    rewards: Tensor
    """(T, B) float32, one for the team."""
    terminated: Tensor
    """(T, B) bool: the task was completed."""
    done: Tensor
    """(T, B) bool: the episode ended, by success or at its time limit."""
    decides: Tensor | None = None
    """(T, B, n) bool: which cars chose their action, the others being in the middle of one; None where all did."""
    elapsed: Tensor | None = None
    """(T, B) float32: how long each took, in usual ticks; None where all took one."""

    def __len__(self) -> int:
        """Return the number of ticks of all worlds together."""
        return self.rewards.numel()


class WorldBatch(Protocol):
    """B worlds of one task that are stepped side by side."""

    @property
    def decides(self) -> NDArray[np.bool_] | None:
        """(B, n): which cars choose what they do next; None where all do, tick by tick."""

    def reset(self, seed: int) -> None:
        """Start all episodes anew; all that is drawn from now on follows from the seed."""

    def observe(self) -> tuple[NDArray[np.integer], NDArray[np.bool_]]:
        """Return observations (B, n, vector_length) and masks (B, n, 15)."""

    def step(self, actions: NDArray[np.int64]) -> BatchStep:
        """Let all cars that decide act, (B, n)."""

    def restart(self) -> None:
        """Start the episodes anew that are over."""

    def close(self) -> None:
        """Free what they hold."""


class GridWorlds:
    """WorldBatch on the grid, stepped in one array call."""

    decides: NDArray[np.bool_] | None = None

    def __init__(
        self, task: Task, n: int, rules: RuleSet = "physical", helper_depth: int | None = None
    ) -> None:
        self.episodes = Episodes(task, np.random.default_rng(), n, rules, helper_depth)

    def reset(self, seed: int) -> None:
        """Start all episodes anew."""
        self.episodes.rng = np.random.default_rng(seed)
        self.episodes.reset()

    def observe(self) -> tuple[NDArray[np.integer], NDArray[np.bool_]]:
        """Return observations and masks."""
        return self.episodes.vectors(), self.episodes.offered()

    def step(self, actions: NDArray[np.int64]) -> BatchStep:
        """Let all cars act."""
        steps = self.episodes.step(actions)
        return BatchStep(steps.reward, steps.success & steps.done, steps.done)

    def restart(self) -> None:
        """Start the episodes anew that are over."""
        self.episodes.reset(np.flatnonzero(self.episodes.done))

    def close(self) -> None:
        """Free nothing: all of it is in arrays."""


class AsynchronousWorlds:
    """WorldBatch on the grid whose cars decide one by one; a step lasts until the next event of each world."""

    def __init__(
        self,
        task: Task,
        n: int,
        rules: RuleSet = "physical",
        helper_depth: int | None = None,
    ) -> None:
        rng, timing = np.random.default_rng(), Timing(jitter=TRAINED_JITTER)
        self.episodes = AsynchronousEpisodes(task, rng, n, rules, helper_depth, timing=timing)
        self._over = np.zeros(n, np.bool_)

    @property
    def decides(self) -> NDArray[np.bool_]:
        """Which cars have no action and decide."""
        return self.episodes.decides

    def reset(self, seed: int) -> None:
        """Start all episodes anew."""
        self.episodes.rng = np.random.default_rng(seed)
        self.episodes.reset()

    def observe(self) -> tuple[NDArray[np.integer], NDArray[np.bool_]]:
        """Return observations and masks."""
        return self.episodes.vectors(), self.episodes.offered()

    def step(self, actions: NDArray[np.int64]) -> BatchStep:
        """Let the cars that decide begin their actions, and each world go on to its next event."""
        before_s = self.episodes.time_s.copy()
        steps = self.episodes.step(actions)
        self._over = steps.done | self.episodes.deadlocks(self.episodes.offered())
        elapsed = (self.episodes.time_s - before_s) / USUAL_TICK_S
        return BatchStep(steps.reward, steps.success & steps.done, self._over, elapsed)

    def restart(self) -> None:
        """Start the episodes anew that are over."""
        self.episodes.reset(np.flatnonzero(self._over))

    def close(self) -> None:
        """Free nothing: all of it is in arrays."""


class PhysicsWorlds:
    """WorldBatch in physics, spread over worker processes; none of their numbers depends on how many there are."""

    decides: NDArray[np.bool_] | None = None

    def __init__(self, task: Task, n: int, **options: Any) -> None:
        """Prepare; options are those of :class:`craftsim.envs.vector.PhysicsVectorEnv`."""
        self.envs = PhysicsVectorEnv(task, n, **options)
        self._seen: tuple[NDArray[np.integer], NDArray[np.bool_]]
        self._next: tuple[NDArray[np.integer], NDArray[np.bool_]]

    def reset(self, seed: int) -> None:
        """Start all episodes anew."""
        observation, _infos = self.envs.reset(seed=seed)
        self._seen = self.envs.car_vectors(), observation["action_mask"] != 0

    def observe(self) -> tuple[NDArray[np.integer], NDArray[np.bool_]]:
        """Return observations and masks."""
        return self._seen

    def step(self, actions: NDArray[np.int64]) -> BatchStep:
        """Let all cars act."""
        observation, reward, terminated, truncated, infos = self.envs.step(actions)
        # A world whose episode has ended stands at the start of the next one already.
        self._next = self.envs.car_vectors(), observation["action_mask"] != 0
        vectors, masks = self._next[0].copy(), self._next[1].copy()
        done = terminated | truncated
        for world in np.flatnonzero(done):
            last = infos["final_obs"][world]
            vectors[world] = car_vectors(last["observation"].reshape(1, -1, ROW), masks.shape[1])[0]
            masks[world] = last["action_mask"] != 0
        self._seen = vectors, masks
        return BatchStep(reward, terminated, done)

    def restart(self) -> None:
        """Go on with the episodes that have begun in the place of those that are over."""
        self._seen = self._next

    def close(self) -> None:
        """End the processes."""
        self.envs.close()


@torch.no_grad()
def play(
    worlds: WorldBatch, encoder: Encoder | RelativeEncoder, act: Callable[[Seen], Tensor], ticks: int
) -> Rollout:
    """Return so many ticks of all worlds, from where they stand; ``act`` returns actions (B, n) of what is seen."""
    columns: list[tuple[Any, ...]] = []
    now = _look(worlds, encoder)
    for _ in range(ticks):
        decides, actions = worlds.decides, act(now)
        reward, terminated, done, elapsed = worlds.step(actions.numpy())
        after = _look(worlds, encoder)
        arrays = reward.astype(np.float32), terminated, done, decides, elapsed
        columns.append(
            (now, after, actions, *(None if a is None else torch.from_numpy(a.copy()) for a in arrays))
        )
        now = after
        if done.any():
            worlds.restart()
            now = _look(worlds, encoder)
    nows, afters, *rest = zip(*columns, strict=True)
    stacked: Any = (None if column[0] is None else torch.stack(column) for column in rest)
    return Rollout(joined(nows, torch.stack), joined(afters, torch.stack), *stacked)


def _look(worlds: WorldBatch, encoder: Encoder | RelativeEncoder) -> Seen:
    vectors, masks = worlds.observe()
    places = encoder.places(torch.from_numpy(vectors.astype(np.int64)))
    return Seen(places.to(torch.int32), torch.from_numpy(masks.copy()))


def lambda_returns(rollout: Rollout, after: Tensor, gamma: float, decay: float) -> Tensor:
    """Return (T, B) or (T, B, n): lambda returns from the value, of the same shape, after each tick.

    An episode that ran out of time counts on with the value after its last tick, a completed one with nothing.
    """
    shape = *rollout.done.shape, *(1,) * (after.ndim - 2)
    rewards, terminated, done = (
        column.reshape(shape) for column in (rollout.rewards, rollout.terminated, rollout.done)
    )
    found, ahead = torch.empty_like(after), after[-1]
    for t in range(len(after) - 1, -1, -1):
        mixed = torch.where(done[t], after[t], (1 - decay) * after[t] + decay * ahead)
        found[t] = ahead = rewards[t] + gamma * ~terminated[t] * mixed
    return found


class UniqueObservations:
    """The distinct rows among N that were seen, by a hash of 64 bits: a network need only look at these.

    Episodes that begin alike meet the same worlds again and again, and what a network says of one holds for all its
    copies. Two of a million rows share a hash by chance in one of ten million cases.
    """

    def __init__(self, seen: Seen) -> None:
        """Compare N rows."""
        generator = torch.Generator().manual_seed(_HASH_SEED)
        hashes = torch.zeros(len(seen.places), dtype=torch.int64)
        for column in (seen.places, seen.offers):
            rows = column.flatten(1).long()
            hashes += (rows * torch.randint(-(2**62), 2**62, rows.shape[1:], generator=generator)).sum(-1)
        found, self.inverse = torch.unique(hashes, return_inverse=True)
        """(N,): which of the distinct rows each row is."""
        first = torch.full_like(found, len(hashes)).scatter_reduce_(
            0, self.inverse, torch.arange(len(hashes)), "amin"
        )
        self.seen = seen[first]
        """(U,): the distinct rows."""
