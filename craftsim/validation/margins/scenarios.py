"""The scenarios whose margins are searched: the car gets to its place by itself, and then does what is judged.

A car that has just driven under a block stands there as well as it knows its place: that decides what it can lift. So
the actions that do not drive come after one that does. Mirror images are left out, for the machines are alike left and
right; diagonal moves are never legal.
"""

from __future__ import annotations

from fnmatch import fnmatchcase
from typing import Final, NamedTuple

from craftsim.audit.situation import SCENES, Row, Situation, shipped
from craftsim.audit.survey import row_of, situation_of
from craftsim.discrete.rules import RuleSet
from craftsim.errors import InputError


class Scenario(NamedTuple):
    """A situation by the names that people have for it; its last action is judged."""

    action: str
    """Of the data sheet's row, such as ``lift``."""
    where: str
    """Such as ``a block between blocks``."""
    row: Row

    @property
    def name(self) -> str:
        """Both, as people say it."""
        return f"{self.action} {self.where}"

    def situation(self, rules: RuleSet) -> Situation:
        """Return the situation. Raises CraftsimError where there is none, or the rules forbid what is done first."""
        if self.row.scene:
            return next(scene for scene in SCENES if scene.row == self.row)
        return situation_of(self.row, rules)


CHOSEN: Final = tuple(
    Scenario(action, where, row_of(said))
    for action, places in shipped("margins.yaml").items()
    for where, said in places.items()
)
"""Those of ``craftsim/data/margins.yaml``."""


def scenarios(pattern: str = "*", quick: bool = False) -> tuple[Scenario, ...]:
    """Return the scenarios whose names match a pattern as of file names; quick: the first one of each action.

    Raises InputError where none does.
    """
    first = {one.action: one for one in reversed(CHOSEN)}
    found = tuple(
        one for one in CHOSEN if fnmatchcase(one.name, pattern) and (not quick or one is first[one.action])
    )
    if not found:
        names = ", ".join(one.name for one in CHOSEN)
        raise InputError(f"no scenario matches '{pattern}'; there are {names}")
    return found
