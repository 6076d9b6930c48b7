"""Skills of the slope above the car: fold and unfold."""

from __future__ import annotations

from collections import deque

from craftsim.models.sensing import CarMeasurement
from craftsim.skills.outcome import Reason
from craftsim.skills.skill import Command, Skill, SkillSetup


class TurnHinge(Skill):
    """Bring the hinge of the docked slope to one end of its range at no more than its motor's speed."""

    def __init__(self, setup: SkillSetup, target_rad: float) -> None:
        """Prepare to turn the hinge to ``target_rad``: 0 unfolds, pi folds."""
        super().__init__(setup)
        self.gains = setup.gains.hinge
        self.max_speed_rad_s = setup.machines.slope.hinge_speed_rad_s
        self.target_rad = target_rad
        self._speed = 0.0

    def _begin(self, now: CarMeasurement) -> None:
        """Take the slope that the first reading shows which shows one."""
        self._slope: int | None = None
        self._undocked_s = 0.0
        periods = round(self.gains.still_time / self.period_s)
        self._past: deque[float] = deque(maxlen=periods + 1)

    def _control(self, now: CarMeasurement) -> Command:
        gains = self.gains
        if self._slope is None and now.hinge_rad is not None:
            self._slope = now.slope
            travel = abs(self.target_rad - now.hinge_rad)
            self._deadline_s = self.elapsed_s + travel / self.max_speed_rad_s + gains.allowance
        if now.hinge_rad is None or now.slope != self._slope:
            # A plug may chatter.
            self._undocked_s += self.period_s
            if self._undocked_s > gains.undocked:
                self._fail(Reason.MISALIGNED, "the car is not docked to a slope")
            return Command()
        self._undocked_s = 0.0
        self._past.append(now.hinge_rad)
        remaining = self.target_rad - now.hinge_rad
        moved = abs(now.hinge_rad - self._past[0])
        still = len(self._past) == self._past.maxlen and moved < gains.still * gains.still_time
        if abs(remaining) < gains.reached and still:
            self._succeed()
        elif self.elapsed_s > self._deadline_s:
            self._fail(Reason.TIMEOUT, f"the hinge is {remaining:+.2f} rad from its end")
        limit = min(self.max_speed_rad_s, abs(self._speed) + gains.acceleration * self.period_s)
        self._speed = max(-limit, min(limit, gains.gain * remaining))
        return Command(hinge=self._speed)


class Fold(TurnHinge):
    """Fold the slope above the car."""

    def __init__(self, setup: SkillSetup) -> None:
        """Prepare to fold."""
        super().__init__(setup, setup.machines.slope.hinge_range_rad)


class Unfold(TurnHinge):
    """Unfold the slope above the car until its flap lies on the floor."""

    def __init__(self, setup: SkillSetup) -> None:
        """Prepare to unfold."""
        super().__init__(setup, 0.0)
