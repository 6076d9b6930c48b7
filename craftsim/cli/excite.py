"""``craftsim robot excite``: a drive that tells much about a car."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from craftsim.cli.options import Dir
from craftsim.cli.text import say
from craftsim.options import Physics, number
from craftsim.storage.folders import owning
from craftsim.storage.limits import EXCITE_M, EXCITE_S


@owning
def excite(
    *,
    duration: Annotated[float, number(EXCITE_S, "SECONDS")] = 120.0,
    length: Annotated[float, number(EXCITE_M, "METRES")] = 2.0,
    width: Annotated[float, number(EXCITE_M, "METRES")] = 2.0,
    load: bool = False,
    physics: Physics = Physics(),  # noqa: B008
    out: Dir = Path("out/excite"),
) -> int:
    """Drive a car through an identification drive by wheel commands alone, and log what is commanded and measured.

    Out and back in all directions, at several speeds and accelerations, with rests; the board goes up and down once.
    The commands can be replayed on a robot, and 'craftsim robot identify' takes its log. Exit status 0, 1 when the car
    left its area, 2 for wrong input.

    Args:
        duration: of the drive.
        length: metres of the free area along the car's heading, the car in its centre.
        width: metres of the free area across.
        load: the car begins under a block behind the area, lifts it, moves with it, puts it down and drives out.
        out: folder for log.csv, commands.csv and report.json.
    """
    import numpy as np

    from craftsim.checking.setup import Seed
    from craftsim.logs.tables import write_commands, write_table
    from craftsim.reports.json_file import write_report
    from craftsim.tuning.excitation import Area, drive, excitation, free_area

    setup, area = physics.setup(), Area(length, width)
    period_s = setup.simulation.control_period_s
    commands = excitation(duration, area, setup.machines.car(0), period_s, load)
    log = drive(free_area(area, load), setup, Seed((physics.seed,)), commands)
    # From the area's centre; the heading at the start is that of its length.
    way = log.pose[:, :2] - log.pose[0, :2] - [area.from_load_m if load else 0.0, 0.0]
    inside = way if not load else way[way[:, 0] > -length / 2]
    reach = np.nanmax(np.abs(inside), axis=0)
    figures = {"rows": len(log), "period_s": period_s, "reach_m": reach, "end_m": way[-1]}
    figures["stayed"] = bool((reach < [length / 2, width / 2]).all())
    write_table(out / "log.csv", {0: log})
    write_commands(out / "commands.csv", {0: log})
    config = {"setup": setup, "time_s": duration, "length_m": length, "width_m": width, "load": load}
    config |= {"digests": setup.digests}
    report = write_report(out, figures, command="excite", seed=physics.seed, config=config)
    say(f"Log:      {out / 'log.csv'}\nCommands: {out / 'commands.csv'}\nReport:   {report}")
    say(
        f"{log.duration_s:.1f} s; the car came {reach[0]:.2f} m along and {reach[1]:.2f} m across from the centre, "
        f"and ended {np.hypot(*way[-1]):.2f} m from it"
    )
    return 0 if figures["stayed"] else 1
