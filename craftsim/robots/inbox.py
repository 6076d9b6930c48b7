"""Commands that have come to robots: which is to be obeyed now, and whether too long none has come."""

from __future__ import annotations

from collections import deque
from typing import Final

from craftsim.robots.messages import Commands

WATCHDOG_S: Final = 0.1
"""Without a command for so long robots stop by themselves: five control periods."""
_KEPT: Final = 64
"""Commands that wait for their time; more is no driver but a mistake."""
_AHEAD_S: Final = 1.0
"""How far ahead of its time a command may come."""
_EPSILON_S: Final = 1e-6


class Inbox:
    """The commands of one driver, numbered by it."""

    def __init__(self, watchdog_s: float = WATCHDOG_S) -> None:
        """Wait for a driver; the robots stand."""
        self.watchdog_s = watchdog_s
        self.heard, self.late_s, self.heard_s = 0, 0.0, 0.0
        """Number of the newest command that came, by how much after its time it did, and when."""
        self.stops = self.dropped = 0
        """How often too long none came; commands that came after newer ones had begun, or too early."""
        self.standing = True
        self._obeyed: Commands | None = None
        self._waiting: list[Commands] = []
        self._taken: deque[int] = deque(maxlen=4 * _KEPT)

    def begin(self) -> None:
        """Forget the driver: the next one counts anew."""
        self.heard, self.late_s, self.standing = 0, 0.0, True
        self._obeyed, self._waiting = None, []
        self._taken.clear()

    def take(self, message: Commands, now_s: float) -> bool:
        """Take a command that has come, and return whether it is of use."""
        if message.number in self._taken:
            return False
        obeyed = 0 if self._obeyed is None else self._obeyed.number
        if message.number < obeyed or len(self._waiting) == _KEPT or message.at_s > now_s + _AHEAD_S:
            self.dropped += 1
            return False
        self._taken.append(message.number)
        if message.number > self.heard:
            self.heard, self.late_s, self.heard_s = message.number, now_s - message.at_s, now_s
            self.standing = False
        self._waiting.append(message)
        return True

    def obey(self, now_s: float) -> Commands | None:
        """Return what the motors are to do from now on; None stops them."""
        if not self.standing and now_s - self.heard_s > self.watchdog_s - _EPSILON_S:
            self.stops += 1
            self.standing = True
            self._waiting = []
        if self.standing:
            return None
        due = [message for message in self._waiting if message.at_s <= now_s + _EPSILON_S]
        if due:
            newest = max(due, key=lambda message: message.number)
            self._obeyed = newest
            self._waiting = [message for message in self._waiting if message.number > newest.number]
        return self._obeyed
