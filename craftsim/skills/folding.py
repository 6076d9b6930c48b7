"""Skills of the slope above the car: fold and unfold."""

from __future__ import annotations

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
        """Remember where the hinge is; without a docked slope the skill fails at its first step."""
        self._slope = now.slope
        self._last_rad = now.hinge_rad or 0.0
        travel = abs(self.target_rad - self._last_rad)
        self._deadline_s = travel / self.max_speed_rad_s + self.gains.allowance

    def _control(self, now: CarMeasurement) -> Command:
        if now.hinge_rad is None or now.slope != self._slope:
            self._fail(Reason.MISALIGNED, "the car is not docked to a slope")
            return Command()
        gains = self.gains
        remaining = self.target_rad - now.hinge_rad
        moved, self._last_rad = now.hinge_rad - self._last_rad, now.hinge_rad
        if abs(remaining) < gains.reached and abs(moved) < gains.still * self.period_s and self.elapsed_s > 0:
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
