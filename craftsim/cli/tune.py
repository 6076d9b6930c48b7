"""Tune gains; serve simulated robots, excite and identify a car: ``craftsim tune`` and ``robot``."""

from __future__ import annotations

import contextlib
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from craftsim.cli.app import command_again
from craftsim.cli.options import Dir, File
from craftsim.cli.progress import counting, stage_display, without_error
from craftsim.cli.text import print_error, print_safe
from craftsim.errors import InputError
from craftsim.experiments.ranges import TRIAL_COUNT
from craftsim.mjcf.drives import Drive
from craftsim.reports.publishing import publish
from craftsim.robots import ROBOT_HOST, ROBOT_PORT, need_network
from craftsim.robots.ranges import DELAY_MS, LOGGED_CARS, PACE, PATIENCE_S
from craftsim.storage import limits
from craftsim.storage.folders import owning
from craftsim.tuning.ranges import EXCITE_M, EXCITE_S
from craftsim.validation.options import Physics, Work, number

IDENTIFY_EVERY_S = 5.0
"""Time between two lines of progress."""

_Objective = Literal["time", "error", "margin", "energy", "force"]


@owning
def tune(
    subject: Literal["drive", "board", "hinge", "all"],
    *,
    weights: Annotated[tuple[str, ...], Parameter(metavar="NAME=WEIGHT")] = (),
    objectives: tuple[_Objective, ...] = (),
    choose: Literal["knee", "time", "error", "margin", "energy", "force"] = "knee",
    evaluations: Annotated[int, number(TRIAL_COUNT)] = 400,
    trials: Annotated[int, number(TRIAL_COUNT)] = 2,
    physics: Physics = Physics(),  # noqa: B008
    work: Work = Work(),  # noqa: B008
    out: Dir = Path("out/tune"),
) -> int:
    """Tune the gains of skills in randomized physics, and write them to a file for --gains.

    The search starts from --gains, and ends with changes of single gains of the best candidate. The best candidates are
    tried again on fresh seeds and in whole plans, and the chosen one is evaluated on held-out seeds: gains that are not
    better there, or that fail in a plan in which the start does not, are never written. All candidates face the same
    physics and noise. Exit status: 0 if better gains were found, 1 if not, 2 for invalid input.

    Args:
        subject: skills to tune: driving, board, hinge, or all; tolerances and timeouts stay fixed.
        weights: exponents of the objectives time, error, margin, energy and force, which are multiplied; default:
            time=1 error=0.2 margin=0.2.
        objectives: at least two objectives, whose Pareto front is searched instead, such as time margin.
        choose: the point of the front to take: its knee, or the best for one objective.
        evaluations: number of candidates of the search, about; 20 for each gain are needed. The best are evaluated some
            100 times more, which the progress counts, too.
        trials: trials of each situation for each candidate.
        out: folder for gains.yaml, report.html, report.json and trials.jsonl.
    """
    from craftsim.tuning.goal import TuningGoal
    from craftsim.tuning.tune import tune as run
    from craftsim.tuning.tune_report import tune_report, write_gains

    goal = TuningGoal.of(weights, objectives, choose)
    options = work.run(counting("evaluations of candidates, plans included", without_error))
    tuned = run(
        subject,
        physics.setup(),
        out,
        goal=goal,
        evaluations=evaluations,
        trials=trials,
        seed=physics.seed,
        options=options,
        tell=print_safe,
    )
    command = command_again()
    report = tune_report(tuned, write_gains(out, tuned, command), command, work.workers)
    return publish(report, out)


