"""What a film says beside its picture: each car's action, the verdicts as they fall, time, speed and progress."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from craftsim.checking.attempt import Attempt
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.kinds import Action
from craftsim.rendering.trajectory import Trajectory

SHOWN_S: Final = 6.0
"""Simulated time for which a verdict on an action that went well stays; others stay until the car's next one."""


@dataclass(frozen=True)
class CarCaption:
    """What is said of one car."""

    car: int
    action: str
    verdict: str
    """Of its last action; empty where it is long ago, or none has ended."""
    agrees: bool
    """That verdict."""


@dataclass(frozen=True)
class Caption:
    """All that is said at one moment."""

    title: str
    time_s: float
    factor: float | None
    """Of a picture there is none."""
    step: int
    """Actions begun so far."""
    n_steps: int
    cars: tuple[CarCaption, ...]

    @property
    def clock(self) -> str:
        """The simulated time and the speed of the film."""
        time = f"{self.time_s:.1f} s"
        return time if self.factor is None else f"{time}   x{self.factor:.2g}"


class Captions:
    """The captions of a film."""

    def __init__(self, trajectory: Trajectory, title: str | None = None) -> None:
        """Prepare for a trajectory; its own title unless one is given."""
        self.title = trajectory.story.title if title is None else title
        self._attempts = trajectory.story.attempts
        self._performed = sorted((a for a in self._attempts if a.performed), key=lambda a: a.start_s)
        self._n_cars = trajectory.measured.shape[1]

    def at(self, time_s: float, factor: float | None) -> Caption:
        """Return what is said at a simulated time, in a film that then runs at ``factor`` times the real speed."""
        begun = [a for a in self._performed if a.start_s <= time_s]
        cars = tuple(_car(car, [a for a in begun if a.car == car], time_s) for car in range(self._n_cars))
        return Caption(self.title, time_s, factor, len(begun), len(self._performed), cars)


def _car(car: int, begun: Sequence[Attempt], time_s: float) -> CarCaption:
    """Return what is said of a car whose actions so far are ``begun``."""
    running = [a for a in begun if time_s < a.start_s + a.duration_s]
    action = ACTIONS[Action[running[-1].action]].words if running else "waits"
    ended = [a for a in begun if a.start_s + a.duration_s <= time_s]
    if not ended:
        return CarCaption(car, action, "", True)
    last = ended[-1]
    if last.agrees and time_s - last.start_s - last.duration_s > SHOWN_S:
        return CarCaption(car, action, "", True)
    words = ACTIONS[Action[last.action]].words
    verdict = f"{words}: {last.result}" + (f" - {last.reason}" if last.reason else "")
    return CarCaption(car, action, verdict, last.agrees)
