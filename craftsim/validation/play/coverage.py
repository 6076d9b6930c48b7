"""What random play covered: how often each action was done, and beside what."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from craftsim.checking.attempt import Attempt
from craftsim.discrete.grid import Kind
from craftsim.validation.play.neighbourhood import NEIGHBOURS, Doing
from craftsim.validation.play.play import Play
from craftsim.validation.statistics.records import Record

ALL: Final = "all"
"""The column that counts every action once; the others count it beside each thing that is around it."""


def covered(played: Play, attempts: Iterable[Attempt]) -> dict[str, dict[str, int]]:
    """Return how often each thing was done: by name, ``all`` and the neighbours that there were. JSON knows it.

    Only what was performed counts.
    """
    done = {(a.tick, a.car) for a in attempts if a.performed}
    found: dict[str, Counter[str]] = {}
    for tick, (joint, doings) in enumerate(zip(played.ticks, played.doings, strict=True)):
        for (car, _), doing in zip(joint, doings, strict=True):
            if (tick, car) in done:
                found.setdefault(doing.name, Counter()).update((ALL, *doing.near, *_classes(doing)))
    return {name: dict(counts) for name, counts in found.items()}


def _classes(doing: Doing) -> list[str]:
    """Return the totals that an action counts in, whatever is around it."""
    loaded_turn = doing.verb.startswith("ROTATE") and doing.load != Kind.AIR
    classes = {
        "on slopes": doing.on_slope,
        "turns of loads": loaded_turn,
        "folding": doing.verb in ("FOLD", "UNFOLD"),
        "above the floor": doing.level > 1,
    }
    return [f"~{name}" for name, holds in classes.items() if holds]


@dataclass(frozen=True)
class Coverage:
    """What all runs of a campaign covered together."""

    worlds: int
    do_not_stand: int
    """Worlds besides that cannot be: something would stand in something else. Nothing is tried there."""
    actions: int
    totals: dict[str, int]
    """Actions on slopes, turns of loads, of folding and unfolding, above the floor."""
    rows: dict[str, dict[str, int]]
    """By what was done: ``all``, and how often beside each of the neighbours."""

    @classmethod
    def of(cls, records: Iterable[Record]) -> Coverage | None:
        """Return what the records of a campaign covered; None where nothing was played."""
        played = fallen = 0
        counts: dict[str, Counter[str]] = {}
        for extra in (record["extra"] for record in records):
            fallen += "does_not_stand" in extra
            played += "coverage" in extra
            for name, found in extra.get("coverage", {}).items():
                counts.setdefault(name, Counter()).update(found)
        if not played:
            return None
        every = sum(counts.values(), Counter())
        totals = {key[1:]: n for key, n in sorted(every.items()) if key.startswith("~")}
        rows = {name: {key: counts[name][key] for key in (ALL, *NEIGHBOURS)} for name in sorted(counts)}
        return cls(played, fallen, every[ALL], totals, rows)
