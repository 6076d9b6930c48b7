"""Episodes as a Minari dataset: what a planner, a plan or a policy did, for offline learning."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.tasks import TASK_NAMES, Task, make_task
from craftsim.envs.options import Options
from craftsim.envs.parallel import Observation, ParallelConstruction
from craftsim.envs.spaces import central_space, joint_action_space
from craftsim.errors import InputError
from craftsim.extras import need
from craftsim.storage.folders import LOCK, owned, remove
from craftsim.storage.limits import SEED

if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec
    from minari.data_collector import EpisodeBuffer

Act = Callable[[dict[str, Observation]], dict[str, int]]
"""A policy: from the observations by agent to the actions by agent."""
MakeAct = Callable[[int], Act]
"""Makes the policy of an episode, given the episode's seed."""

DATASET_NAME: Final = re.compile(r"(?:[-\w]+/)*[-\w]+-v[0-9]+")
"""What Minari calls a dataset: folders, a name and a version."""


@dataclass(frozen=True)
class Exported:
    """What a dataset holds."""

    path: Path
    """Its folder."""
    episodes: int
    steps: int
    successes: int


def need_minari() -> None:
    """Raise InputError with the command that installs what is missing."""
    need("minari", "datasets need", "minari", "h5py")


def write_dataset(
    env: ParallelConstruction,
    make_act: MakeAct,
    folder: str | Path,
    name: str,
    episodes: int,
    seed: int = 0,
    algorithm: str = "",
    progress: Callable[[bool], None] = lambda success: None,
) -> Exported:
    """Play episodes and write them as a dataset that ``minari.load_dataset(name)`` reads; it is whole or not there.

    It has the form of the Gymnasium environment, one agent that acts for all cars: observations ``observation``
    (T + 1, 13 * rows) and ``action_mask`` (T + 1, n, 15), actions (T, n), and in the infos, each with a first row for
    the reset, ``success`` and ``duration_s`` (T + 1,), ``illegal`` and ``as_predicted`` (T + 1, n). Episode i is reset
    with ``seed + i``, which stands with it.

    Args:
        env: plays the episodes.
        make_act: returns the policy of an episode, given the episode's seed, before its reset.
        folder: where ``MINARI_DATASETS_PATH`` must point to load it.
        name: such as ``craftsim/strip/planner-v0``.
        episodes: how many, 1 or more.
        seed: of the first episode.
        algorithm: what Minari should call the policy.
        progress: called after each episode with whether it reached the goal.

    Raises InputError where Minari is not installed, for a name that is none, where the dataset exists already, while
    another process writes it, and where the disk does not take it.
    """
    need_minari()
    import minari
    from minari.dataset.minari_storage import MinariStorage

    if not DATASET_NAME.fullmatch(name):
        raise InputError(f"'{name}' is no name of a dataset; allowed: such as craftsim/strip/planner-v0")
    SEED.check("the seed of the last episode", seed + episodes - 1)
    # Minari takes what is relative twice over.
    target, task = Path(folder).absolute() / name, env.core.task
    with owned(target), _whole_folder(target, "data") as partial:
        storage = MinariStorage.new(
            partial,
            observation_space=central_space(task),
            action_space=joint_action_space(task),
            env_spec=_env_spec(env),
        )
        described = f"{task.name} on {env.core.options.backend}, played by {algorithm or 'a policy'}"
        storage.update_metadata(
            {
                "dataset_id": name,
                "minari_version": minari.__version__,
                "algorithm_name": algorithm,
                "description": f"craftsim: {described}; starts and design have the digest {task.digest}",
            }
        )
        steps = successes = 0
        for buffer in _episodes(env, make_act, episodes, seed):
            storage.update_episodes([buffer])
            assert buffer.infos is not None
            success = bool(buffer.infos["success"][-1])
            steps += len(buffer.rewards)
            successes += success
            progress(success)
    return Exported(target, episodes, steps, successes)


@contextmanager
def _whole_folder(target: Path, name: str) -> Iterator[Path]:
    """Give an empty folder within an owned one, which gets its name when the block ends without an error.

    Raises InputError where there is anything else already, and where the disk does not take it.
    """
    # Always the same name: what a kill leaves behind is gone with the next writing.
    partial = target / f".partial-{name}"
    try:
        if {path.name for path in target.iterdir()} - {LOCK, partial.name}:
            raise InputError(
                f"{target} exists already; choose another name, a higher version, or another folder"
            )
        remove(partial)
        partial.mkdir()
        try:
            yield partial
            partial.rename(target / name)
        except BaseException:
            shutil.rmtree(partial, ignore_errors=True)
            raise
    except OSError as error:
        raise InputError(
            f"{target}: cannot be written: {error}; make room, or choose another folder"
        ) from error


def _episodes(
    env: ParallelConstruction, make_act: MakeAct, episodes: int, seed: int
) -> Iterator[EpisodeBuffer]:
    from minari.data_collector import EpisodeBuffer

    n_cars = env.core.n_cars
    for number in range(seed, seed + episodes):
        act = make_act(number)
        observations, _ = env.reset(seed=number)
        states, masks = [env.state()], [env.core.masks.copy()]
        actions: list[NDArray[np.int64]] = []
        rewards, ends, cuts = [], [], []
        told = [
            {
                "success": False,
                "duration_s": 0.0,
                "illegal": [False] * n_cars,
                "as_predicted": [True] * n_cars,
            }
        ]
        while env.agents:
            agents = env.agents
            chosen = act(observations)
            observations, earned, terminated, truncated, infos = env.step(chosen)
            actions.append(np.array([chosen[agent] for agent in agents], np.int64))
            states.append(env.state())
            masks.append(env.core.masks.copy())
            rewards.append(earned[agents[0]])
            ends.append(terminated[agents[0]])
            cuts.append(truncated[agents[0]])
            told.append(_told([infos[agent] for agent in agents]))
        yield EpisodeBuffer(
            seed=number,
            observations={"observation": np.array(states), "action_mask": np.array(masks)},
            actions=np.array(actions),
            rewards=rewards,
            terminations=ends,
            truncations=cuts,
            infos={key: np.array([one[key] for one in told]) for key in told[0]},
        )


def _told(infos: list[dict[str, Any]]) -> dict[str, Any]:
    """Return what a dataset keeps of the cars' infos."""
    return {
        "success": infos[0]["success"],
        "duration_s": infos[0]["duration_s"],
        "illegal": [info["illegal"] for info in infos],
        "as_predicted": [
            not info["illegal"] and info.get("result", "as predicted") == "as predicted" for info in infos
        ],
    }


def _env_spec(env: ParallelConstruction) -> EnvSpec | None:
    """Return what Gymnasium makes the same environment from; None where a name and plain options do not say it."""
    import gymnasium

    from craftsim.envs import GYMNASIUM_IDS

    task, options = env.core.task, env.core.options
    plain: dict[str, Any] = {
        name: getattr(options, name) for name in ("backend", "rule_set", "helper_depth", "drive")
    }
    if task.name not in TASK_NAMES or Options.named(**plain) != options:
        return None
    if _made_of(task) != _made_of(make_task(task.name)):
        return None
    spec = deepcopy(gymnasium.spec(GYMNASIUM_IDS[task.name]))
    spec.kwargs |= plain
    return spec


def _made_of(task: Task) -> tuple[object, ...]:
    return task.digest, task.max_steps, task.ends_on_success, task.reward
