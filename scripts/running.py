"""What scripts share that run an experiment and report it: options, clear errors, and runs that can be resumed."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Final

from craftsim.cli.progress import counting
from craftsim.cli.text import print_error
from craftsim.errors import CraftsimError
from craftsim.experiments.experiment import RunOptions
from craftsim.experiments.session import interrupted_text
from craftsim.reports import publishing
from craftsim.reports.report import Report
from craftsim.storage.folders import owned
from craftsim.storage.limits import SEED, WORKERS
from craftsim.workers.modules import safe_path

ROOT: Final = Path(__file__).parents[1]


def options(description: str | None, name: str) -> argparse.ArgumentParser:
    """Return a parser of the options that all have; the default folder has the name of the script."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument(
        "--resume", action="store_true", help="continue an interrupted run in its folder"
    )
    parser.add_argument("--out", type=Path, default=Path("out", name), help="folder for the report")
    return parser


def publish(asked: argparse.Namespace, what: str, make: Callable[[RunOptions], Report]) -> int:
    """Make a report and publish it; return the exit status: 2 for invalid input, 130 if interrupted."""
    try:
        SEED.check("--seed", asked.seed)
        WORKERS.check("--workers", asked.workers)
        with safe_path(), owned(asked.out):
            run = RunOptions(asked.workers, resume=asked.resume, progress=counting(what))
            return publishing.publish(make(run), asked.out)
    except CraftsimError as error:
        print_error(error)
        return 2
    except KeyboardInterrupt as error:
        print_error(str(error) or interrupted_text(asked.out, asked.resume) or "interrupted")
        return 130
