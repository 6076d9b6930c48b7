"""``craftsim audit clearance``: what comes in the way of which action, and do the rules know it?"""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from craftsim.choices import RuleSet
from craftsim.cli.options import Actions, Dir, File, check_actions
from craftsim.storage.folders import owning

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from craftsim.audit.neighbours import Neighbour
    from craftsim.discrete.rules import Rules
    from craftsim.reports.report import DataTable, Report


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
    from craftsim.audit.neighbours import neighbours
    from craftsim.discrete.rules import Rules
    from craftsim.mjcf.parameters import NOMINAL, load_machines
    from craftsim.reports.json_file import document

    check_actions(actions)
    parameters = NOMINAL if machines is None else load_machines(machines)
    judged = [_judged(one, Rules(rules)) for one in neighbours(parameters, actions)]
    listed = [one for one in judged if one["clearance_mm"] is not None or _unexplained(one)]
    written = document(
        {"clearance": {"neighbours": len(judged), "rows": listed}},
        command="clearance",
        seed=0,
        config={"rules": rules, "actions": actions, "machines": parameters.digest},
    )
    return _report(judged, rules, written).publish(out)


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


def _report(judged: Sequence[Mapping[str, Any]], rules: RuleSet, written: Mapping[str, Any]) -> Report:
    """Return the report; ``written`` is what ``report.json`` holds."""
    from craftsim.reports.report import Column, DataTable, Headline, KeyFigure, Report, Section, Tone, count

    allowed, unexplained = _findings(judged)
    rows = []
    for name, group in groupby(judged, lambda one: one["situation"]):
        row = list(group)
        reach = [one["clearance_mm"] for one in row if one["clearance_mm"] is not None]
        counts = (len(row), len(reach), sum(mm < 0 for mm in reach))
        rows.append((name, *counts, *(len(found) for found in _findings(row))))
    heads = ("neighbours", "within reach", "in the way", "allowed", "unexplained")
    columns = (Column("situation", "path"), *(Column(name, "number") for name in heads))
    table = DataTable(columns, rows, "Situations", tall=True, most=100)
    findings = [
        _findings_table("Collisions that the rules allow", allowed),
        _findings_table("Forbidden although out of reach", unexplained),
    ]
    sentence = (
        f"The {rules} rules allow {count(len(allowed), 'collision')} of {count(len(judged), 'neighbour')}."
    )
    return Report(
        "Clearance of actions",
        f"rule set: {rules}",
        Headline("Collides", Tone.BAD, sentence) if allowed else Headline("Clear", Tone.GOOD, sentence),
        [
            KeyFigure(f"{len(found):,}", name)
            for name, found in (("collisions allowed", allowed), ("forbidden out of reach", unexplained))
        ],
        [
            Section(
                "situations", "Situations", "The volume that each action sweeps.", [table], terminal=True
            ),
            Section("findings", "Findings", "The deepest first.", findings, terminal=True),
        ],
        document=written,
        exit_code=1 if allowed else 0,
    )


def _findings_table(title: str, found: Sequence[Mapping[str, Any]]) -> DataTable:
    from craftsim.reports.report import Column, DataTable

    rows = [
        (
            f"{one['situation']}/near={one['occupant']}@({','.join(map(str, one['at']))})",
            None if one["clearance_mm"] is None else f"{one['clearance_mm']:.1f}",
            one["closest"] or None,
        )
        for one in found
    ]
    columns = (Column("situation and neighbour", "path"), Column("mm", "number"), Column("closest"))
    return DataTable(columns, rows, f"{title}: {len(found)}", tall=True, most=30)
