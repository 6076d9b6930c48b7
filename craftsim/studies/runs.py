"""The runs of a study: each a training run in a folder of its own, which goes on where it was cut off."""

from __future__ import annotations

import csv
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

from craftsim.experiments.experiment import Experiment, Result, RunOptions, Trial, TrialRecord
from craftsim.experiments.session import ALONE, run_experiment
from craftsim.storage.folders import directory_within, owned
from craftsim.studies.study import Study, StudyRun
from craftsim.training.config import LEARNED
from craftsim.training.curve import CURVE_FILE

RUNS = "runs"


def run_study(
    study: Study, out: Path, options: RunOptions = ALONE, timeout_s: float = 7200.0
) -> list[TrialRecord]:
    """Do all runs of a study and return a record of each, in the order of its runs.

    A record's ``extra`` holds steps, CPU seconds of training in all calls that it took, the learning curve and, by
    task, what evaluations came to. A run that fails is a record with an error. Of a cut-off study what is finished is
    kept, and a run that was under way goes on from its last evaluation.

    Args:
        study: what to do.
        out: folder for the session and a folder of each run; a Ray cluster shares it.
        options: how.
        timeout_s: after which a run counts as hanging.

    Raises InputError where the folder holds another study.
    """
    asked = study.runs
    folder = out.resolve()
    items = [
        Trial(run.key, f"{run.config.task}, {run.config.algo}", run.config.seed, (run, folder))
        for run in asked
    ]
    digests = {
        name: task.digest for run in asked for name, task in {run.config.task: run.task, **run.tests}.items()
    }
    config = {"study": asdict(study), "digests": digests}
    experiment = Experiment("study", 0, config, items, train_and_evaluate, timeout_s=timeout_s)
    return list(run_experiment(experiment, out, options))


def under_way(study: Study, out: Path, since_s: float) -> list[str]:
    """Return how far each unfinished training run is that was evaluated after a time of the clock, a line each."""
    lines = []
    for run in study.runs:
        path = out / RUNS / run.key / CURVE_FILE
        if not path.is_file() or path.stat().st_mtime < since_s:
            continue
        *_, last = csv.DictReader(path.read_text(encoding="utf-8").splitlines())
        steps, successes, episodes = (int(last[name]) for name in ("steps", "successes", "episodes"))
        if steps < run.steps and successes < run.until * episodes:
            so_far = f"{steps:,} of at most {run.steps:,} steps"
            lines.append(f"{run.key}: {so_far}, {successes} of {episodes} episodes succeed")
    return lines


def train_and_evaluate(asked: tuple[StudyRun, Path]) -> Result:
    """Train, or go on training, and evaluate; what a worker does of a study."""
    run, out = asked
    # Its own too: somebody may go on with this run alone.
    with owned(directory_within(out, RUNS, run.key)) as place:
        return _train_and_evaluate(run, place)


def _train_and_evaluate(run: StudyRun, place: Path) -> Result:
    import torch

    from craftsim.training.checkpoint import RUN_FILE
    from craftsim.training.evaluation import evaluate
    from craftsim.training.trainer import Trainer

    config = run.config
    torch.set_num_threads(1)
    resumed = (place / RUN_FILE).exists()
    tasks: dict[str, Any] = {"task": run.task, "stages": run.stages}
    trainer = Trainer.resume(place, config=config, **tasks) if resumed else Trainer(config, **tasks)
    with closing(trainer):
        for evaluated in trainer.run(run.steps, run.until):
            if evaluated:
                trainer.save(place)
        trainer.save(place)
        extra: dict[str, Any] = {
            "steps": trainer.steps,
            "cpu_s": round(trainer.cpu_s, 1),
            "resumed": resumed,
            "curve": [asdict(point) for point in trainer.curve],
            "evaluations": {
                name: evaluate(
                    trainer.learner.net,
                    task,
                    run.episodes,
                    1,
                    config.rules,
                    config.helper_depth,
                    config.acting,
                ).as_figures()
                for name, task in run.tests.items()
            },
        }
    own = extra["evaluations"][next(iter(run.tests))]["success"]["rate"]
    return Result(agrees=own >= min(run.until, LEARNED), extra=extra)
