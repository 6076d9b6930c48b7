"""Cheap slow work in a process of its own, to be killed: run_cheap.py OUT cheap|after [--resume]."""

import sys
from pathlib import Path

import cheap_work

from craftsim.cli import main
from craftsim.experiments.experiment import RunOptions
from craftsim.experiments.session import open_session, run_experiment

ITEMS = cheap_work.items(40, **{f"i{i}": "slow" for i in range(40)})


def cheap(resume: bool = False) -> int:
    """Run the experiment as a command would."""
    held = {"i39": ("slow while", OUT.parent / "held")}
    items = cheap_work.items(40, **{f"i{i}": "slow" for i in range(39)}, **held)
    experiment = cheap_work.experiment(items, "cheap", batch=3)
    run_experiment(experiment, OUT, RunOptions(workers=2, resume=resume))
    return 0


def after(resume: bool = False) -> int:
    """Do what a finished run still needs; each item leaves a file."""
    jobs = {item.key: (OUT, item.job) for item in ITEMS}
    with open_session(
        cheap_work.experiment(1), OUT, RunOptions(workers=2, resume=resume)
    ) as session:
        session.run()
        session.map(None, jobs, cheap_work.leave, "leaving files", timeout_s=60.0)
    return 0


if __name__ == "__main__":
    import craftsim.cli

    OUT, NAME = Path(sys.argv[1]), sys.argv[2]
    sys.modules[f"craftsim.cli.{NAME}"] = sys.modules["__main__"]
    craftsim.cli.COMMANDS[NAME] = "Test."
    sys.exit(main([NAME, *sys.argv[3:]]))