@owning
def serve(
    task: str = "simple_two_story",
    *,
    host: Annotated[str, Parameter(metavar="ADDRESS")] = ROBOT_HOST,
    port: Annotated[int, number(limits.PORTS)] = ROBOT_PORT,
    key: File = None,
    delay_ms: Annotated[float, number(DELAY_MS)] = 0.0,
    jitter_ms: Annotated[float, number(DELAY_MS)] = 0.0,
    loss: Annotated[float, number(limits.SHARE)] = 0.0,
    silent: Annotated[tuple[str, ...], Parameter(metavar="CAR:SECONDS")] = (),
    pace: Annotated[float, number(PACE)] = 1.0,
    lockstep: bool = False,
    timeout: Annotated[float, number(PATIENCE_S)] = 60.0,
    once: bool = False,
    physics: Physics = Physics(),  # noqa: B008
    out: Dir = Path("out/robot"),
) -> int:
    """Simulate robots in the world of a task, and serve them on a network: 'craftsim demo --robot ADDRESS' drives them.

    Prints the address, and serves them until Ctrl-C. Exit status: 0, or 2 for invalid input.

    Args:
        task: world of the robots: the name of a task, a start or task file, or 'module:factory'.
        host: address to listen on; the default is reachable from this machine only, any other needs a key.
        port: port; 0 takes a free one.
        key: file that who drives the robots must have, too (docs/how-to/robots.md); all is encrypted then.
        delay_ms: network delay of a message in each direction; drawn from the seed, as jitter and loss.
        jitter_ms: half-width of the uniform distribution of the delay.
        loss: share of lost messages.
        silent: a car that stops and does not answer any more after so many seconds of its clock, such as 1:5; may be
            repeated.
        pace: seconds of the robots' time per second.
        lockstep: stop the robots' time until each measurement has been answered, so that a seed gives the same run on
            any machine.
        timeout: time limit of an answer in lock-step, after which time goes on without it.
        once: exit when the client disconnects.
        out: folder for report.json.
    """
    need_network()
    import numpy as np

    from craftsim.checking.setup import Seed, set_up
    from craftsim.reports.json_file import write_report
    from craftsim.robots.link import world_digest
    from craftsim.robots.server import Network, Server, Service
    from craftsim.robots.simulated import simulated_robots
    from craftsim.robots.sockets import Host
    from craftsim.skills.fleet import PhysicsFleet
    from craftsim.tasks import as_task

    network = Network(delay_ms / 1e3, jitter_ms / 1e3, loss, tuple(map(_silent, silent)))
    setup = physics.setup()
    task_of_world = as_task(task)
    start_seed, world_seed, *network_seeds = np.random.SeedSequence(physics.seed).spawn(4)
    grid = task_of_world.draw(np.random.default_rng(start_seed))
    rngs = tuple(map(np.random.default_rng, network_seeds))
    start_s = time.perf_counter()
    with contextlib.closing(Host(host, port, key)) as sockets:
        world = set_up(grid, setup, Seed.of(world_seed), watch_contacts=False).executor.fleet
        assert isinstance(world, PhysicsFleet)
        robots = simulated_robots(world, network.silent)
        service = Service(
            robots, world, sockets.send, network, rngs, world_digest(grid), lockstep, print_error
        )
        sockets.tell = service.mention
        server = Server(service, sockets, pace, timeout)
        print_safe(
            f"{len(service.robots)} robots of {task_of_world.name} at {sockets.address} (Ctrl-C ends it)"
        )
        sys.stdout.flush()
        with contextlib.suppress(KeyboardInterrupt):
            server.run(lambda: once and service.farewells > 0)
        server.end()
    figures: dict[str, Any] = {
        "simulated_s": round(service.now_s, 6),
        "commands_dropped": service.inbox.dropped,
        "messages_malformed": service.malformed,
        "connections_refused": sockets.refused,
        "stopped_at_s": service.stopped_at_s,
    }
    config: dict[str, Any] = {
        **setup.provenance,
        "network": network,
        "pace": pace,
        "lockstep": lockstep,
    }
    config["task"] = task_of_world.name
    wall = {"total_s": time.perf_counter() - start_s, "behind_s": server.behind_s}
    report = write_report(
        out, figures, command="robot", seed=physics.seed, config=config, wall=wall
    )
    print_safe(
        f"{service.now_s:.1f} s of the robots' time, {server.behind_s:.2f} s behind the clock; for want of commands "
        f"they stopped {service.inbox.stops} times.\nReport: {report}"
    )
    return 0


def _silent(text: str) -> tuple[int, float]:
    car, _, seconds = text.partition(":")
    try:
        return int(car), float(seconds)
    except ValueError:
        raise InputError(
            f"--silent {text}: allowed: a car and seconds, such as 1:5 for car 1 after 5 s"
        ) from None


@owning
def excite(
    *,
    duration: Annotated[float, number(EXCITE_S)] = 120.0,
    length: Annotated[float, number(EXCITE_M)] = 2.0,
    width: Annotated[float, number(EXCITE_M)] = 2.0,
    load: bool = False,
    physics: Physics = Physics(),  # noqa: B008
    out: Dir = Path("out/excite"),
) -> int:
    """Drive a car along an excitation trajectory with wheel commands alone, and log commands and measurements.

    The car drives back and forth in all directions, at several speeds and accelerations, with rests; the board goes up
    and down once. The commands can be replayed on a robot; 'craftsim robot identify' reads the log. Prints the
    parameters of the simulated car, as --randomize has drawn them. Exit status: 0, 1 if the car left its area or the
    solver gave up, 2 for invalid input.

    Args:
        duration: duration in seconds.
        length: length of the free area along the car's heading in metres, centred on the car.
        width: width of the free area in metres.
        load: the car starts under a block behind the area, lifts it, drives with it, puts it down and drives out.
        out: folder for log.csv, commands.csv and report.json.
    """
    import numpy as np

    from craftsim.checking.attempt import capped_text
    from craftsim.checking.setup import Seed
    from craftsim.reports.json_file import write_report
    from craftsim.robots.log_files import COMMAND_COLUMNS, write_table
    from craftsim.tuning.excitation import Area, drive, excitation, free_area

    setup = physics.setup()
    area = Area(length, width)
    period_s = setup.simulation.control_period_s
    commands = excitation(duration, area, setup.machines.car(0), period_s, load)
    driven = drive(free_area(area, load), setup, Seed((physics.seed,)), commands)
    log = driven.log
    parameters = driven.drawn
    # From the area's centre; the heading at the start is that of its length.
    path = log.pose[:, :2] - log.pose[0, :2] - [area.from_load_m if load else 0.0, 0.0]
    if not load:
        inside = path
    else:
        inside = path[path[:, 0] > -length / 2]
    reach = np.nanmax(np.abs(inside), axis=0)
    figures = {"rows": len(log), "period_s": period_s, "reach_m": reach, "end_m": path[-1]}
    figures["drawn"] = parameters
    figures["capped_steps"] = driven.capped_steps
    figures["stayed"] = bool((reach < [length / 2, width / 2]).all())
    write_table(out / "log.csv", {0: log})
    write_table(out / "commands.csv", {0: log}, COMMAND_COLUMNS)
    config = {
        **setup.provenance,
        "time_s": duration,
        "length_m": length,
        "width_m": width,
        "load": load,
    }
    report = write_report(out, figures, command="excite", seed=physics.seed, config=config)
    print_safe(f"Log:      {out / 'log.csv'}\nCommands: {out / 'commands.csv'}\nReport:   {report}")
    print_safe("The car that was driven:")
    for name, values in parameters.items():
        print_safe(f"  {name}: {', '.join(f'{value:.4g}' for value in values)}")
    print_safe(
        f"{log.duration_s:.1f} s; the car came {reach[0]:.2f} m along and {reach[1]:.2f} m across from the centre, "
        f"and ended {np.hypot(*path[-1]):.2f} m from it"
    )
    if driven.capped_steps:
        print_safe(f"Note: {capped_text(driven.capped_steps)}: this is no log of a car")
    if figures["stayed"] and not driven.capped_steps:
        return 0
    return 1


