"""Tune gains, and identify a car: ``craftsim tune``, ``robot excite`` and ``robot identify``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from craftsim.choices import Drive
from craftsim.cli.app import command_again
from craftsim.cli.progress import counting, without_error
from craftsim.cli.text import print_safe
from craftsim.options import Dir, File, Physics, Work, number, own_defaults
from craftsim.storage.folders import owning
from craftsim.storage.limits import EXCITE_M, EXCITE_S, LOGGED_CARS, TRIAL_COUNT

_Objective = Literal["time", "error", "margin", "energy", "force"]


@owning
@own_defaults
def tune(
    subject: Literal["drive", "board", "hinge", "all"],
    *,
    weights: Annotated[tuple[str, ...], Parameter(metavar="NAME=WEIGHT")] = (),
    objectives: tuple[_Objective, ...] = (),
    choose: Literal["knee", "time", "error", "margin", "energy", "force"] = "knee",
    evaluations: Annotated[int, number(TRIAL_COUNT)] = 400,
    trials: Annotated[int, number(TRIAL_COUNT)] = 2,
    physics: Physics = Physics(drive="reduced"),  # noqa: B008
    work: Work = Work(),  # noqa: B008
    out: Dir = Path("out/tune"),
) -> int:
    """Tune the gains of skills in randomized physics, and write them to a file for --gains.

    The search starts from --gains. The best candidates are tried again on fresh seeds, and the chosen one is evaluated
    on held-out seeds: gains that are not better there are never written. All candidates face the same physics and
    noise. The default drive is the reduced one; check the result on rollers with 'craftsim validate'. Exit status: 0 if
    better gains were found, 1 if not, 2 for invalid input.

    Args:
        subject: skills to tune: driving, board, hinge, or all; tolerances and timeouts stay fixed.
        weights: exponents of the objectives time, error, margin, energy and force, which are multiplied; default:
            time=1 error=0.2 margin=0.2.
        objectives: at least two objectives, whose Pareto front is searched instead, such as time margin.
        choose: the point of the front to take: its knee, or the best for one objective.
        evaluations: number of candidates.
        trials: trials of each situation for each candidate.
        out: folder for gains.yaml, report.html, report.json and trials.jsonl.
    """
    from craftsim.tuning.goal import Goal
    from craftsim.tuning.tune import tune as run
    from craftsim.tuning.tune_report import tune_report, write_gains

    goal = Goal.of(weights, objectives, choose)
    tuned = run(
        subject,
        physics.setup(),
        out,
        goal=goal,
        evaluations=evaluations,
        trials=trials,
        seed=physics.seed,
        options=work.run(counting("evaluations", without_error)),
    )
    command = command_again()
    gains = write_gains(out, tuned, command)
    return tune_report(tuned, gains, command, work.workers).publish(out)


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
    """Drive a car along an excitation trajectory with wheel commands alone, and log commands and measurements.

    The car drives back and forth in all directions, at several speeds and accelerations, with rests; the board goes up
    and down once. The commands can be replayed on a robot; 'craftsim robot identify' reads the log. Exit status: 0, 1
    if the car left its area, 2 for invalid input.

    Args:
        duration: duration in seconds.
        length: length of the free area along the car's heading in metres, centred on the car.
        width: width of the free area in metres.
        load: the car starts under a block behind the area, lifts it, drives with it, puts it down and drives out.
        out: folder for log.csv, commands.csv and report.json.
    """
    import numpy as np

    from craftsim.checking.setup import Seed
    from craftsim.logs.files import write_commands, write_table
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
    print_safe(f"Log:      {out / 'log.csv'}\nCommands: {out / 'commands.csv'}\nReport:   {report}")
    print_safe(
        f"{log.duration_s:.1f} s; the car came {reach[0]:.2f} m along and {reach[1]:.2f} m across from the centre, "
        f"and ended {np.hypot(*way[-1]):.2f} m from it"
    )
    return 0 if figures["stayed"] else 1


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
    """Fit a car's parameters, and the delay, lags and biases of its sensors and motors, to a log.

    Reports the uncertainty of each estimate, which parameters the log cannot identify and why, and the prediction error
    of the identified car. Exit status: 0, 1 if nothing is identifiable, 2 for invalid input.

    Args:
        log: CSV table or ROS 2 bag (.mcap), as docs/reference/reports.md describes. 'craftsim robot excite' makes a
            suitable trajectory.
        held_out: another log of the same car, for validation.
        car: number of the car in the log.
        load: the car started under a block and lifted it, as with 'robot excite --load'.
        topics: YAML file that maps the topics of a bag.
        machines: YAML file of machine parameters: initial values, and values that are not fitted.
        drive: drive of the simulated car; rollers take several times as long.
        out: folder for parameters.yaml (for --machines), noise.yaml (for --noise), report.json and figures.
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
