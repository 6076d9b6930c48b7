"""Work out which neighbours of actions matter, and write craftsim/data/neighbours.csv, which the audit reads.

Neighbours matter if they are within reach, or if a rule set forbids them although they are out of reach. Reach is
that of cars on rollers, whose wheels have corners.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from pandas import DataFrame

from craftsim.audit.neighbours import NAME, neighbours
from craftsim.discrete.rules import RULE_SETS, Rules
from craftsim.mjcf.machines import NOMINAL
from craftsim.storage.writing import write_whole


def rows() -> Iterator[dict[str, Any]]:
    """Yield the rows of the table."""
    rule_sets = [Rules(name) for name in RULE_SETS]
    for one in neighbours(replace(NOMINAL, drive="rollers")):
        if one.clearance is None and all(one.legal(rules) != (False, True) for rules in rule_sets):
            continue
        # Negative for an overlap, empty if out of reach.
        clearance = "" if one.clearance is None else f"{one.clearance.distance_m * 1e3:.1f}"
        named = {"situation": one.situation.id, "occupant": one.occupant.name}
        at = dict(zip(("dx", "dy", "dz"), one.at, strict=True))
        yield named | at | {"clearance_mm": clearance, "closest": one.closest}


if __name__ == "__main__":
    place = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(str(files("craftsim.data"))) / NAME
    write_whole(place, DataFrame(rows()).to_csv(index=False))
