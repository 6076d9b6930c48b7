"""How well a policy does: whole episodes on the grid, from the task's own starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from craftsim.discrete.tasks import Task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.training.grid_env import offered
from craftsim.training.networks import CarNet


@dataclass(frozen=True)
class Played:
    """What came of some episodes."""

    episodes: int
    successes: int
    mean_return: float
    mean_ticks: float
    """Of all episodes, those that ran out of time included."""

    @property
    def success(self) -> float:
        """The part that succeeded."""
        return self.successes / self.episodes


@torch.no_grad()
def evaluate(net: CarNet, task: Task, samples: bool, episodes: int, seed: int) -> Played:
    """Play so many episodes, all at once.

    Args:
        net: what decides.
        task: what to play.
        samples: draw each action from what the network says, instead of taking the best.
        episodes: how many.
        seed: of starts, orders of the cars and drawn actions.
    """
    rng, draws = np.random.default_rng(seed), torch.Generator().manual_seed(seed)
    worlds = Episodes(task, rng, episodes)
    running = np.ones(episodes, np.bool_)
    won, total, ticks = (np.zeros(episodes) for _ in range(3))
    while running.any():
        seen, mask = torch.from_numpy(worlds.vectors()), torch.from_numpy(offered(worlds))
        steps = worlds.step(choose(net(seen, mask), mask, draws if samples else None).numpy())
        won[running & steps.success] = 1
        total += steps.reward * running
        ticks += running
        running &= ~steps.done
    return Played(episodes, int(won.sum()), float(total.mean()), float(ticks.mean()))


def choose(values: torch.Tensor, mask: torch.Tensor, draws: torch.Generator | None) -> torch.Tensor:
    """Return for each car an offered action: the best by its values (..., 15), or one drawn with these as logits."""
    logits = values.masked_fill(~mask.bool(), -torch.inf)
    if draws is None:
        return logits.argmax(-1)
    drawn = torch.multinomial(logits.softmax(-1).flatten(0, -2), 1, generator=draws)
    return drawn.view(logits.shape[:-1])
