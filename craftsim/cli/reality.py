"""Compare contacts and drives with recordings of real motion: ``craftsim reality``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any, Final

from cyclopts import Parameter

from craftsim.cli.options import Dir, File
from craftsim.cli.progress import stage_display
from craftsim.errors import InputError
from craftsim.reports.publishing import publish
from craftsim.storage import limits
from craftsim.storage.folders import owning
from craftsim.validation.options import number

_TELL_EVERY_S: Final = 10.0
"""Time between two lines of progress."""


@owning
def reality(
    data: Annotated[tuple[Path, ...], Parameter(metavar="DATA")] = (),
    *,
    machines: File = None,
    seed: Annotated[int, number(limits.SEED)] = 0,
    out: Dir = Path("out/reality"),
) -> int:
    """Compare the contact law and the drives with recordings of real motion.

    Tosses of a cube are simulated from their first states; a robot's measured wheel angles drive simulated wheels.
    Errors stand beside those of baselines and of fits to a part of the data, tested on the rest. Exit status: 0 if
    nothing differs from what is declared, 1 if anything does, 2 for invalid input.

    Args:
        data: recordings, recognized by what they hold: tosses (.npz with states and length), drives of one robot (.npz
            with wheels and pose), or its logs (.csv, .mcap); docs/how-to/reality.md describes them.
        machines: YAML file of machine parameters, of the robot of logs.
        seed: random seed of what is fitted to, of searches and of intervals.
        out: folder for report.html and report.json.
    """
    from craftsim.mjcf.machines import NOMINAL, load_machines, machine_file
    from craftsim.reality.reality_report import compare_recordings, reality_report
    from craftsim.reality.recordings import read_recording

    if not data:
        raise InputError("no recordings given; name one or more .npz, .csv or .mcap files")
    begin_s = time.perf_counter()
    declared = NOMINAL
    if machines is not None:
        declared = load_machines(machine_file(machines))
    recordings = [read_recording(path, declared) for path in data]
    with stage_display("reality", _TELL_EVERY_S) as tell:
        figures = compare_recordings(recordings, seed, tell)
    config: dict[str, Any] = {
        "data": [path.name for path in data],
        "machines": declared,
        "digests": {"machines": declared.digest},
    }
    wall_s = time.perf_counter() - begin_s
    return publish(reality_report(figures, seed, config, wall_s), out)
