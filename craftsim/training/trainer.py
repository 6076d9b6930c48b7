"""The training loop: rollout, update, evaluation now and then, checkpoints."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torchrl.envs.utils import ExplorationType, set_exploration_type

from craftsim.discrete.tasks import Task, as_task
from craftsim.errors import InputError
from craftsim.report import versions
from craftsim.training.algorithms import make_learner
from craftsim.training.checkpoint import POLICY_FILE, RUN_FILE, read_run, save_policy, save_run
from craftsim.training.config import TrainConfig
from craftsim.training.evaluation import Played, evaluate
from craftsim.training.extra import PACKAGES
from craftsim.training.features import Shape
from craftsim.training.grid_env import GridEnv
from craftsim.training.identity import TaskIdentity, starts_digest
from craftsim.training.interrupts import finishing_first
from craftsim.training.novelty import Novelty

EVALUATION_INTERVAL: Final = 10
"""Iterations from one evaluation to the next."""
EVALUATION_EPISODES: Final = 500
"""Episodes of an evaluation while training."""
_ROLLOUT, _EVALUATION, _FINAL = range(3)


@dataclass(frozen=True)
class Point(Played):
    """A point of the learning curve: how well a policy did on fresh episodes after so much training."""

    steps: int
    """Ticks played, all worlds together."""


class Trainer:
    """A training run. After each iteration it is where another run of the same configuration would be, bit for bit."""

    def __init__(self, config: TrainConfig, starts: Task | None = None, task: Task | None = None) -> None:
        """Prepare a run.

        Args:
            config: what decides the run.
            starts: the task with other starts to train from, where they are not its own.
            task: the task itself; made of its name in the configuration unless given.

        Raises:
            InputError: there is no such task.
        """
        self.config = config
        self.task = task or as_task(config.task, config.n_cars, config.n_blocks)
        self.identity = TaskIdentity.of(self.task)
        self.starts = "" if starts is None else starts_digest(starts)
        """Digest of the other starts; empty without."""
        self.shape = Shape.of(self.task, config.width)
        self.env = GridEnv(starts or self.task, config.worlds)
        self.iteration = 0
        self.curve: list[Point] = []
        self.wall_s = 0.0
        with torch.random.fork_rng():
            torch.manual_seed(config.seed)
            self.learner = make_learner(config, self.shape, self.task.max_steps + 2)
        self.novelty = Novelty(config.novelty, self.shape)

    @property
    def steps(self) -> int:
        """Ticks played so far, all worlds together."""
        return self.iteration * self.steps_an_iteration

    @property
    def steps_an_iteration(self) -> int:
        """Ticks played between two updates, all worlds together."""
        return self.learner.ticks * self.config.worlds

    def run(self, steps: int, until: float) -> Iterator[bool]:
        """Train for so many steps in all, or until an evaluation has that success.

        Yields after each iteration whether the curve has a new point. Ctrl-C takes effect between two iterations.
        """
        while self.steps < steps and not (self.curve and self.curve[-1].success >= until):
            begun = time.perf_counter()
            with finishing_first():
                self._iterate()
                evaluates = self.iteration % EVALUATION_INTERVAL == 0
                if evaluates:
                    played = self.evaluate(EVALUATION_EPISODES, _EVALUATION)
                    self.curve.append(Point(**asdict(played), steps=self.steps))
                self.wall_s += time.perf_counter() - begun
            yield evaluates

    def evaluate(self, episodes: int, purpose: int = _FINAL) -> Played:
        """Evaluate the policy as it is on fresh episodes."""
        return evaluate(self.learner.net, self.task, episodes, self._seed(purpose))

    def _iterate(self) -> None:
        seed = self._seed(_ROLLOUT)
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            self.env.set_seed(seed)
            with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
                rollout = self.env.rollout(self.learner.ticks, self.learner.plays, break_when_any_done=False)
            self.novelty.add_to(rollout)
            self.learner.update(rollout)
        self.iteration += 1

    def _seed(self, purpose: int) -> int:
        words = np.random.SeedSequence([self.config.seed, purpose, self.iteration]).generate_state(1)
        return int(words[0])

    def save(self, folder: Path) -> None:
        """Write the policy and all that is needed to go on."""
        net, made_with = self.learner.net, training_versions()
        save_policy(folder / POLICY_FILE, self.config, self.identity, self.shape, net, made_with)
        save_run(
            folder / RUN_FILE,
            {
                "config": self.config.as_dict(),
                "task": self.identity.as_dict(),
                "starts": self.starts,
                "versions": made_with,
                "iteration": self.iteration,
                "wall_s": self.wall_s,
                "curve": [asdict(point) for point in self.curve],
                "learner": self.learner.state(),
                "novelty": self.novelty.counts,
            },
        )

    @classmethod
    def resume(cls, folder: Path, starts: Task | None = None, task: Task | None = None) -> Trainer:
        """Return the run that a folder holds, as it was when it was saved.

        Raises InputError where the task or the other starts are not those that it was begun with.
        """
        path = folder / RUN_FILE
        content: dict[str, Any] = read_run(path)
        try:
            trainer = cls(TrainConfig.from_dict(content["config"]), starts, task)
            if TaskIdentity(**content["task"]).digest != trainer.identity.digest:
                raise InputError(
                    f"{path}: the task '{trainer.task.name}' has changed since the run was begun"
                )
            if content["starts"] != trainer.starts:
                begun = "other starts" if content["starts"] else "no other starts"
                raise InputError(
                    f"{path}: the run was begun with {begun} than these; give the --starts of then"
                )
            trainer.iteration, trainer.wall_s = content["iteration"], content["wall_s"]
            trainer.curve = [Point(**point) for point in content["curve"]]
            trainer.learner.restore(content["learner"])
            trainer.novelty.counts = content["novelty"]
        except (KeyError, TypeError, RuntimeError) as error:
            raise InputError(f"{path}: not a run of this version of craftsim ({error})") from error
        return trainer


def training_versions() -> dict[str, str]:
    """Return the versions that decide what a run learns."""
    return {**versions(), **{name: version(name) for name in PACKAGES}}
