"""How fast a film runs: contact and docking slowly, waits and long foldings fast; when each of its frames is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import Attempt
from craftsim.rendering.trajectory import Trajectory

IDLE: Final = 12.0
"""Simulated seconds in a second of film while no car does anything."""
SPEEDS: Final = {"LIFT": 2.0, "DROP": 2.0, "MOVE": 4.0, "FOLD": 8.0, "UNFOLD": 8.0}
"""The same while a car does this."""
OTHERWISE: Final = 4.0
ON_A_SLOPE: Final = 2.5
DOCKING: Final = 3.0
"""At the beginning and at the end of each folding, for :data:`DOCKING_S`."""
DOCKING_S: Final = 0.6
_SMOOTH_S: Final = 0.8
"""Simulated time over which a change of speed is spread."""
_SMOOTH_SAMPLES: Final = 2000
"""At most, of which a recording has 40 in that time."""


@dataclass(frozen=True, eq=False)
class Pace:
    """When each frame of a film is."""

    times: NDArray[np.float64]
    """(n,) simulated time of each frame, in seconds."""
    factors: NDArray[np.float64]
    """(n,) simulated seconds in a second of film."""


def even_pace(trajectory: Trajectory, fps: int, speed: float) -> Pace:
    """Return frames at a steady speed, the first sample and the last included."""
    n = int(np.ceil(trajectory.duration_s / speed * fps - 1e-6)) + 1
    times = np.minimum(trajectory.time[0] + np.arange(n) * speed / fps, trajectory.time[-1])
    return Pace(times, np.full(n, speed))


def fitted_pace(trajectory: Trajectory, fps: int, length_s: float) -> Pace:
    """Return frames of a film of a given length, never slower than it happened; the last picture stays."""
    n = max(1, round(length_s * fps))
    speed = max(1.0, trajectory.duration_s / length_s)
    times = np.minimum(trajectory.time[0] + np.arange(n) * speed / fps, trajectory.time[-1])
    return Pace(times, np.full(n, speed))


def adapted_pace(trajectory: Trajectory, fps: int) -> Pace:
    """Return frames at a speed that follows what the cars do."""
    time = trajectory.time
    speed = np.full(len(time), IDLE)
    for attempt in trajectory.story.attempts:
        if attempt.performed:
            _slow_down(speed, time, attempt)
    # Film time is the integral of 1 / speed; smoothed, so that it changes gently.
    steps = np.diff(time, prepend=time[0])
    period = float(np.median(steps[1:])) if len(time) > 1 else 1.0
    width = max(1, round(min(_SMOOTH_S / period, _SMOOTH_SAMPLES)))
    padded = np.pad(1.0 / speed, (width // 2, width - 1 - width // 2), mode="edge")
    pace = np.convolve(padded, np.full(width, 1.0 / width), mode="valid")
    film = np.cumsum(pace * steps)
    moments = np.arange(int(np.ceil(film[-1] * fps - 1e-6)) + 1) / fps
    times = np.interp(moments, film, time)
    return Pace(times, 1.0 / np.interp(moments, film, pace))


def _slow_down(speed: NDArray[np.float64], time: NDArray[np.float64], attempt: Attempt) -> None:
    """Lower the speed (n,) at each sample's time (n,) to that of an action while it runs."""
    start, end = attempt.start_s, attempt.start_s + attempt.duration_s
    usual = SPEEDS.get(attempt.verb, OTHERWISE)
    wanted = np.full(len(time), min(usual, ON_A_SLOPE) if attempt.slope else usual)
    if attempt.verb in ("FOLD", "UNFOLD"):
        near = np.minimum(time - start, end - time) < DOCKING_S
        wanted[near] = DOCKING
    during = (time >= start) & (time <= end)
    speed[during] = np.minimum(speed, wanted)[during]
