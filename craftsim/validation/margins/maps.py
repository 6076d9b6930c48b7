"""Two imperfections that grow together: how many trials stand each pair of levels."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Final

from craftsim.experiments.experiment import Done, Item, TrialRecord
from craftsim.validation.margins.axes import Axis
from craftsim.validation.margins.finding import RowFound
from craftsim.validation.margins.trial import Rig

TRIALS: Final = 20
"""Of each pair of levels, at most."""
STRIDE: Final = 4
"""Every fourth level of an axis is on a map: those of the preferred numbers R5, which grow by 60 %."""

Pair = tuple[Axis, Axis]
"""The axes of a map: to the right, and up."""


@dataclass(frozen=True)
class Map:
    """How many trials of a scenario stand each pair of levels."""

    scenario: str
    pair: Pair
    stood: tuple[tuple[int, ...], ...]
    """By the level up, then by the level to the right."""
    of: int
    """Trials of each."""


@dataclass(frozen=True, slots=True)
class MapRow:
    """A row of a map, as it goes to a worker."""

    rig: Rig
    pair: Pair
    up: int
    """Number of its level."""
    trials: int

    @property
    def item(self) -> Item:
        """It, as a campaign's item."""
        right, up = self.pair
        scenario = self.rig.scenario
        key = f"{scenario.name}/{right.name} x {up.name}/{self.up}"
        return Item(key, scenario.action, self.rig.seed, self, context=scenario.name)


def values_of(axis: Axis) -> tuple[float, ...]:
    """Return the values of an axis that are on a map; 0 stands for the base's."""
    return (0.0, *axis.levels[::-1][::STRIDE][::-1])


def rows_of(rig: Rig, pair: Pair, trials: int) -> Iterator[MapRow]:
    """Yield the rows of a map."""
    return (MapRow(rig, pair, up, min(trials, TRIALS)) for up in range(len(values_of(pair[1]))))


def find_row(row: MapRow) -> Done:
    """Try all pairs of levels of one row."""
    right, up = row.pair
    value = values_of(up)[row.up]
    stood = []
    for other in values_of(right):
        levels = [
            (axis, v)
            for axis, v in ((right, other), (up, value))
            if v > axis.value(row.rig.setup.randomization)
        ]
        stood.append(sum(not row.rig.attempt(n, levels).reason for n in range(row.trials)))
    return Done(agrees=True, extra=asdict(RowFound(tuple(stood), row.trials)))


def maps_of(rows: Iterable[tuple[MapRow, TrialRecord]]) -> tuple[Map, ...]:
    """Return the maps that rows with their records make; one with an error in a row is left out."""
    found: dict[tuple[str, Pair], list[TrialRecord]] = {}
    for row, record in rows:
        found.setdefault((row.rig.scenario.name, row.pair), []).append(record)
    return tuple(
        Map(name, pair, tuple(tuple(r["extra"]["stood"]) for r in records), records[0]["extra"]["of"])
        for (name, pair), records in found.items()
        if all(record["error"] is None for record in records)
    )
