"""How fast the environments run: steps a second on the grid, and what a step in physics takes beyond MuJoCo's own."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.tasks import Task
from craftsim.envs.options import Options
from craftsim.envs.parallel import ParallelConstruction
from craftsim.envs.physics_backend import PhysicsBackend
from craftsim.envs.vector import GridVectorEnv
from craftsim.models.world import PhysicsWorld

_SLEEP: Final = int(mujoco.mjtEnableBit.mjENBL_SLEEP)
_STAY_AWAKE: Final = int(mujoco.mjtSleepPolicy.mjSLEEP_NEVER)


def _pick(rng: np.random.Generator, mask: NDArray[np.int8]) -> NDArray[np.int64]:
    """Return for each car one of the offered actions, uniformly."""
    picked: NDArray[np.int64] = (rng.random(mask.shape, dtype=np.float32) * mask).argmax(-1)
    return picked


def _act(rng: np.random.Generator, observations: dict[str, dict[str, NDArray[np.int8]]]) -> dict[str, int]:
    masks = np.stack([seen["action_mask"] for seen in observations.values()])
    return dict(zip(observations, _pick(rng, masks).tolist(), strict=True))


def parallel_step(env: ParallelConstruction, seed: int) -> Callable[[], None]:
    """Return a function that takes one step of masked random play, resets included."""
    rng = np.random.default_rng(seed)
    observations = env.reset(seed=seed)[0]

    def step() -> None:
        nonlocal observations
        observations = env.step(_act(rng, observations))[0]
        if not env.agents:
            observations = env.reset()[0]

    return step


def vector_step(envs: GridVectorEnv, seed: int) -> Callable[[], None]:
    """Return a function that takes one step of masked random play in all worlds."""
    rng = np.random.default_rng(seed)
    observations = envs.reset(seed=seed)[0]

    def step() -> None:
        nonlocal observations
        observations = envs.step(_pick(rng, observations["action_mask"]))[0]

    return step


Play = Callable[[int, np.random.Generator, dict[str, dict[str, NDArray[Any]]]], dict[str, int]]
"""Chooses the actions of a tick from its number, a generator and what the agents observe."""


def random_play(
    tick: int, rng: np.random.Generator, observations: dict[str, dict[str, NDArray[Any]]]
) -> dict[str, int]:
    """Return one of the offered actions for each agent, uniformly."""
    return _act(rng, observations)


@dataclass(frozen=True)
class PhysicsTiming:
    """CPU time of the same physics, once in the environment and once bare."""

    n_cars: int
    n_steps: int
    """Steps of the environment."""
    n_periods: int
    """Control periods that they took."""
    n_physics_steps: int
    """Steps of MuJoCo in those."""
    env_s: float
    bare_s: float
    """Of MuJoCo's steps alone, under the commands that were recorded."""

    @property
    def ratio(self) -> float:
        """How much longer the environment takes."""
        return self.env_s / self.bare_s


@dataclass
class _Period:
    """What stood when a control period ran."""

    ctrl: NDArray[np.float64]
    policies: NDArray[np.int32]
    limits: NDArray[np.float64]
    """Of the motors' forces: those of the reduced drive's wheels depend on its grip."""
    rouse: bool = False
    """Whether its first step ran with sleep switched off, to wake what is commanded."""

    @classmethod
    def of(cls, physics: PhysicsWorld) -> _Period:
        """Return what stood in the period that has just run."""
        model = physics.model
        return cls(physics.data.ctrl.copy(), model.tree_sleep_policy.copy(), model.actuator_forcerange.copy())


def time_physics(
    task: Task, seed: int = 0, repeats: int = 5, options: Options | None = None, play: Play = random_play
) -> PhysicsTiming:
    """Time an episode in physics against MuJoCo's steps alone, in CPU seconds, the best of some repeats each in turns.

    The commands of every control period are recorded and replayed from the same state by ``mj_step``, the rollers'
    bearings between, and nothing else, which ends in the same state, bit for bit. The reset is part of neither time.

    Args:
        task: what is played; an episode is as long as it says.
        seed: of the environment and of what ``play`` draws.
        repeats: how often either is timed.
        options: of the environment.
        play: chooses the actions.
    """
    env = ParallelConstruction(task, options or Options())
    periods: list[_Period] = []
    _, n_steps = _play(env, seed, play, periods)
    end = _physics(env).data.qpos.copy()
    _find_rousing(env, seed, periods)
    env_times, bare_times = [], []
    for _ in range(repeats):
        env_times.append(_play(env, seed, play)[0])
        bare_times.append(_replay(env, seed, periods))
        if not np.array_equal(_physics(env).data.qpos, end):
            raise RuntimeError("the replay of the commands does not end where the environment did")
    n_physics_steps = len(periods) * _physics(env).config.steps_per_period
    return PhysicsTiming(
        env.core.n_cars, n_steps, len(periods), n_physics_steps, min(env_times), min(bare_times)
    )


def _physics(env: ParallelConstruction) -> PhysicsWorld:
    backend = env.core.backend
    assert isinstance(backend, PhysicsBackend)
    return backend.judge.physics


def _play(
    env: ParallelConstruction, seed: int, play: Play, record: list[_Period] | None = None
) -> tuple[float, int]:
    """Play an episode; return the CPU time of its steps and their number, and record its periods if asked to."""
    rng = np.random.default_rng(seed)
    observations = env.reset(seed=seed)[0]
    if record is not None:
        backend = env.core.backend
        assert isinstance(backend, PhysicsBackend)
        backend.judge.executor.observers.append(lambda physics: record.append(_Period.of(physics)))
    seconds, n_steps = 0.0, 0
    while env.agents:
        actions = play(n_steps, rng, observations)
        begun = time.process_time()
        observations = env.step(actions)[0]
        seconds += time.process_time() - begun
        n_steps += 1
    return seconds, n_steps


def _find_rousing(env: ParallelConstruction, seed: int, periods: list[_Period]) -> None:
    """Note which periods wake something that sleeps."""
    env.reset(seed=seed)
    physics = _physics(env)
    for period in periods:
        period.rouse = bool(((period.policies == _STAY_AWAKE) & (physics.data.tree_asleep >= 0)).any())
        _step(physics, period)


def _step(physics: PhysicsWorld, period: _Period) -> None:
    model, data, n = physics.model, physics.data, physics.config.steps_per_period
    data.ctrl[:] = period.ctrl
    model.tree_sleep_policy[:] = period.policies
    if physics.machines.drive == "reduced":
        for car in physics.cars:
            model.actuator_forcerange[car.wheel_actuators] = period.limits[car.wheel_actuators]
    if period.rouse:
        model.opt.enableflags &= ~_SLEEP
    for _ in range(n):
        mujoco.mj_step(model, data)
        for effect in physics.effects:
            if effect.each_step:
                effect.after_step(physics)
        if period.rouse:
            model.opt.enableflags |= _SLEEP


def _replay(env: ParallelConstruction, seed: int, periods: list[_Period]) -> float:
    """Return the CPU time of the recorded periods without anything else."""
    env.reset(seed=seed)
    physics = _physics(env)
    begun = time.process_time()
    for period in periods:
        _step(physics, period)
    return time.process_time() - begun
