"""Imitation: a policy and its critic are fitted to demonstrations before they learn from what they do themselves."""

from __future__ import annotations

from typing import Final

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from craftsim.discrete.rules import RuleSet
from craftsim.discrete.tasks import Task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.training.demonstrations import NOT_SHOWN, Demonstrations
from craftsim.training.ppo import PPOLearner
from craftsim.training.rollouts import Seen

EPOCHS: Final = 6
LEAST: Final = 200
"""Steps of the optimiser, however little is shown."""
BATCH: Final = 512
LEARNING_RATE: Final = 1e-3
_LOOKED_AT: Final = 4096
"""Worlds that are put into observations at once."""


def imitate(
    learner: PPOLearner,
    task: Task,
    shown: Demonstrations,
    rules: RuleSet = "physical",
    helper_depth: int | None = None,
) -> None:
    """Fit what a learner would do to what was shown, and its values to the returns of that."""
    seen = _seen(learner, shown, Episodes(task, np.random.default_rng(0), _LOOKED_AT, rules, helper_depth))
    actions = torch.from_numpy(shown.actions)
    returns = torch.from_numpy(shown.returns(learner.settings.gamma))
    # What a car does later in a tick may be legal only after what another did: such actions are not imitated.
    taught = (actions != NOT_SHOWN) & seen.offers.gather(-1, actions.clamp(min=0)[..., None])[..., 0]
    optimizer = torch.optim.Adam(learner.modules.parameters(), LEARNING_RATE, fused=True)
    batches = -(-len(actions) // BATCH)
    steps = max(LEAST, EPOCHS * batches)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for step in range(steps):
        if step % batches == 0:
            order = torch.randperm(len(actions)).chunk(batches)
        some = order[step % batches]
        encoded = learner.net.encode(seen[some])
        logits = learner.net.masked(encoded, seen[some])
        values = learner.critic(encoded)
        doing = functional.cross_entropy(logits[taught[some]], actions[some][taught[some]])
        valuing = functional.mse_loss(values, returns[some, None].expand_as(values))
        optimizer.zero_grad()
        (doing + learner.settings.critic * valuing).backward()
        nn.utils.clip_grad_norm_(learner.modules.parameters(), learner.settings.max_gradient)
        optimizer.step()
        schedule.step()


def _seen(learner: PPOLearner, shown: Demonstrations, episodes: Episodes) -> Seen:
    """Return what the cars saw, (N,)."""
    places, masks = [], []
    for rows in np.split(np.arange(len(shown.actions)), range(_LOOKED_AT, len(shown.actions), _LOOKED_AT)):
        episodes.begin(np.arange(len(rows)), shown.worlds.take(rows))
        vectors = torch.from_numpy(episodes.vectors()[: len(rows)])
        places.append(learner.net.encoder.places(vectors).to(torch.int32))
        masks.append(torch.from_numpy(episodes.offered()[: len(rows)]))
    return Seen(torch.cat(places), torch.cat(masks))
