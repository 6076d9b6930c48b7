"""Policies by name: functions from the observations of the cars to their next actions."""

from __future__ import annotations

import hashlib
import signal
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import RuleSet
from craftsim.errors import InputError
from craftsim.learning.policy import load_policy
from craftsim.learning.policy_files import policy_file, shipped_policies
from craftsim.storage.limits import POLICY
from craftsim.storage.paths import exists
from craftsim.storage.reading import read_bytes
from craftsim.tasks import Task
from craftsim.workers.modules import find_named

_Observations = dict[str, dict[str, NDArray[Any]]]
"""``observation`` and ``action_mask`` by agent, such as ``car_0`` (docs/reference/environments.md)."""

Policy = Callable[[_Observations], dict[str, int]]
"""Returns one of the 15 primitive actions for each agent; may depend on the observations alone."""

RANDOM: Final = "random"
PLANNER: Final = "planner"
"""The policy that executes the shipped plan, or where there is none plans, and plans again after a failure."""

_CONTRACT: Final = (
    "a policy takes observations by agent and returns a dictionary "
    "with a whole number from 0 to 14 for each"
)
_WEIGHTS: Final = {
    Action.STOP: 0.05,
    Action.ROTATE_LEFT: 0.3,
    Action.ROTATE_RIGHT: 0.3,
    Action.FOLD: 0.15,
    Action.UNFOLD: 0.15,
    Action.LIFT: 2.0,
    Action.DROP: 0.6,
}
"""Weights of actions relative to a move, so that cars do not turn on the spot most of the time."""


def _random_policy(seed: int) -> Policy:
    """Return a policy that draws an allowed action for each car, with :data:`_WEIGHTS`."""
    rng = np.random.default_rng(seed)

    def act(observations: _Observations) -> dict[str, int]:
        actions = {}
        for agent, observation in observations.items():
            offered = np.flatnonzero(observation["action_mask"]).tolist()
            weights = np.array([_WEIGHTS.get(Action(action), 1.0) for action in offered])
            actions[agent] = int(rng.choice(offered, p=weights / weights.sum()))
        return actions

    return act


def check_policy(name: str, task: Task, rules: RuleSet, timeout_s: float) -> None:
    """Ask a policy what it does at the start of a task.

    Raises InputError where there is no such policy, where it raises or takes too long, and where its answer is not one
    of the 15 actions for each agent.
    """
    from craftsim.envs.actions import by_agent, checked_actions
    from craftsim.envs.options import Options
    from craftsim.envs.parallel import ParallelConstruction

    mistake = "raised"
    end_s = time.monotonic() + timeout_s
    try:
        with _time_limit(timeout_s):
            policy = make_policy(name, 0, task, rules)
        env = ParallelConstruction(task, Options("grid", rule_set=rules))
        observations, _ = env.reset(seed=0)
        with _time_limit(max(_LEAST_S, end_s - time.monotonic())):
            answer = policy(observations)
        mistake = "returned what is no answer:"
        if isinstance(answer, Mapping):
            checked_actions(by_agent(answer, env.agents), (len(env.agents),))
    except _Hanging:
        raise InputError(f"policy '{name}' gave no first answer within {timeout_s:g} s") from None
    except (Exception, SystemExit) as error:
        if mistake == "raised" and isinstance(error, InputError):
            raise
        shortened = textwrap.shorten(f"{type(error).__name__}: {error}", 300, placeholder=" ...")
        raise InputError(f"policy '{name}' {mistake} {shortened}; {_CONTRACT}") from error
    if not isinstance(answer, Mapping):
        raise InputError(f"policy '{name}' returned {type(answer).__name__}; {_CONTRACT}")


def make_policy(
    name: str, seed: int, task: Task | None = None, rules: RuleSet | None = None
) -> Policy:
    """Return a policy: ``random``, ``module:function``, what ``craftsim train`` wrote (a file or its folder), or a
    shipped one.

    ``seed`` is that of the random policy, and of a trained one whose actions are sampled. Raises InputError without
    such a policy; for a trained one also for another task or other rules than its own, and for rules where it has a
    helper.
    """
    if name == RANDOM:
        return _random_policy(seed)
    if _is_trained(name):
        policy = load_policy(name, seed)
        if task is not None:
            policy.check_task(task, rules)
        if rules is not None and policy.config.helper_depth is not None:
            raise InputError(
                f"policy '{name}' was trained with an action helper of depth {policy.config.helper_depth}, which cars "
                "do without here; 'craftsim validate --backend grid' plays it with one"
            )
        return policy
    allowed = f"'{RANDOM}', '{PLANNER}', 'module:function', the path of a trained policy, or a shipped one: "
    allowed += ", ".join(shipped_policies())
    if ":" not in name:
        raise InputError(f"no policy '{name}': there is no such file; allowed: {allowed}")
    role = f"policy '{name}'"
    function: Policy = find_named(
        name, role, "module:function, such as mypackage.policies:greedy", allowed
    )
    if not callable(function):
        raise InputError(f"{role} is a {type(function).__name__}, not a function")
    return function


def policy_digest(name: str) -> str:
    """Return a digest of what a policy is made of, so that a changed one is noticed; raise InputError without one."""
    make_policy(name, 0)
    if name == RANDOM:
        return RANDOM
    module = sys.modules.get(name.partition(":")[0])
    file = policy_file(name) if _is_trained(name) else getattr(module, "__file__", None)
    return hashlib.sha256(b"" if file is None else read_bytes(Path(file), POLICY)).hexdigest()


def _is_trained(name: str) -> bool:
    return exists(name) or name in shipped_policies()


_LEAST_S: Final = 0.001
"""Shortest time limit: one of 0 would be none."""


class _Hanging(BaseException):
    """The time is up; not an Exception, so that user code does not catch it."""


@contextmanager
def _time_limit(seconds: float) -> Iterator[None]:
    """Raise within the block when the time is up; in the main thread alone, the others cannot be interrupted."""

    def stop(*_: object) -> None:
        raise _Hanging

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