@owning
def identify(
    log: Annotated[Path, Parameter(metavar="LOG")],
    *,
    held_out: File = None,
    car: Annotated[int, number(LOGGED_CARS)] = 0,
    load: bool = False,
    topics: File = None,
    machines: File = None,
    drive: Drive = "wheels",
    out: Dir = Path("out/identify"),
) -> int:
    """Fit a car's parameters, and the delay, lags and biases of its sensors and motors, to a log.

    Reports the uncertainty of each estimate, which parameters the log cannot identify and why, what the model leaves of
    the log compared with the noise of the measurements, and the prediction error of the identified car. Exit status: 0,
    1 if the model does not fit the log or nothing is identifiable, 2 for invalid input.

    Args:
        log: CSV table or ROS 2 bag (.mcap, or a folder with one), as docs/reference/reports.md describes. 'craftsim
            robot excite' makes a suitable trajectory.
        held_out: another log of the same car, for validation.
        car: number of the car in the log.
        load: the car started under a block and lifted it, as with 'robot excite --load'.
        topics: YAML file that maps the topics of a bag.
        machines: YAML file of machine parameters: initial values, and values that are not fitted.
        drive: model of the simulated car's wheels; rollers take several times as long.
        out: folder for parameters.yaml (for --machines), noise.yaml (for --noise), report.json and figures.
    """
    from craftsim.checking.setup import setup_of
    from craftsim.reports.json_file import document
    from craftsim.reports.terminal import Terminal
    from craftsim.robots.log_files import read_log
    from craftsim.tuning import identified as findings
    from craftsim.tuning.identification import identify as fit
    from craftsim.tuning.identified import draw_prediction, identified_report
    from craftsim.tuning.prediction import Predictor

    started = time.perf_counter()
    assumed = setup_of(machines=machines, drive=drive).machines
    assumed = replace(assumed, cars=(assumed.car(min(car, len(assumed.cars) - 1)),))
    log_read = read_log(log, car, topics)
    held_out_predictor = None
    if held_out is not None:
        held_out_predictor = Predictor(read_log(held_out, car, topics), assumed, load)
    console = Terminal()
    with stage_display(f"identify {log.name}", IDENTIFY_EVERY_S) as tell:
        identification = fit(log_read, assumed, load, tell)
    predictor = Predictor(log_read, assumed, load)
    figures = findings.identification_figures(identification, predictor, held_out_predictor)
    figures["notes"] = [f"{log.name}: {note}" for note in log_read.notes]
    if held_out is not None and held_out_predictor is not None:
        figures["notes"] += [f"{held_out.name}: {note}" for note in held_out_predictor.log.notes]
    files = {"Parameters": out / "parameters.yaml", "Noise": out / "noise.yaml"}
    figures["left_out"] = findings.write_parameters(
        files["Parameters"], identification, assumed, log.name
    )
    findings.write_noise(files["Noise"], identification, log_read, log.name)
    files["Figure"] = draw_prediction(out, identification, held_out_predictor or predictor)[0]
    config: dict[str, Any] = {
        "log": log.name,
        "held_out": held_out and held_out.name,
        "car": car,
        "load": load,
    }
    config |= {"machines": assumed, "digests": {"machines": assumed.digest}}
    wall = {"total_s": time.perf_counter() - started}
    written = document(figures, command="identify", config=config, wall=wall)
    return publish(identified_report(identification, log.name, written, files), out, console)
