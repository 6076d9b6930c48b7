"""``craftsim audit clearance``: what comes in the way of which action, and do the rules know it?"""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from craftsim.choices import RuleSet
from craftsim.cli.options import Actions, Dir, File, check_actions
from craftsim.cli.text import say
from craftsim.storage.folders import owning

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from craftsim.audit.neighbours import Neighbour
    from craftsim.discrete.rules import Rules

_SHOWN: Final = 30
"""How many findings of a kind are printed; the others are in the report."""


@owning
def clearance(
    *,
    actions: Actions = (),
    rules: RuleSet = "physical",
    machines: File = None,
    out: Dir = Path("out/clearance"),
) -> int:
    """Compare the volume that each action sweeps with all that may be near, and with what the rules forbid.

    Geometry alone decides: the solids of the machines on their way, one neighbour at a time. It takes about a minute.
    Exit status 0 when every collision is forbidden, 1 when not, 2 for wrong input.

    Args:
        actions: only these actions.
        rules: the rule set that is compared.
        machines: YAML file of machine parameters, for machines of other dimensions.
        out: folder for report.json, which lists every neighbour within reach.
    """
    from rich.table import Table

    from craftsim.audit.neighbours import neighbours
    from craftsim.cli.terminal import Terminal
    from craftsim.discrete.rules import Rules
    from craftsim.mjcf.machine_files import load_machines
    from craftsim.mjcf.parameters import NOMINAL
    from craftsim.report import write_report

    check_actions(actions)
    parameters = NOMINAL if machines is None else load_machines(machines)
    judged = [_judged(one, Rules(rules)) for one in neighbours(parameters, actions)]
    table = Table("situation", "neighbours", "within reach", "in the way", "allowed", "unexplained", box=None)
    table.columns[0].no_wrap = True
    for column in table.columns[1:]:
        column.justify = "right"
    for name, group in groupby(judged, lambda one: one["situation"]):
        row = list(group)
        reach = [one["clearance_mm"] for one in row if one["clearance_mm"] is not None]
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
    listed = [one for one in judged if one["clearance_mm"] is not None or _unexplained(one)]
    write_report(
        out,
        {"clearance": {"neighbours": len(judged), "rows": listed}},
        command="clearance",
        seed=0,
        config={"rules": rules, "actions": actions, "machines": parameters.digest},
        wall={},
    )
    say(f"Report: {out / 'report.json'}")
    return 1 if allowed else 0


def _judged(one: Neighbour, rules: Rules) -> dict[str, Any]:
    """Return what the report says of a neighbour: how close it comes, and whether the rules allow the action."""
    legal, alone = one.legal(rules)
    return {
        "situation": one.situation.id,
        "occupant": one.occupant.name,
        "at": one.at,
        "clearance_mm": None if one.clearance is None else round(one.clearance.distance_m * 1e3, 2),
        "closest": one.closest,
        "legal": legal,
        "legal_alone": alone,
    }


def _unexplained(one: Mapping[str, Any]) -> bool:
    """Return whether the rules forbid the action because of it, though it is out of reach."""
    return one["legal_alone"] and not one["legal"] and one["clearance_mm"] is None


def _findings(judged: Sequence[Mapping[str, Any]]) -> tuple[list[Mapping[str, Any]], list[Mapping[str, Any]]]:
    """Return the collisions that are allowed, the deepest first, and what is forbidden without one."""
    allowed = [one for one in judged if one["legal"] and (one["clearance_mm"] or 0.0) < 0.0]
    return sorted(allowed, key=lambda one: one["clearance_mm"]), [one for one in judged if _unexplained(one)]


def _list(title: str, found: Sequence[Mapping[str, Any]]) -> None:
    say(f"{title}: {len(found)}")
    for one in found[:_SHOWN]:
        place = ",".join(map(str, one["at"]))
        depth = "" if one["clearance_mm"] is None else f" {one['clearance_mm']:.1f} mm, {one['closest']}"
        say(f"  {one['situation']}/near={one['occupant']}@({place}){depth}")
    if len(found) > _SHOWN:
        say(f"  and {len(found) - _SHOWN} more in the report")
