"""Policies by name: what decides the next actions of the cars of a task, from their observations."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.actions import Action
from craftsim.discrete.files.documents import exists
from craftsim.discrete.tasks import Task
from craftsim.errors import InputError

Observations = dict[str, dict[str, NDArray[Any]]]
"""By agent, ``car_0`` and so on: ``observation`` and ``action_mask`` (docs/envs.md)."""

Policy = Callable[[Observations], dict[str, int]]
"""Gives each agent one of the 15 primitive actions; may depend on nothing but the observations."""

RANDOM: Final = "random"


_WEIGHTS: Final = {
    Action.STOP: 0.05,
    Action.ROTATE_LEFT: 0.3,
    Action.ROTATE_RIGHT: 0.3,
    Action.FOLD: 0.15,
    Action.UNFOLD: 0.15,
    Action.LIFT: 2.0,
    Action.DROP: 0.6,
}
"""How much likelier an action is drawn than a move, so that cars do not turn on the spot all the time."""


class RandomPolicy:
    """Draws each car one of the actions that it is offered, those that handle things more often than turns."""

    def __init__(self, seed: int) -> None:
        """Draw from a seed."""
        self._rng = np.random.default_rng(seed)

    def __call__(self, observations: Observations) -> dict[str, int]:
        """Return one action for each agent."""
        drawn = {}
        for agent, seen in observations.items():
            offered = np.flatnonzero(seen["action_mask"]).tolist()
            weights = np.array([_WEIGHTS.get(Action(action), 1.0) for action in offered])
            drawn[agent] = int(self._rng.choice(offered, p=weights / weights.sum()))
        return drawn


def make_policy(name: str, seed: int, task: Task | None = None) -> Policy:
    """Return a policy.

    Args:
        name: ``random``; ``module:function``; or what ``craftsim train`` wrote, a file or its folder.
        seed: of the random policy; the others draw nothing that their observations do not decide.
        task: what it is to play; a trained policy refuses another task than its own.

    Raises:
        InputError: there is no such policy, or it is one for another task.
    """
    if name == RANDOM:
        return RandomPolicy(seed)
    if exists(name):
        from craftsim.training.policy import load_policy

        policy = load_policy(name)
        if task is not None:
            policy.check_task(task)
        return policy
    return _function(name)


def policy_digest(name: str) -> str:
    """Return a digest of what a policy is made of, so that a changed one is noticed; raise InputError without one."""
    policy = make_policy(name, 0)
    if isinstance(policy, RandomPolicy):
        return RANDOM
    path = Path(name)
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.suffix == ".pt")
    elif path.is_file():
        files = [path]
    else:
        spec = importlib.util.find_spec(name.split(":", 1)[0])
        files = [Path(spec.origin)] if spec is not None and spec.origin is not None else []
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def _function(name: str) -> Policy:
    module, colon, function = name.partition(":")
    known = f"'{RANDOM}', 'planner', 'module:function', or the path of a trained policy"
    if not colon:
        raise InputError(f"no policy '{name}': there is no such file; allowed: {known}")
    try:
        found = getattr(importlib.import_module(module), function)
    except ModuleNotFoundError as error:
        raise InputError(
            f"policy '{name}': {error}; modules are looked for in this folder too; allowed: {known}"
        ) from error
    except AttributeError:
        raise InputError(f"policy '{name}': the module {module} has no '{function}'") from None
    if not callable(found):
        raise InputError(f"policy '{name}' is a {type(found).__name__}, not a function")
    policy: Policy = found
    return policy
