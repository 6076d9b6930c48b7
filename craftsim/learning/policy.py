"""Trained policies: callables from observations to actions; and the libraries that training and they need."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.errors import InputError, suggestion
from craftsim.learning.policy_files import policy_file, shipped_policies
from craftsim.storage.extras import need
from craftsim.storage.paths import exists

if TYPE_CHECKING:
    from craftsim.discrete.rules import RuleSet
    from craftsim.learning.checkpoint import PolicyHead
    from craftsim.learning.evaluation import Tried
    from craftsim.learning.networks import CarNet, RecurrentState
    from craftsim.tasks import Task

PACKAGES: Final = ("torch",)
"""Whose versions decide what a run learns."""

_Observations = dict[str, dict[str, NDArray[Any]]]
"""By agent, ``car_0`` and so on: ``observation`` (vector_length,) and ``action_mask`` (15,)."""


def need_torch() -> None:
    """Raise InputError with the command that installs what is missing."""
    cpu = "pip install torch --index-url https://download.pytorch.org/whl/cpu"
    remark = f" (a CPU build of torch is enough: {cpu})"
    need("train", "training needs", *PACKAGES, "safetensors", remark=remark)


class TrainedPolicy:
    """A policy: for each car the highest rated action, a sample, or a varied one, as its configuration says."""

    def __init__(self, head: PolicyHead, net: CarNet, seed: int = 0) -> None:
        from craftsim.learning.config import IS_SAMPLED

        self.config = head.config
        self.identity = head.task
        self.shape = head.shape
        self.net = net
        if not IS_SAMPLED[head.config.acting]:
            self._draws = None
        else:
            self._draws = np.random.default_rng(seed)
        self._checked: Task | None = None
        self._memory: RecurrentState | None = None
        self._tried: Tried | None = None
        self.reset()

    def reset(self) -> None:
        """Forget the episode, as one that remembers must before the next one; craftsim's environments see to that."""
        from craftsim.learning.config import IS_VARIED
        from craftsim.learning.evaluation import Tried

        self._memory = None
        self._tick = 0
        if IS_VARIED[self.config.acting]:
            self._tried = Tried()
        else:
            self._tried = None

    def check_task(self, task: Task | str, rules: RuleSet | None = None) -> None:
        """Raise InputError for a task, or a given rule set, for which it was not trained.

        A relative network plays every task of its area whose observations contain the design, with any number of cars.
        Observations of :func:`craftsim.envs.parallel_env` are checked automatically, except for the rule set; call this
        first for observations from elsewhere.
        """
        from craftsim.tasks import as_task

        task = as_task(task)
        shape = self.shape.of_task(task)
        fits = self.shape.fits(shape)
        plays_others = fits and self.shape.network == "relative" and task.layout.n_targets > 0
        difference = self.identity.difference(task, rules, plays_others)
        if difference:
            remedy = "train one with 'craftsim train'"
            if not self.identity.difference(task, None, plays_others):
                own_rules = "FILE"
                if isinstance(self.config.rules, str):
                    own_rules = self.config.rules
                remedy = f"give its own with --rules {own_rules}, or {remedy}"
            raise InputError(
                f"this policy was trained on {self.identity.name}, and cannot play {task.name}: {difference}; "
                f"{remedy}"
            )
        if not fits:
            raise InputError(
                f"this policy is damaged: its network is for {self.shape}, {task.name} has {shape}"
            )
        self._checked = task

    def __call__(self, observations: _Observations) -> dict[str, int]:
        """Return one action for each agent. Raises InputError for observations of another task."""
        from craftsim.learning.evaluation import choose_actions
        from craftsim.learning.features import with_hidden
        from craftsim.tasks.kernel import ROW

        task = getattr(observations, "task", None)
        if task is not None and task is not self._checked:
            self.check_task(task)
        any_number = self.shape.network == "relative" and len(observations) > 0
        names = [f"car_{i}" for i in range(len(observations) if any_number else self.shape.n_cars)]
        trained = f"this policy was trained on {self.identity.name}"
        if set(observations) != set(names):
            raise InputError(
                f"{trained} with the agents {', '.join(names)}; asked for {', '.join(sorted(observations)) or 'none'}"
            )
        vectors, mask = (
            np.stack([observations[name][key] for name in names])
            for key in ("observation", "action_mask")
        )
        length = self.shape.vector_length - ROW * bool(self.shape.ticks)
        if vectors.shape[-1] % ROW if any_number else vectors.shape[-1] != length:
            raise InputError(
                f"{trained}, whose observations have {length} numbers, not {vectors.shape[-1]}"
            )
        noise = None
        if self._draws is not None:
            noise = self._draws.gumbel(size=mask.shape)
        if getattr(observations, "begins", False):
            self.reset()
        if self.shape.ticks:
            # Cars do without a helper here, so that none is under way.
            idle = np.zeros((1, len(names)), np.bool_)
            vectors = with_hidden(vectors[None], np.array([self._tick]), idle)[0]
            self._tick += 1
        if self._memory is None:
            self._memory = self.net.memory(len(names))
        chosen = choose_actions(self.net, vectors, mask, noise, self._memory, self._tried)
        return dict(zip(names, chosen.tolist(), strict=True))


def load_policy(path: str | Path, seed: int = 0) -> TrainedPolicy:
    """Return a trained policy: a ``policy.safetensors``, its folder, or the name of a shipped one such as
    ``random_strip``.

    It maps observations of :func:`craftsim.envs.parallel_env` to actions, and refuses those of another task. ``seed``
    is for policies whose actions are sampled.

    Raises:
        InputError: the extra ``train`` is not installed, there is no such policy, or the file is none.

    Example:
        >>> import craftsim
        >>> policy = craftsim.load_policy(trained)  # what `craftsim train --out` wrote
        >>> env = craftsim.parallel_env("strip", "grid")
        >>> sorted(policy(env.reset(seed=0)[0]))
        ['car_0', 'car_1']
    """
    need_torch()
    from craftsim.learning.checkpoint import read_policy

    names = shipped_policies()
    if str(path).isidentifier() and path not in names and not exists(path):
        close = suggestion(str(path)[:80], names)
        raise InputError(f"{path}: no such file{close}; shipped policies are {', '.join(names)}")
    return TrainedPolicy(*read_policy(policy_file(path)), seed)
