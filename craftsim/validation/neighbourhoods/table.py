"""The nominal machines' neighbours, worked out once: ``python -m craftsim.validation.neighbourhoods.table [FILE]``.

Working them out takes a minute, too long for each audit; ``make neighbours`` writes them again.
"""

from __future__ import annotations

import csv
import io
import sys
from collections.abc import Collection, Iterator
from dataclasses import astuple, dataclass, fields
from importlib.resources import files
from pathlib import Path

from craftsim.discrete.grid import Cell
from craftsim.discrete.rules import RULE_SETS, Rules
from craftsim.mjcf.parameters import NOMINAL
from craftsim.storage.writing import write_whole
from craftsim.validation.neighbourhoods.neighbours import Neighbour, neighbours

NAME = "neighbours.csv"


@dataclass(frozen=True)
class Entry:
    """A neighbour that matters: within reach, or forbidden by a rule set although it is not."""

    situation: str
    occupant: str
    dx: int
    dy: int
    dz: int
    clearance_mm: str
    """Negative: by so much it is in the way; empty: out of reach."""
    closest: str
    """The solids that come closest."""

    @property
    def at(self) -> Cell:
        """Cell of the occupant."""
        return self.dx, self.dy, self.dz


def entries(actions: Collection[str] = ()) -> Iterator[Entry]:
    """Work out the neighbours that matter to these verbs, or to all."""
    rule_sets = [Rules(name) for name in RULE_SETS]
    for one in neighbours(NOMINAL, actions):
        action = one.situation.action
        if one.clearance is None and all(
            rules.legal(one.grid, 0, action) or not rules.legal(one.alone, 0, action) for rules in rule_sets
        ):
            continue
        yield _entry(one)


def _entry(one: Neighbour) -> Entry:
    near = one.clearance
    clearance = "" if near is None else f"{near.distance_m * 1e3:.1f}"
    closest = "" if near is None else f"{near.mine} and {near.theirs}"
    return Entry(one.situation.name, one.occupant.name, *one.at, clearance, closest)


def write_entries(path: Path) -> None:
    """Write all that matters into a CSV file, which is whole or as it was."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(field.name for field in fields(Entry))
    writer.writerows(map(astuple, entries()))
    write_whole(path, text.getvalue())


def read_entries() -> list[Entry]:
    """Return what the package's file lists."""
    text = files("craftsim.data").joinpath(NAME).read_text(encoding="utf-8")
    rows = csv.DictReader(text.splitlines())
    return [
        Entry(**{**row, "dx": int(row["dx"]), "dy": int(row["dy"]), "dz": int(row["dz"])})  # type: ignore[arg-type]
        for row in rows
    ]


if __name__ == "__main__":
    write_entries(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(str(files("craftsim.data"))) / NAME)
