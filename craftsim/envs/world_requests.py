"""What worlds in other processes are asked for, what they answer, and what holds them."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from craftsim.envs.central import CentralConstruction
from craftsim.errors import CraftsimError

Observation = dict[str, NDArray[Any]]
Make = Callable[[], CentralConstruction]


@dataclass(frozen=True, slots=True)
class ResetRequest:
    """Ask a world to begin an episode; see :meth:`craftsim.envs.core.Core.reset`."""

    seed: int | None
    options: dict[str, Any] | None


@dataclass(frozen=True, slots=True)
class ActRequest:
    """Ask a world to let its cars act once, and to begin the next episode where that ends one."""

    actions: NDArray[np.int64]
    """(n,) by car."""


@dataclass(frozen=True, slots=True)
class RenderRequest:
    """Ask a world for its picture."""


Request = ResetRequest | ActRequest | RenderRequest


@dataclass(frozen=True, slots=True)
class Seen:
    """A world after a reset."""

    observation: Observation


@dataclass(frozen=True, slots=True)
class Acted(Seen):
    """A world after its cars have acted; the observation is the next episode's first where one has ended."""

    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]
    final: Observation | None
    """The last observation of an episode that has ended."""


@dataclass(frozen=True, slots=True)
class Rendered:
    """What a world has rendered."""

    picture: Any


Answer = Seen | Acted | Rendered | CraftsimError


def perform(env: CentralConstruction, request: Request) -> Answer:
    """Return a world's answer to a request; what it raises is its answer, too."""
    try:
        match request:
            case ResetRequest(seed, options):
                return Seen(env.reset(seed=seed, options=options)[0])
            case RenderRequest():
                return Rendered(env.render())
            case ActRequest(actions):
                observation, reward, terminated, truncated, info = env.step(actions)
                del info["action_mask"]  # the observation has it
                final = None
                if terminated or truncated:
                    final, observation = observation, env.reset()[0]
                return Acted(observation, reward, terminated, truncated, info, final)
    except CraftsimError as error:
        return error
    except Exception:
        return CraftsimError(f"a world in physics broke down:\n{traceback.format_exc()}")


class WorldHolder(Protocol):
    """Worlds numbered from 0, spread over workers; none of their numbers depends on how."""

    workers: int
    """How many there are."""

    def ask(self, requests: Mapping[int, Request]) -> None:
        """Ask worlds, by number, for something each; none of them may have an answer due.

        Raises CraftsimError where a worker has ended.
        """

    def gather(self, at_least: int) -> dict[int, Answer]:
        """Return the answers that are there, by world in rising order; wait for so many, or for all that are due.

        Raises CraftsimError where a worker has ended.
        """

    def close(self) -> None:
        """End all workers; one that has something left to do is killed."""
