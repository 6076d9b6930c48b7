"""A simulated network: messages come late, by a time that varies, so they may overtake each other, or never."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

import numpy as np

from craftsim.errors import InputError

T = TypeVar("T")

_MOST: Final = 10_000
"""Messages on their way; more are lost."""


@dataclass(frozen=True)
class Network:
    """What becomes of messages on their way, in each direction. Raises InputError for what cannot be."""

    delay_s: float = 0.0
    """How long a message takes on average."""
    jitter_s: float = 0.0
    """Half-width of the uniform distribution around it."""
    loss: float = 0.0
    """Share of the messages that never come."""

    def __post_init__(self) -> None:
        if not (0 <= self.jitter_s <= self.delay_s <= 10 or self.delay_s == self.jitter_s == 0):
            raise InputError(
                f"a network with a delay of {self.delay_s:g} s and a jitter of {self.jitter_s:g} s; allowed: a delay "
                "of 0 to 10 s, and a jitter of 0 to the delay"
            )
        if not 0 <= self.loss <= 1:
            raise InputError(f"a network that loses {self.loss:g} of its messages; allowed: 0 to 1")


class Channel(Generic[T]):
    """One direction of a network."""

    def __init__(self, network: Network, rng: np.random.Generator) -> None:
        """Draw what becomes of each message from a generator; nothing is on its way."""
        self._network, self._rng = network, rng
        self._under_way: list[tuple[float, int, T]] = []
        self._sent = 0

    def send(self, now_s: float, message: T) -> None:
        """Take a message at a time."""
        network = self._network
        late, lost = self._rng.uniform(size=2).tolist()
        self._sent += 1
        if lost < network.loss or len(self._under_way) == _MOST:
            return
        # Rounded, so that what takes whole periods comes at their ends.
        due_s = round(now_s + network.delay_s + network.jitter_s * (2 * late - 1), 9)
        heapq.heappush(self._under_way, (due_s, self._sent, message))

    @property
    def due_s(self) -> float:
        """When the next message comes out; infinite where none is on its way."""
        return self._under_way[0][0] if self._under_way else math.inf

    def due(self, now_s: float) -> list[T]:
        """Return the messages that have come out by a time, in the order in which they came."""
        found = []
        while self.due_s <= now_s:
            found.append(heapq.heappop(self._under_way)[2])
        return found
