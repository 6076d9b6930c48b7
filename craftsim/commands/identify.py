"""``craftsim identify``: a car's figures from what it was told and measured."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from craftsim.commands.options import Dir, File
from craftsim.commands.terminal import Terminal
from craftsim.commands.text import say
from craftsim.mjcf.parameters import Drive
from craftsim.storage.folders import owning
from craftsim.storage.limits import LOGGED_CARS

if TYPE_CHECKING:
    from craftsim.tuning.identification import Identification, Identified


@owning
def identify(
    log: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")],
    held_out: File = None,
    car: Annotated[int, LOGGED_CARS] = 0,
    load: bool = False,
    topics: File = None,
    parameters: File = None,
    drive: Drive = "reduced",
    out: Dir = Path("out/identify"),
) -> int:
    """Fit a car's figures, and the delay, lags and biases of its sensors and motors, to a log of it.

    Says how sure each figure is, what the log cannot tell and why, and how well the identified car predicts the log.
    Exit status 0, 1 when the log tells nothing, 2 for wrong input.

    Args:
        log: CSV table or ROS 2 bag (.mcap); docs/reference/reports.md has its columns. 'craftsim excite' makes a
            drive to log.
        held_out: another log of the same car, to be predicted and not to be fitted to.
        car: its number in the log.
        load: the car began under a block and lifted it, as with 'excite --load'.
        topics: YAML file that says which topics of a bag hold what.
        parameters: YAML file of machine parameters that are assumed: where the search begins, and what is held.
        drive: how the car is simulated; rollers take several times as long.
        out: folder for parameters.yaml (for --parameters), noise.yaml (for --noise), report.json and the figures.
    """
    import time
    from dataclasses import replace

    from craftsim.checking.setup import setup_of
    from craftsim.logs.files import read_log
    from craftsim.report import write_report
    from craftsim.tuning import findings
    from craftsim.tuning.identification import identify as fit
    from craftsim.tuning.identified_plot import draw_prediction
    from craftsim.tuning.prediction import Predictor

    started = time.perf_counter()
    machines = setup_of(machines=parameters, drive=drive).machines
    machines = replace(machines, cars=(machines.car(min(car, len(machines.cars) - 1)),))
    given = read_log(log, car, topics)
    other = None if held_out is None else Predictor(read_log(held_out, car, topics), machines, load)
    console = Terminal()
    with console.status("fitting") as status:
        found = fit(given, machines, load, lambda number, total: status.update(f"fit {number} of {total}"))
    predictor = Predictor(given, machines, load)
    figures = findings.figures_of(found, predictor, other)
    left_out = findings.write_parameters(out / "parameters.yaml", found, machines, log.name)
    findings.write_noise(out / "noise.yaml", found, given, log.name)
    figures["left_out"] = left_out
    drawn = draw_prediction(out, found, other or predictor)
    config: dict[str, Any] = {
        "log": log.name,
        "held_out": None if held_out is None else held_out.name,
        "car": car,
    }
    config |= {"load": load, "machines": machines, "digests": {"machines": machines.digest}}
    wall = {"total_s": time.perf_counter() - started}
    report = write_report(out, figures, command="identify", config=config, wall=wall)
    console.print(_table(found))
    for text in figures["untold"]:
        say(f"Not told: {text}")
    for text in left_out:
        say(f"Not in parameters.yaml: {text}")
    for name, of in (("fitted_log", log), ("held_out_log", held_out)):
        if name in figures:
            say(_prediction(f"{of}", figures[name]))
    say(f"Parameters: {out / 'parameters.yaml'}\nNoise:      {out / 'noise.yaml'}")
    say(f"Figure:     {drawn[0]}\nReport:     {report}")
    return 0 if any(one.told for one in found.estimates) else 1


def _table(found: Identification) -> object:
    from rich.table import Table

    table = Table("what", "assumed", "identified", "95 % interval")
    for one in found.estimates:
        table.add_row(one.unknown.words, f"{one.start:.4g}", *_said(one))
    return table


def _said(one: Identified) -> tuple[str, str]:
    if one.half_width is None:
        return "held", ""
    return f"{one.value:.4g}", "at the border of the search" if one.at_bound else f"+- {one.half_width:.2g}"


def _prediction(name: str, figures: dict[str, dict[str, dict[str, object]]]) -> str:
    """Return a line on how well a log is predicted."""
    parts = []
    for channel, errors in figures["as_identified"].items():
        was = figures["as_assumed"][channel]["rms"]
        parts.append(f"{channel} {errors['rms']:.3g} {errors['unit']} (as assumed {was:.3g})")
    return f"RMS error of 1.5 s predictions, {name}: {', '.join(parts)}"
