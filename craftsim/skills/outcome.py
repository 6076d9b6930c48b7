"""How a skill ends: succeeded, or failed for a stated reason."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Reason(StrEnum):
    """The reason why a skill failed.

    Example:
        >>> import craftsim
        >>> physics = craftsim.PhysicsWorld(craftsim.Grid.empty((1, 1, 1), n_cars=1))
        >>> outcome = craftsim.Executor(physics).run({0: craftsim.Action.LIFT})[0]
        >>> outcome.reason is craftsim.Reason.LOAD_LOST
        True
    """

    TIMEOUT = "timeout"
    """It took longer than its allowance."""
    BLOCKED = "blocked"
    """The car fell behind its path although its wheels stand, or push with force: something is in the way."""
    SLIPPED = "slipped"
    """The wheels turned without force, the car did not follow: there is no grip."""
    TIPPED = "tipped"
    """The car leans further than any slope would make it."""
    LOAD_LOST = "load lost"
    """The board does not feel the weight that it should."""
    MISALIGNED = "misaligned"
    """The car came to rest off its target, or is not docked to a slope that it should move."""
    DIVERGED = "diverged"
    """The measurements are not finite or not plausible."""
    STOPPED = "stopped"
    """Something unsafe has happened, and all cars were stopped."""
    DISCONNECTED = "disconnected"
    """The robots cannot be reached, or had no command for so long that they stopped by themselves."""


@dataclass(frozen=True)
class Outcome:
    """The end of a skill as the robot itself sees it; whether it is true is read from poses by others."""

    reason: Reason | None
    """None when it succeeded."""
    duration_s: float
    detail: str = ""
    tries: int = 1
    """Number of tries (:class:`craftsim.skills.library.Tries`)."""

    @property
    def succeeded(self) -> bool:
        """Whether the skill reached its goal."""
        return self.reason is None

    def __str__(self) -> str:
        if self.reason is None:
            return "succeeded"
        if self.detail:
            return f"{self.reason}: {self.detail}"
        return str(self.reason)
