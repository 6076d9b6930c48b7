"""Tune gains, and identify a car: ``craftsim tune``, ``robot excite`` and ``robot identify``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from craftsim.choices import Drive
from craftsim.cli.app import command_again
from craftsim.cli.progress import counting, without_error
from craftsim.cli.text import print_safe
from craftsim.options import Dir, File, Physics, Work, number
from craftsim.storage.folders import owning
from craftsim.storage.limits import EXCITE_M, EXCITE_S, LOGGED_CARS, TRIAL_COUNT

_Objective = Literal["time", "error", "margin", "energy", "force"]


@dataclass(frozen=True, kw_only=True)
class TunedPhysics(Physics):
    """Physics in which gains are tried."""

    drive: Drive | None = "reduced"


@owning
def tune(
    subject: Literal["drive", "board", "hinge", "all"],
    *,
    weights: Annotated[tuple[str, ...], Parameter(metavar="NAME=WEIGHT")] = (),
    objectives: tuple[_Objective, ...] = (),
    choose: Literal["knee", "time", "error", "margin", "energy", "force"] = "knee",
    evaluations: Annotated[int, number(TRIAL_COUNT)] = 400,
    trials: Annotated[int, number(TRIAL_COUNT)] = 2,
    physics: TunedPhysics = TunedPhysics(),
    work: Work = Work(),  # noqa: B008
    out: Dir = Path("out/tune"),
) -> int:
    """Tune the gains of skills in random physics, and write a file of them that --gains takes.

    The search starts from --gains. Its best are tried again on fresh seeds, and the choice among them is
    evaluated on held-out seeds: gains that do no better there than the start are never written. The same physics and
    noise are drawn for all candidates. The drive is the reduced one unless asked otherwise; look at the result on
    rollers, too, with
    'craftsim validate'. Exit status 0 when better gains were found, 1 when not, 2 for wrong input.

    Args:
        subject: skills of driving, of the board, of the hinge, or all; tolerances and times of giving up stay.
        weights: objectives, multiplied with these exponents, such as time=1 energy=0.5; time=1 error=0.2 margin=0.2
            unless given. Objectives are time, error, margin, energy and force.
        objectives: at least two, whose Pareto front is searched instead, such as time margin.
        choose: the point of the front that is taken: its knee, or the best by an objective.
        evaluations: candidates that the search tries.
        trials: of each situation, for every candidate.
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
