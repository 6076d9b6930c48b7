"""A bound on simulated time, for recipes that come from others: by their gains, an action may have no end."""

from __future__ import annotations

from craftsim.checking.checked_site import CheckedSite
from craftsim.errors import InputError
from craftsim.models.world import Site


class OverrunError(InputError):
    """What was begun takes more simulated time than it was given."""


class Timekeeper:
    """Counts the control periods of a world from now on, and ends with OverrunError what takes longer than it may.

    It does not look at the simulation's clock, which starts over when the simulation breaks down.
    """

    def __init__(self, checked: CheckedSite, most_s: float, what: str) -> None:
        """Give whatever is done next ``most_s`` seconds of simulated time, all together; ``what`` is for the error."""
        self._most_s, self._what = most_s, what
        self._period_s = checked.site.config.control_period_s
        self._periods = 0
        checked.executor.observers.append(self._count)

    @property
    def passed_s(self) -> float:
        """Simulated time since then."""
        return self._periods * self._period_s

    def _count(self, site: Site) -> None:
        self._periods += 1
        if self.passed_s > self._most_s:
            raise OverrunError(
                f"{self._what} has not come to its end after {self._most_s:.4g} s of simulated time"
            )
