"""Undoing what a test has registered; a name is never free again where craftsim is used."""

import gymnasium
import pettingzoo

from craftsim import envs
from craftsim.discrete import kinds, schedule
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.kinds import Action
from craftsim.tasks import registry, rewards
from craftsim.tasks.rewards import TERMS


def forget():
    """Forget all actions, tasks and terms of rewards that were registered in this process."""
    for action in list(ACTIONS)[len(Action) :]:
        del ACTIONS[action]
    kinds._REGISTERED_ACTIONS.clear()
    kinds._REGISTERED_BY.clear()
    for name in list(registry._REGISTERED):
        task_id = envs.TASK_IDS.pop(name)
        for ids in (gymnasium.registry, pettingzoo.aec_registry, pettingzoo.parallel_registry):
            ids.pop(task_id, None)
        del registry._REGISTERED[name]
    for name in TERMS.keys() - rewards._SHIPPED:
        del TERMS[name]
    schedule._durations.cache_clear()
