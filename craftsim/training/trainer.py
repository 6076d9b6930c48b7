"""The training loop: play, learn, look how well it goes, keep what was learnt."""

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

from craftsim.discrete.errors import InputError
from craftsim.discrete.tasks import Task, make_task
from craftsim.report import versions
from craftsim.training.algorithms import make_learner
from craftsim.training.checkpoint import POLICY_FILE, RUN_FILE, read_run, save_policy, save_run
from craftsim.training.config import TrainConfig
from craftsim.training.evaluation import Played, evaluate
from craftsim.training.extra import PACKAGES
from craftsim.training.features import Shape
from craftsim.training.grid_env import GridEnv
from craftsim.training.interrupts import finishing_first
from craftsim.training.novelty import Novelty

LOOKS_EVERY: Final = 10
"""Iterations from one evaluation to the next."""
LOOKS_AT: Final = 500
"""Episodes of an evaluation while training."""
_PLAYING, _LOOKING, _FINAL = range(3)


@dataclass(frozen=True)
class Point(Played):
    """A point of the learning curve: how well a policy did on fresh episodes after so much training."""

    steps: int
    """Ticks played, all worlds together."""


class Trainer:
    """A training run. After each iteration it is where another run of the same configuration would be, bit for bit."""

    def __init__(self, config: TrainConfig, starts: Task | None = None) -> None:
        """Prepare a run; ``starts`` is the task with other starts to train from, where they are not its own."""
        self.config = config
        self.task = make_task(config.task)
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

        Yields after each iteration whether the curve has a new point. A Ctrl-C is heard between two iterations.
        """
        while self.steps < steps and not (self.curve and self.curve[-1].success >= until):
            begun = time.perf_counter()
            with finishing_first():
                self._iterate()
                looks = self.iteration % LOOKS_EVERY == 0
                if looks:
                    played = self.evaluate(LOOKS_AT, _LOOKING)
                    self.curve.append(Point(**asdict(played), steps=self.steps))
                self.wall_s += time.perf_counter() - begun
            yield looks

    def evaluate(self, episodes: int, purpose: int = _FINAL) -> Played:
        """Play fresh episodes with what was learnt so far."""
        return evaluate(self.learner.net, self.task, episodes, self._seed(purpose))

    def _iterate(self) -> None:
        seed = self._seed(_PLAYING)
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
        save_policy(folder / POLICY_FILE, self.config, self.shape, self.learner.net, training_versions())
        save_run(
            folder / RUN_FILE,
            {
                "config": self.config.as_dict(),
                "versions": training_versions(),
                "iteration": self.iteration,
                "wall_s": self.wall_s,
                "curve": [asdict(point) for point in self.curve],
                "learner": self.learner.state(),
                "novelty": self.novelty.counts,
            },
        )

    @classmethod
    def resume(cls, folder: Path, starts: Task | None = None) -> Trainer:
        """Return the run that a folder holds, as it was when it was saved."""
        content: dict[str, Any] = read_run(folder / RUN_FILE)
        try:
            trainer = cls(TrainConfig.from_dict(content["config"]), starts)
            trainer.iteration, trainer.wall_s = content["iteration"], content["wall_s"]
            trainer.curve = [Point(**point) for point in content["curve"]]
            trainer.learner.restore(content["learner"])
            trainer.novelty.counts = content["novelty"]
        except (KeyError, TypeError, RuntimeError) as error:
            raise InputError(
                f"{folder / RUN_FILE}: not a run of this version of craftsim ({error})"
            ) from error
        return trainer


def training_versions() -> dict[str, str]:
    """Return the versions that decide what is learnt."""
    return {**versions(), **{name: version(name) for name in PACKAGES}}
