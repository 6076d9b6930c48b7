"""What the rules make of the neighbours: collisions that they allow, and what they forbid without a collision."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from craftsim.discrete.rules import Rules, RuleSet
from craftsim.mjcf.parameters import Machines
from craftsim.validation.neighbourhoods.neighbours import neighbours


@dataclass(frozen=True)
class JudgedNeighbour:
    """One neighbour, and whether the rules allow the action beside it."""

    situation: str
    occupant: str
    at: tuple[int, int, int]
    clearance_mm: float | None
    """Negative: by so much it is in the way; None: it is out of reach."""
    closest: str
    """The solids that come closest."""
    legal: bool
    legal_alone: bool
    """Without the neighbour, but with what bears it."""

    @property
    def uncovered(self) -> bool:
        """Whether it is a collision that no rule covers."""
        return self.legal and self.clearance_mm is not None and self.clearance_mm < 0.0

    @property
    def unexplained(self) -> bool:
        """Whether the rules forbid the action because of it, though it is out of reach."""
        return self.legal_alone and not self.legal and self.clearance_mm is None

    def __str__(self) -> str:
        place = ",".join(map(str, self.at))
        depth = "" if self.clearance_mm is None else f" {self.clearance_mm:.1f} mm, {self.closest}"
        return f"{self.situation}/near={self.occupant}@({place}){depth}"


def judged_neighbours(
    rule_set: RuleSet, machines: Machines, actions: Collection[str] = ()
) -> list[JudgedNeighbour]:
    """Return every neighbour of the bare situations of these verbs, or of all, as a rule set judges it."""
    rules = Rules(rule_set)
    judged = []
    for one in neighbours(machines, actions):
        found = one.clearance
        judged.append(
            JudgedNeighbour(
                one.situation.name,
                one.occupant.name,
                one.at,
                None if found is None else round(found.distance_m * 1e3, 2),
                "" if found is None else f"{found.mine} and {found.theirs}",
                rules.legal(one.grid, 0, one.situation.action),
                rules.legal(one.alone, 0, one.situation.action),
            )
        )
    return judged
