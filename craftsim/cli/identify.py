"""``craftsim robot identify``: a car's parameters from its commands and measurements."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from craftsim.choices import Drive
from craftsim.cli.options import Dir, File
from craftsim.options import number
from craftsim.storage.folders import owning
from craftsim.storage.limits import LOGGED_CARS


@owning
def identify(
    log: Annotated[Path, Parameter(metavar="LOG")],
    *,
    held_out: File = None,
    car: Annotated[int, number(LOGGED_CARS)] = 0,
    load: bool = False,
    topics: File = None,
    machines: File = None,
    drive: Drive = "reduced",
    out: Dir = Path("out/identify"),
) -> int:
    """Fit a car's parameters, and the delay, lags and biases of its sensors and motors, to a log of it.

    Says how sure each figure is, what the log cannot tell and why, and how well the identified car predicts the log.
    Exit status 0, 1 when the log tells nothing, 2 for wrong input.

    Args:
        log: CSV table or ROS 2 bag (.mcap); docs/reference/reports.md has its columns.
            'craftsim robot excite' makes a drive to log.
        held_out: another log of the same car, to be predicted and not to be fitted to.
        car: its number in the log.
        load: the car began under a block and lifted it, as with 'robot excite --load'.
        topics: YAML file that says which topics of a bag hold what.
        machines: YAML file of machine parameters that are assumed: where the search begins, and what is held.
        drive: how the car is simulated; rollers take several times as long.
        out: folder for parameters.yaml (for --machines), noise.yaml (for --noise), report.json and the figures.
    """
    import time
    from dataclasses import replace

    from craftsim.checking.setup import setup_of
    from craftsim.logs.files import read_log
    from craftsim.reports.json_file import document
    from craftsim.reports.terminal import Terminal
    from craftsim.tuning import identified as findings
    from craftsim.tuning.identification import identify as fit
    from craftsim.tuning.identified import draw_prediction, identified_report
    from craftsim.tuning.prediction import Predictor

    started = time.perf_counter()
    assumed = setup_of(machines=machines, drive=drive).machines
    assumed = replace(assumed, cars=(assumed.car(min(car, len(assumed.cars) - 1)),))
    given = read_log(log, car, topics)
    other = None if held_out is None else Predictor(read_log(held_out, car, topics), assumed, load)
    console = Terminal()
    with console.status("fitting") as status:
        found = fit(given, assumed, load, lambda number, total: status.update(f"fit {number} of {total}"))
    predictor = Predictor(given, assumed, load)
    figures = findings.figures_of(found, predictor, other)
    left_out = findings.write_parameters(out / "parameters.yaml", found, assumed, log.name)
    findings.write_noise(out / "noise.yaml", found, given, log.name)
    figures["left_out"] = left_out
    drawn = draw_prediction(out, found, other or predictor)
    config: dict[str, Any] = {
        "log": log.name,
        "held_out": None if held_out is None else held_out.name,
        "car": car,
    }
    config |= {"load": load, "machines": assumed, "digests": {"machines": assumed.digest}}
    wall = {"total_s": time.perf_counter() - started}
    files = {
        "Parameters": out / "parameters.yaml",
        "Noise": out / "noise.yaml",
        "Figure": drawn[0],
    }
    written = document(figures, command="identify", config=config, wall=wall)
    return identified_report(found, log.name, written, files).publish(out, console)
