"""Skills of the lifting board: lift and drop."""

from __future__ import annotations

from craftsim.models.parameters import SMARTCAR
from craftsim.models.sensing import CarMeasurement
from craftsim.skills.gains import BoardGains
from craftsim.skills.outcome import Reason
from craftsim.skills.skill import Command, Skill, feels_load

_ALLOWANCE_S = 2.0
_REACHED_M = 0.0012
_STILL_M_S = 0.0015


class MoveBoard(Skill):
    """Bring the board to one end of its travel at no more than the published speed."""

    def __init__(self, period_s: float, gains: BoardGains, target_m: float) -> None:
        """Prepare to bring the board to ``target_m`` above its lower stop."""
        super().__init__(period_s)
        self.gains = gains
        self.target_m = target_m
        self._speed = 0.0

    def _begin(self, now: CarMeasurement) -> None:
        """Remember where the board is."""
        self._last_m = now.board_m
        travel = abs(self.target_m - now.board_m)
        self._deadline_s = travel / SMARTCAR.board_speed_m_s + _ALLOWANCE_S

    def _control(self, now: CarMeasurement) -> Command:
        remaining = self.target_m - now.board_m
        moved, self._last_m = now.board_m - self._last_m, now.board_m
        if abs(remaining) < _REACHED_M and abs(moved) < _STILL_M_S * self.period_s and self.elapsed_s > 0:
            self._arrived(now)
        elif self.elapsed_s > self._deadline_s:
            self._fail(Reason.TIMEOUT, f"the board is {remaining * 1e3:+.1f} mm from its end")
        limit = min(SMARTCAR.board_speed_m_s, abs(self._speed) + self.gains.acceleration * self.period_s)
        self._speed = max(-limit, min(limit, self.gains.gain * remaining))
        return Command(board=self._speed)

    def _arrived(self, now: CarMeasurement) -> None:
        self._succeed()


class Lift(MoveBoard):
    """Raise the board; it must feel a load at the top."""

    def __init__(self, period_s: float, gains: BoardGains) -> None:
        """Prepare to raise the board to its upper stop."""
        super().__init__(period_s, gains, SMARTCAR.board_travel_m)

    def _arrived(self, now: CarMeasurement) -> None:
        if feels_load(now):
            self._succeed()
        else:
            self._fail(Reason.LOAD_LOST, f"the board is up and feels {now.board_force_n:.1f} N")


class Drop(MoveBoard):
    """Lower the board until the load stands on its own legs and the board is clear of it."""

    def __init__(self, period_s: float, gains: BoardGains) -> None:
        """Prepare to lower the board to its lower stop."""
        super().__init__(period_s, gains, 0.0)
