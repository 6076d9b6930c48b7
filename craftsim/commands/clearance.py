"""``craftsim clearance``: what comes in the way of which action, and do the rules know it?"""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import tyro

from craftsim.commands.options import File
from craftsim.commands.text import say
from craftsim.discrete.rules import RuleSet
from craftsim.storage.folders import owning
from craftsim.validation.contexts.context import Verb

if TYPE_CHECKING:
    from craftsim.validation.neighbourhoods.findings import JudgedNeighbour

_SHOWN: Final = 30
"""How many findings of a kind are printed; the others are in the report."""


@owning
def clearance(
    actions: tuple[Verb, ...] = (),
    rules: RuleSet = "physical",
    parameters: File = None,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("out/clearance"),
) -> int:
    """Compare the volume that each action sweeps with all that may be near, and with what the rules forbid.

    Geometry alone decides: the solids of the machines on their way, one neighbour at a time. It takes about a minute.
    Exit status 0 when every collision is forbidden, 1 when not, 2 for wrong input.

    Args:
        actions: only these actions.
        rules: the rule set that is compared.
        parameters: YAML file of machine parameters, for machines of other dimensions.
        out: folder for report.json, which lists every neighbour within reach.
    """
    from rich.table import Table

    from craftsim.commands.terminal import Terminal
    from craftsim.mjcf.machine_files import load_machines
    from craftsim.mjcf.parameters import NOMINAL
    from craftsim.report import write_report
    from craftsim.validation.neighbourhoods.findings import judged_neighbours

    machines = NOMINAL if parameters is None else load_machines(parameters)
    judged = judged_neighbours(rules, machines, actions)
    table = Table("situation", "neighbours", "within reach", "in the way", "allowed", "unexplained", box=None)
    table.columns[0].no_wrap = True
    for column in table.columns[1:]:
        column.justify = "right"
    for name, group in groupby(judged, lambda one: one.situation):
        row = list(group)
        reach = [one.clearance_mm for one in row if one.clearance_mm is not None]
        counts = (
            len(row),
            len(reach),
            sum(mm < 0 for mm in reach),
            *(len(found) for found in _findings(row)),
        )
        table.add_row(name, *map(str, counts))
    console = Terminal(highlight=False)
    console.print(table)
    allowed, unexplained = _findings(judged)
    _list("Collisions that the rules allow", allowed)
    _list("Forbidden although out of reach", unexplained)
    listed = [one for one in judged if one.clearance_mm is not None or one.unexplained]
    write_report(
        out,
        {"clearance": {"neighbours": len(judged), "rows": listed}},
        command="clearance",
        seed=0,
        config={"rules": rules, "actions": actions, "machines": machines.digest},
        wall={},
    )
    say(f"Report: {out / 'report.json'}")
    return 1 if allowed else 0


def _findings(judged: list[JudgedNeighbour]) -> tuple[list[JudgedNeighbour], list[JudgedNeighbour]]:
    """Return the collisions that are allowed, the deepest first, and what is forbidden without one."""
    allowed = sorted((one for one in judged if one.uncovered), key=lambda one: one.clearance_mm or 0.0)
    return allowed, [one for one in judged if one.unexplained]


def _list(title: str, found: list[JudgedNeighbour]) -> None:
    say(f"{title}: {len(found)}")
    for one in found[:_SHOWN]:
        say(f"  {one}")
    if len(found) > _SHOWN:
        say(f"  and {len(found) - _SHOWN} more in the report")
