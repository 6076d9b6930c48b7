"""Tests for what others build on craftsim: an environment, a blueprint, a skill or policy, another simulator.

Each function raises AssertionError and says what is wrong; docs/reference/environments.md shows them at work.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.utils.env_checker import data_equivalence
from numpy.typing import NDArray

from craftsim.checking.attempt import AGREEING
from craftsim.checking.pose_judge import judge_poses as judge_poses
from craftsim.discrete.kinds import Action
from craftsim.discrete.readback import Poses as Poses

if TYPE_CHECKING:
    from craftsim.envs.parallel import ParallelConstruction
    from craftsim.learning.policies import Policy


def random_policy(rng: np.random.Generator) -> Policy:
    """Return the policy that draws for each agent one of the actions that its mask offers."""

    def act(observations: dict[str, dict[str, NDArray[Any]]]) -> dict[str, int]:
        return {
            agent: int(rng.choice(np.flatnonzero(observation["action_mask"])))
            for agent, observation in observations.items()
        }

    return act


def check_api(make: Callable[[], ParallelConstruction], cycles: int = 100) -> None:
    """Run PettingZoo's own tests of the parallel and of the turn-based interface.

    Args:
        make: returns a fresh environment.
        cycles: how many ticks each test runs for.
    """
    from pettingzoo.test import api_test, parallel_api_test
    from pettingzoo.utils.conversions import parallel_to_aec

    with warnings.catch_warnings():
        # PettingZoo warns of observations that are dictionaries, which is how it wants masks to be given.
        warnings.filterwarnings("ignore", "Observation (space|is not)")
        parallel_api_test(make(), num_cycles=cycles)
        api_test(parallel_to_aec(make()), num_cycles=cycles)


def check_deterministic(
    make: Callable[[], ParallelConstruction],
    episodes: int = 1,
    seed: int = 0,
    ticks: int | None = None,
) -> None:
    """Check that two environments with one seed go through equal episodes, bit for bit.

    Both get the same masked random actions; the second one has another past. PettingZoo's own test of seeds looks at
    the start of an episode only.

    Args:
        make: returns a fresh environment.
        episodes: how many episodes to compare; only the first is given the seed.
        seed: seed of the environments and of the actions.
        ticks: where to break an episode off, if anywhere.
    """
    first, second = make(), make()
    second.reset(seed=seed + 1)
    second.step(dict.fromkeys(second.agents, int(Action.STOP)))
    runs = [_history(env, episodes, seed, ticks) for env in (first, second)]
    for number, (event, repeated) in enumerate(zip(*runs, strict=True)):
        for name, a, b in zip(_PARTS, event, repeated, strict=True):
            assert data_equivalence(a, b, exact=True), (
                f"two runs with seed {seed} differ in the {name} of event {number}:\n{a}\n{b}"
            )


_PARTS = ("observations", "rewards", "terminations", "truncations", "infos", "state")


def _history(
    env: ParallelConstruction, episodes: int, seed: int, ticks: int | None
) -> Iterator[tuple[Any, ...]]:
    """Yield what is seen after every reset and every tick, in the order of ``_PARTS``."""
    act = random_policy(np.random.default_rng(seed))
    for episode in range(episodes):
        observations, infos = env.reset(seed=seed if episode == 0 else None)
        yield observations, {}, {}, {}, infos, env.state()
        done = 0
        while env.agents and done != ticks:
            step = env.step(act(observations))
            observations = step[0]
            done += 1
            yield *step, env.state()


def check_masks(
    env: ParallelConstruction, states: int = 10, tries: int | None = None, seed: int = 0
) -> None:
    """Check that what a mask offers is done as the rules predict, and that what it does not offer changes nothing.

    From worlds that masked random play comes by, one car at a time does one action while the others stop. The action
    helper must be off: with it a move may take several ticks.

    Args:
        env: the environment; it is reset again and again.
        states: how many worlds to try the actions in.
        tries: how many (car, action) to try in each, drawn without repetition; None is all.
        seed: seed of everything that is drawn.
    """
    assert env.core.options.helper_depth is None, "check_masks needs helper_depth=None"
    rng = np.random.default_rng(seed)
    act = random_policy(rng)
    for number in range(states):
        observations, _ = env.reset(seed=seed + number)
        for _ in range(int(rng.integers(env.core.task.max_steps))):
            observations = env.step(act(observations))[0]
            if not env.agents:
                observations, _ = env.reset()
        start = env.grid
        cases = list(product(range(len(env.possible_agents)), Action))
        for index in rng.permutation(len(cases))[:tries]:
            _check_action(env, start, *cases[index])


def _check_action(env: ParallelConstruction, start: Any, car: int, action: Action) -> None:
    """Let one car do one action in a world, and compare its mask with the result."""
    observations, _ = env.reset(options={"grid": start})
    agent = f"car_{car}"
    mask = observations[agent]["action_mask"]
    offered = bool(mask[action])
    assert mask.any(), f"{agent} is offered nothing at all"
    before = env.grid
    rules = env.core.rules
    allowed = rules.legal(before, car, action)
    predicted = rules.apply(before, car, action)
    stops = dict.fromkeys(env.agents, int(Action.STOP))
    infos = env.step(stops | {agent: int(action)})[4]
    description = (
        f"{action.name} of {agent} in\n{before.cars}\n{np.argwhere(before.kind[:, :, 1:])}\n"
    )
    unsaid = allowed == offered or (
        action == Action.STOP and offered and not mask[: Action.STOP].any()
    )
    assert unsaid, f"the mask says {offered}, the rules {allowed}: {description}"
    assert infos[agent]["illegal"] == (not allowed and action != Action.STOP), (
        f"wrongly flagged: {description}"
    )
    reason = infos[agent].get("outcome", "")
    assert env.grid.same_visible(predicted), (
        f"offered: {offered}; the world is not as predicted ({reason}): {description}"
    )


def check_skills(
    env: ParallelConstruction,
    ticks: int = 20,
    position_m: float = 0.005,
    heading_rad: float = 0.02,
    policy: Policy | None = None,
    seed: int = 0,
) -> None:
    """Check on the physics backend that all actions of masked play succeed, in place and accurately.

    Args:
        env: the environment, with the blueprint and the skills to be checked.
        ticks: how many ticks of all cars to play, over as many episodes as that takes.
        position_m: how far a car may end from its cell's centre.
        heading_rad: how far its heading may be from a grid yaw.
        policy: who plays; masked random play unless given.
        seed: seed of the environment and of random play.
    """
    assert env.core.options.backend == "physics", "check_skills needs backend='physics'"
    act = policy or random_policy(np.random.default_rng(seed))
    observations, _ = env.reset(seed=seed)
    for tick in range(ticks):
        actions = act(observations)
        observations, *_, infos = env.step(actions)
        for agent, info in infos.items():
            description = f"tick {tick}, {agent}, {Action(actions[agent]).name}"
            if info["illegal"] or info["outcome"] == "not performed":
                continue
            assert info["result"] in AGREEING, f"{description}: {info['result']}; {info['reason']}"
            assert info["car_error_m"] <= position_m, (
                f"{description}: {info['car_error_m'] * 1e3:.1f} mm off"
            )
            assert abs(info["heading_error_rad"]) <= heading_rad, (
                f"{description}: {info['heading_error_rad'] * 1e3:.1f} mrad off"
            )
        if not env.agents:
            observations, _ = env.reset()
