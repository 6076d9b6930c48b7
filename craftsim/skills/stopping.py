"""The skill that does nothing: come to rest."""

from __future__ import annotations

from craftsim.models.measuring import CarMeasurement
from craftsim.skills.outcome import Reason
from craftsim.skills.skill import Command, Skill


class Stop(Skill):
    """Command all motors to zero until the wheels rest."""

    def _begin(self, now: CarMeasurement) -> None:
        """Need nothing."""

    def _control(self, now: CarMeasurement) -> Command:
        """End when the wheels rest, or have not come to rest for too long."""
        gains, fastest = self.setup.gains.stop, max(map(abs, now.wheel_speeds))
        if self.elapsed_s > 0 and fastest < gains.wheels_at_rest:
            self._succeed()
        elif self.elapsed_s > gains.allowance:
            self._fail(Reason.TIMEOUT, "the wheels still turn")
        return Command()
