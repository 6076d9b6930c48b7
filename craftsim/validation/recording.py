"""What moves in the last step of a replay bundle, as a trajectory."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from craftsim.checking.judge import Judge
from craftsim.experiments.bundle import Recorded, Replay, replay
from craftsim.rendering.trajectory import Recorder, Trajectory

CLIP_S: Final = 3.0
"""Length of a film of one failure."""
_AFTER: Final = 0.2
"""Share of a long action's time for which what follows is recorded; a short one's is filled up to a film's length."""


def record_bundle(recorded: Recorded) -> tuple[Replay, Trajectory]:
    """Re-run what a bundle shows, and a little of what follows; return how it compares, and what moved.

    Raises InputError as :func:`replay`.
    """
    recorder = Recorder()
    span_s = recorded.bundle.end_s - recorded.bundle.start_s
    after_s = max(_AFTER * span_s, CLIP_S - span_s)

    @contextmanager
    def watch(judge: Judge) -> Iterator[None]:
        recorder.begin(judge)
        yield
        for _ in range(math.ceil(after_s / judge.physics.config.control_period_s)):
            judge.executor.advance()

    result = replay(recorded, watch)
    return result, recorder.trajectory(recorded.bundle.key, recorded.bundle.recipe, result.attempts)
