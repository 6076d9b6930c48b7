"""Episodes as a Minari dataset for offline learning."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from craftsim.envs.observations import Observation, joint_action_space, state_space
from craftsim.envs.options import Options
from craftsim.envs.parallel import ParallelConstruction
from craftsim.errors import InputError
from craftsim.storage.extras import need
from craftsim.storage.folders import LOCK, owned, remove
from craftsim.storage.limits import SEED
from craftsim.tasks import TASK_NAMES, make_task

if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec
    from minari.data_collector import EpisodeBuffer

Act = Callable[[dict[str, Observation]], dict[str, int]]
"""A policy: from the observations by agent to the actions by agent."""
MakeAct = Callable[[int], Act]
"""Makes the policy of an episode, given the episode's seed."""

DATASET_NAME: Final = re.compile(r"(?:[-\w]+/)*[-\w]+-v[0-9]+")
"""How Minari names a dataset: folders, a name and a version."""
_SETTLED: Final = ("max_steps", "ends_on_success", "reward")
"""What a name of a task says, beside its digest."""


class Exported(NamedTuple):
    """A dataset that was written."""

    path: Path  # its folder
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
        algorithm: Minari's name of the policy.
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
    target = Path(folder).absolute() / name
    task = env.core.task
    described = f"{task.name} on {env.core.options.backend}, played by {algorithm or 'a policy'}"
    steps = 0
    successes = 0
    n_actions = env.core.form.n_actions
    mask_space = spaces.Box(0, 1, (env.core.n_cars, n_actions), np.int8)
    with owned(target), _whole_folder(target, "data") as partial:
        storage = MinariStorage.new(
            partial,
            observation_space=spaces.Dict({"observation": state_space(task), "action_mask": mask_space}),
            action_space=joint_action_space(task, n_actions),
            env_spec=_env_spec(env),
        )
        storage.update_metadata(
            {
                "dataset_id": name,
                "minari_version": minari.__version__,
                "algorithm_name": algorithm,
                "description": f"craftsim: {described}; starts and design have the digest {task.digest}",
            }
        )
        for number in range(seed, seed + episodes):
            played = _episode(env, make_act(number), number)
            storage.update_episodes([played])
            assert played.infos is not None
            success = bool(played.infos["success"][-1])
            steps += len(played.rewards)
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
        with ExitStack() as undo:
            undo.callback(shutil.rmtree, partial, ignore_errors=True)
            yield partial
            partial.rename(target / name)
            undo.pop_all()
    except OSError as error:
        raise InputError(
            f"{target}: cannot be written: {error}; make room, or choose another folder"
        ) from error


def _episode(env: ParallelConstruction, act: Act, seed: int) -> EpisodeBuffer:
    """Play an episode, and return it as Minari stores it."""
    # Minari's own DataCollector would need JAX.
    from minari.data_collector import EpisodeBuffer

    def look(infos: dict[str, dict[str, Any]]) -> tuple[NDArray[Any], NDArray[Any], dict[str, Any]]:
        return env.state(), env.core.masks.copy(), _told(list(infos.values()))

    observations, infos = env.reset(seed=seed)
    looks = [look(infos)]
    done = list[tuple[Any, ...]]()
    while env.agents:
        agents = env.agents
        chosen = act(observations)
        observations, earned, ended, cut, infos = env.step(chosen)
        looks.append(look(infos))
        first = agents[0]
        done.append(([chosen[agent] for agent in agents], earned[first], ended[first], cut[first]))
    states, masks, measured = zip(*looks, strict=True)
    actions, rewards, ends, cuts = (list(column) for column in zip(*done, strict=True))
    return EpisodeBuffer(
        seed=seed,
        observations={"observation": np.array(states), "action_mask": np.array(masks)},
        actions=np.array(actions, np.int64),
        rewards=rewards,
        terminations=ends,
        truncations=cuts,
        infos={key: np.array([one[key] for one in measured]) for key in measured[0]},
    )


def _told(by_car: list[dict[str, Any]]) -> dict[str, Any]:
    """Return what a dataset keeps of the infos of the cars; those of a reset lack most."""
    wrong = [info.get("illegal", False) for info in by_car]
    went_well = [info.get("result", "as predicted") == "as predicted" for info in by_car]
    return {
        "success": by_car[0].get("success", False),
        "duration_s": by_car[0].get("duration_s", 0.0),
        "illegal": wrong,
        "as_predicted": [good and not bad for good, bad in zip(went_well, wrong, strict=True)],
    }


def _env_spec(env: ParallelConstruction) -> EnvSpec | None:
    """Return what Gymnasium makes the same environment from; None where a name and plain options do not say it."""
    import gymnasium

    from craftsim.envs import GYMNASIUM_IDS

    task = env.core.task
    options = env.core.options
    plain: dict[str, Any] = {}
    for name in ("backend", "rule_set", "helper_depth", "drive"):
        plain[name] = getattr(options, name)
    if task.name not in TASK_NAMES or Options(**plain) != options:
        return None
    made = make_task(task.name)
    if any(getattr(task, name) != getattr(made, name) for name in ("digest", *_SETTLED)):
        return None
    spec = deepcopy(gymnasium.spec(GYMNASIUM_IDS[task.name]))
    spec.kwargs |= plain
    return spec
