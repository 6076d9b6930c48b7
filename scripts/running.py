"""What scripts share that run an experiment and report it: options, clear errors, and runs that can be resumed."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from craftsim.cli.progress import counting
from craftsim.cli.text import print_error
from craftsim.errors import CraftsimError, InputError
from craftsim.experiments.experiment import Experiment, Result, RunOptions, Trial
from craftsim.experiments.ranges import TRIAL_COUNT
from craftsim.experiments.session import interrupted_text, run_experiment
from craftsim.experiments.statistics import carried_out
from craftsim.reports import publishing
from craftsim.reports.report import Report
from craftsim.robots import need_network
from craftsim.storage.folders import owned
from craftsim.storage.limits import SEED, WORKERS
from craftsim.workers.modules import safe_path

ROOT: Final = Path(__file__).parents[1]
TIMEOUT_S: Final = 3600.0
"""After which an episode counts as hanging."""

EpisodeCase = tuple[str, str, int]
"""A policy or a task, the name of a condition, and the number of the episode, which decides all that is drawn."""


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


def condition_options(
    parser: argparse.ArgumentParser, conditions: Collection[str], episodes: int
) -> None:
    """Add the options of a script that plays episodes in some conditions."""
    parser.add_argument(
        "--episodes", type=int, default=episodes, metavar="N", help="of each condition"
    )
    parser.add_argument("--conditions", nargs="+", default=[*conditions], metavar="NAME")


def check_known(word: str, names: Sequence[str], known: Collection[str]) -> None:
    """Raise InputError for a name that is none of a ``word``, such as a condition."""
    for name in names:
        if name not in known:
            raise InputError(f"no {word} '{name}'; there are {', '.join(known)}")


@dataclass(frozen=True)
class EpisodesPlayed:
    """What the episodes of policies or tasks in some conditions came to."""

    by_group: dict[str, list[dict[str, Any]]]
    """Results of those that finished, by policy or task and condition."""
    n_lost: int
    """Number of those that did not finish."""


@dataclass(frozen=True, kw_only=True)
class NetworkEpisodes:
    """Episodes of some policies or tasks in conditions of which some have a network."""

    script: str
    subjects: Sequence[str]
    """Policies or tasks."""
    conditions: Sequence[str]
    seed: int
    """Number of the first episode."""
    episodes: int
    """Of each subject in each condition."""
    config: Mapping[str, Any]
    """A run goes on only with the same."""

    def play(
        self, work: Callable[[EpisodeCase], Result], out: Path, options: RunOptions
    ) -> EpisodesPlayed:
        """Play those that are not in the folder yet.

        Raises InputError for a number of episodes out of range, and where what a network needs is not installed.
        """
        TRIAL_COUNT.check("--episodes", self.episodes)
        need_network()
        experiment = Experiment(
            self.script, self.seed, self.config, self._trials(), work, timeout_s=TIMEOUT_S
        )
        records = run_experiment(experiment, out, options)
        by_group = dict[str, list[dict[str, Any]]]()
        for record in carried_out(records):
            by_group.setdefault(record["group"], []).append(record["extra"])
        n_finished = sum(map(len, by_group.values()))
        return EpisodesPlayed(by_group, len(records) - n_finished)

    def _trials(self) -> list[Trial]:
        """Return one episode of each after the other, so that a run that is broken off has as many of each."""
        trials = []
        for number in range(self.seed, self.seed + self.episodes):
            for subject in self.subjects:
                for condition in self.conditions:
                    group = f"{subject}, {condition}"
                    case = (subject, condition, number)
                    trials.append(Trial(f"{group}, {number}", group, number, case))
        return trials
