"""Declared disturbances: what somebody does to a world in physics that no motor command does."""

import math
from collections.abc import Callable, Sequence
from typing import Final

import mujoco
import numpy as np

from craftsim.models.parts import Joint
from craftsim.models.world import PhysicsWorld
from craftsim.skills.executor import Executor, Observer

_PUSH_N: Final = 4.2
"""A little more than the friction of a block that nothing stands on."""


def push(block: int, by_m: float) -> Observer:
    """Return an observer that pushes a block along +x, from where it is first seen, until it is so far."""
    start: list[float] = []

    def hand(physics: PhysicsWorld) -> None:
        body = physics.blocks[block]
        x = float(physics.free_body_state(body)[0][0])
        if not start:
            start.append(x)
        physics.data.xfrc_applied[body.body, 0] = _PUSH_N if x < start[0] + by_m else 0.0

    return hand


def pushed(block: int, by_m: float) -> Callable[..., Executor]:
    """Return what makes executors in whose worlds a block is pushed."""

    def make(*args, **options) -> Executor:
        executor = Executor(*args, **options)
        executor.observers.append(push(block, by_m))
        return executor

    return make


_HAND_HZ: Final = 15.0
"""How fast what a hand holds would swing."""


def twist(executor: Executor, body: Joint, way: Callable[[float], Sequence[float] | None]) -> None:
    """Let a hand turn a free body from now on, by a torque alone that changes with each physics step.

    ``way`` says by what rotation vector in radians it should be turned by so many seconds of simulated time, from how
    it is when it is first held; with None the hand lets go.
    """
    physics, before = executor.physics, executor.step_observer
    mass = float(physics.model.body_subtreemass[body.body])
    inertia = float(physics.model.body_inertia[body.body].max()) + mass * 0.1**2
    rate = 2 * math.pi * _HAND_HZ
    start: list[np.ndarray] = []

    def turn() -> None:
        data = physics.data
        aim, torque = way(data.time), data.xfrc_applied[body.body, 3:]
        if aim is None:
            torque[:] = 0.0
            return
        quaternion = physics.free_body_state(body)[1]
        start.append(quaternion)
        (w0, *v0), (w, *v) = start[0], quaternion
        turned = 2 * (w0 * np.array(v) - w * np.array(v0) - np.cross(v, v0))
        spin = np.zeros(3)
        mujoco.mju_rotVecQuat(spin, data.qvel[body.dof + 3 : body.dof + 6], quaternion)
        torque[:] = inertia * (rate**2 * (np.array(aim) - turned) - 2 * rate * spin)

    def step() -> None:
        turn()
        if before is not None:
            before()

    executor.step_observer = step
