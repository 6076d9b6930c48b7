"""Disturbances of a world on purpose: what happens to cars and blocks that nobody planned.

A block is shoved by a force on it, as a hand would; a car out of action gets no commands any more. No pose is written.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.grid import Cell, Kind, beside
from craftsim.discrete.readback import read_grid
from craftsim.errors import InputError
from craftsim.models.measuring import Motors
from craftsim.models.parts import Joint
from craftsim.models.sensing import Sensors
from craftsim.models.world import PhysicsWorld
from craftsim.skills.fleet import PhysicsFleet

DisturbanceKind = Literal["shove", "dead-car"]

SHOVE_S: Final = 1.0
"""How long a shove over one cell takes."""
CLEAR_M: Final = 1.8 * CELL_PITCH_M
"""A block is shoved only while no car's centre is nearer to its way, so that it is pushed over the floor alone."""
_STIFFNESS_HZ: Final = 4.0
"""Of the hand that shoves: what it holds would swing so fast."""
_LIFTED: Final = 0.5
"""Share of the block's weight that the hand takes."""


@dataclass(frozen=True)
class Disturbance:
    """What is done to a world, and when. Raises InputError for a time that is none."""

    kind: DisturbanceKind
    """``shove``: a block on the floor that bears nothing goes one cell aside. ``dead-car``: a car's motors get no
    commands from then on; wheels, board and hinge brake. Which one is drawn from the world's seed."""
    start_s: float
    """Simulated time from which on it happens; a shove waits until no car is near."""

    def __post_init__(self) -> None:
        if not 0 <= self.start_s < math.inf:
            raise InputError(
                f"a disturbance begins after {self.start_s} s; allowed: a finite number from 0 on"
            )


class DisturbedFleet(PhysicsFleet):
    """The cars of a PhysicsWorld to which something happens."""

    def __init__(
        self,
        physics: PhysicsWorld,
        sensors: Sensors,
        motors: Motors,
        disturbance: Disturbance,
        rng: np.random.Generator,
    ) -> None:
        """Measure and command with these sensors and motors; ``rng`` draws what is hit."""
        super().__init__(physics, sensors, motors)
        self.disturbance, self._rng = disturbance, rng
        self.happened = ""
        """What has happened, in words; empty before."""
        self._dead: int | None = None
        self._shove: _Shove | None = None

    def advance(self, observe: Callable[[], None] | None = None) -> None:
        """Let one control period pass."""
        if not self.happened and self.physics.time_s >= self.disturbance.start_s:
            self._begin()
        if self._dead is not None:
            self.physics.drive(self._dead, (0.0, 0.0, 0.0, 0.0))
            self.physics.move_board(self._dead, 0.0)
            if (docked := int(self.sensors.read()[self._dead]["slope"])) >= 0:
                self.physics.turn_hinge(docked, 0.0)
        if self._shove is None:
            super().advance(observe)
            return
        shove = self._shove

        def push() -> None:
            shove.push(self.physics)
            if observe is not None:
                observe()

        shove.push(self.physics)
        super().advance(push)
        if shove.over(self.physics):
            self._shove = None

    def _begin(self) -> None:
        if self.disturbance.kind == "dead-car":
            self._dead = int(self._rng.integers(len(self.physics.cars)))
            self.happened = f"car {self._dead} is out of action from {self.physics.time_s:.2f} s on"
            return
        ways = list(self._ways())
        if not ways:
            return
        block, start, end = ways[int(self._rng.integers(len(ways)))]
        self._shove = _Shove(self.physics, self.physics.blocks[block], end)
        self.happened = f"block {block} is shoved from {start} to {end} at {self.physics.time_s:.2f} s"

    def _ways(self) -> list[tuple[int, Cell, Cell]]:
        """Return the blocks that can be shoved now, by number, with their cells and where to."""
        poses = self.physics.poses()
        reading = read_grid(poses, self.physics.size, self.physics.walls)
        grid, found = reading.grid, []
        blocks = [index for index, kind in enumerate(poses.kinds) if kind == Kind.BLOCK]
        for block, index in enumerate(blocks):
            placed = reading.objects[index]
            x, y, z = placed.cell
            bears = z < grid.size[2] and grid.kind[x, y, z + 1] != Kind.AIR
            if placed.carrier is not None or z != 1 or bears:
                continue
            for aim in (beside(placed.cell, yaw) for yaw in range(4)):
                free = grid.inside(aim) and grid.kind[aim] == Kind.AIR
                if free and _clear(poses.car_positions, placed.cell, aim):
                    found.append((block, placed.cell, aim))
        return found


def _clear(cars: np.ndarray[tuple[int, ...], np.dtype[np.float64]], *cells: Cell) -> bool:
    """Return whether no car is near any of some cells."""
    middles = (np.array([cell[:2] for cell in cells]) + 0.5) * CELL_PITCH_M
    ways = cars[:, None, :2] - middles[None]
    return bool((np.hypot(ways[..., 0], ways[..., 1]) > CLEAR_M).all())


class _Shove:
    """A hand that pushes a block over the floor to the middle of a cell: a force, never a pose."""

    def __init__(self, physics: PhysicsWorld, block: Joint, aim: Cell) -> None:
        self._block, self._begun_s = block, physics.time_s
        position, _ = physics.free_body_state(block)
        self._from, self._to = position[:2], (np.array(aim[:2]) + 0.5) * CELL_PITCH_M
        self._mass = float(physics.model.body_subtreemass[block.body])

    def push(self, physics: PhysicsWorld) -> None:
        """Set the force for the next physics step."""
        share = min((physics.time_s - self._begun_s) / SHOVE_S, 1.0)
        target = self._from + (self._to - self._from) * 0.5 * (1 - math.cos(math.pi * share))
        position, _ = physics.free_body_state(self._block)
        speed = physics.data.qvel[self._block.dof : self._block.dof + 2].copy()
        rate = 2 * math.pi * _STIFFNESS_HZ
        pull = self._mass * (rate**2 * (target - position[:2]) - 2 * rate * speed)
        force = physics.data.xfrc_applied[self._block.body]
        force[:2], force[2] = pull, _LIFTED * self._mass * 9.81

    def over(self, physics: PhysicsWorld) -> bool:
        """Return whether the block has arrived; the hand then lets go."""
        if physics.time_s < self._begun_s + 1.25 * SHOVE_S:
            return False
        physics.data.xfrc_applied[self._block.body] = 0.0
        return True
