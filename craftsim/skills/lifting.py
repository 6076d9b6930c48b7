"""Skills of the lifting board: lift and drop."""

from __future__ import annotations

from craftsim.models.sensing import CarMeasurement
from craftsim.skills.outcome import Reason
from craftsim.skills.skill import Command, Skill, SkillSetup


class MoveBoard(Skill):
    """Bring the board to one end of its travel at no more than its motor's speed."""

    def __init__(self, setup: SkillSetup, target_m: float) -> None:
        """Prepare to bring the board to ``target_m`` above its lower stop."""
        super().__init__(setup)
        self.gains = setup.gains.board
        self.max_speed_m_s = setup.machine.board_speed_m_s
        self.target_m = target_m
        self._speed = 0.0

    def _begin(self, now: CarMeasurement) -> None:
        """Remember where the board is."""
        self._last_m = now.board_m
        travel = abs(self.target_m - now.board_m)
        self._deadline_s = travel / self.max_speed_m_s + self.gains.allowance

    def _control(self, now: CarMeasurement) -> Command:
        gains = self.gains
        remaining = self.target_m - now.board_m
        moved, self._last_m = now.board_m - self._last_m, now.board_m
        if abs(remaining) < gains.reached and abs(moved) < gains.still * self.period_s and self.elapsed_s > 0:
            self._arrived(now)
        elif self.elapsed_s > self._deadline_s:
            self._fail(Reason.TIMEOUT, f"the board is {remaining * 1e3:+.1f} mm from its end")
        limit = min(self.max_speed_m_s, abs(self._speed) + gains.acceleration * self.period_s)
        self._speed = max(-limit, min(limit, gains.gain * remaining))
        return Command(board=self._speed)

    def _arrived(self, now: CarMeasurement) -> None:
        self._succeed()


class Lift(MoveBoard):
    """Raise the board; it must feel a load at the top."""

    def __init__(self, setup: SkillSetup) -> None:
        """Prepare to raise the board to its upper stop."""
        super().__init__(setup, setup.machine.board_travel_m)

    def _arrived(self, now: CarMeasurement) -> None:
        if self.feels_load(now):
            self._succeed()
        else:
            self._fail(Reason.LOAD_LOST, f"the board is up and feels {now.board_force_n:.1f} N")


class Drop(MoveBoard):
    """Lower the board until the load stands on its own legs and the board is clear of it."""

    def __init__(self, setup: SkillSetup) -> None:
        """Prepare to lower the board to its lower stop."""
        super().__init__(setup, 0.0)
