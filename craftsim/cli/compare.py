"""``craftsim compare``: how far is a simulation from reality?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from craftsim.cli.options import Dir
from craftsim.options import number
from craftsim.storage.folders import owning
from craftsim.storage.limits import SEED


@owning
def compare(
    run: Path,
    other: Path,
    *,
    seed: Annotated[int, number(SEED)] = 0,
    out: Dir = Path("out/compare"),
) -> int:
    """Compare a simulation with reality, or any two runs of the same plans: outcomes, durations, errors and ranks.

    Trials are paired by their names: worlds, plans or policies, and numbers. Exit status 0 when no difference in how
    many trials agree with the rules shows at 5 %, 1 when one does, 2 for runs that cannot be compared.

    Args:
        run: folder of 'craftsim validate' or 'craftsim audit'.
        other: folder of the other run of the same trials.
        seed: decides the bootstrap of the correlations' intervals.
        out: folder for report.json.
    """
    from craftsim.experiments.compare import compare_with_reality
    from craftsim.experiments.gap_report import gap_report
    from craftsim.validation.forms import read_run

    gap = compare_with_reality(read_run(run), read_run(other), seed)
    return gap_report(gap, run, other, seed).publish(out)
