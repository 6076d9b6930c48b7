"""``craftsim tune``: better gains of the skills, by declared objectives."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from craftsim.choices import Drive
from craftsim.cli.again import command_again
from craftsim.cli.options import Dir
from craftsim.options import Physics, number
from craftsim.storage.folders import owning
from craftsim.storage.limits import TRIAL_COUNT, WORKERS

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
    workers: Annotated[int, number(WORKERS)] = 1,
    resume: bool = False,
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
        workers: processes to share the work; results do not depend on it.
        resume: go on with what an interrupted run has left in the output folder.
        out: folder for gains.yaml, report.html, report.json and trials.jsonl.
    """
    from craftsim.cli.progress import counting
    from craftsim.experiments.experiment import RunOptions
    from craftsim.reports.terminal import Terminal
    from craftsim.tuning.goal import Goal
    from craftsim.tuning.tune import tune as run
    from craftsim.tuning.tune_report import tune_report, write_gains

    goal = Goal.of(weights, objectives, choose)
    setup = physics.setup()
    console = Terminal()
    tuned = run(
        subject,
        setup,
        out,
        goal=goal,
        evaluations=evaluations,
        trials=trials,
        seed=physics.seed,
        options=RunOptions(
            workers,
            resume=resume,
            progress=lambda total: counting(
                console, "evaluations", total, lambda record: record["error"] is None
            ),
        ),
    )
    command = command_again()
    gains = write_gains(out, tuned, command)
    return tune_report(tuned, gains, command, workers).publish(out, console)
