"""What an executor drives: the cars of a PhysicsWorld, or robots that are reached in another way.

A :class:`DisturbedFleet` is a PhysicsWorld in which something unplanned happens: a force pushes a block, as a hand
would, or a car gets no commands any more. No pose is written.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Final, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.arrays import Arrays, Floats, Records
from craftsim.compiled.jit import compiled
from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.grid import Cell, Kind, beside
from craftsim.discrete.readback import read_grid
from craftsim.errors import InputError
from craftsim.models.measuring import Motors, drive_wheels
from craftsim.models.parts import Joint
from craftsim.models.sensing import Sensors
from craftsim.models.world import PhysicsWorld
from craftsim.skills.skill import Command
from craftsim.skills.state import GRAVITY
from craftsim.storage.writing import LEFT_OUT_IF_EMPTY
from craftsim.workers.copying import Copyable

_SAME_S: Final = 1e-6
"""Largest difference of times that are the same: those of a world are sums of time steps."""
SHOVE_S: Final = 1.0
"""How long a shove over one cell takes."""
CLEAR_M: Final = 1.8 * CELL_PITCH_M
"""A block is shoved only while no car's centre is nearer to its way, so that it is pushed over the floor alone."""
_STIFFNESS_HZ: Final = 4.0
"""Natural frequency of the spring between the hand and the block."""
_LIFTED: Final = 0.5
"""Share of the block's weight that the hand takes."""


class Fleet(Protocol):
    """Cars that can be measured and commanded, one control period after the other."""

    lost: str
    """The reason why the cars cannot be driven any more; empty while they can."""

    @property
    def lost_cars(self) -> Mapping[int, str]:
        """Reasons why single cars cannot be driven any more, by car."""

    @property
    def late_periods(self) -> int:
        """Control periods until what is commanded now has been done and seen."""

    def read(self) -> Records:
        """Return the newest readings of all cars, shape (n,) of READING; the array is used again by the next ones."""

    def ahead(self, readings: Records) -> Records:
        """Return readings, the newest or those with estimated poses, for the time when the next command begins."""

    def attend(self) -> None:
        """Measure anew: cars that were idle are about to act."""

    def begin(self, car: int) -> None:
        """Note that a car begins an action."""

    def command(self, cars: Records) -> None:
        """Take the commands of all cars, (n,) of CAR; a hinge's is for the slope that the car is docked to."""

    def advance(self, observe: Callable[[], None] | None = None) -> None:
        """Execute the commands for one control period, and measure; do nothing once :attr:`lost`.

        ``observe`` is called after every physics step, if there are any.
        """

    def stop(self, car: int) -> None:
        """Command the motors of a car to zero at once, and the hinge that it commands."""


class PhysicsFleet(Copyable):
    """The cars of a PhysicsWorld."""

    _bound = ("_cars", "_command")

    lost = ""
    lost_cars: Mapping[int, str] = {}
    late_periods = 0

    def __init__(
        self, physics: PhysicsWorld, sensors: Sensors | None = None, motors: Motors | None = None
    ) -> None:
        """Measure and command with these sensors and motors: exact and prompt ones unless given."""
        self.physics = physics
        self.sensors = sensors or Sensors(physics)
        self.motors = motors or Motors(physics)
        self._docked = np.full(len(physics.cars), -1)
        """(n,): the slope that a car commands, or -1."""
        self._bind()

    def _bind(self) -> None:
        self._cars: Records | None = None
        self._command: Callable[[], None]
        """Commands these cars."""

    def read(self) -> Records:
        """Return the newest readings of all cars."""
        return self.sensors.read()

    def ahead(self, readings: Records) -> Records:
        """Return the readings: commands begin at once."""
        return readings

    def attend(self) -> None:
        """Do nothing: no time passes while cars are idle."""

    def begin(self, car: int) -> None:
        """Do nothing."""

    def command(self, cars: Records) -> None:
        """Command the motors of all cars, and the hinges of the slopes that they are docked to."""
        if self._cars is not cars:
            servos = self.motors.speeds, np.array([self.motors.share]), self.physics.data.ctrl
            wiring = self.sensors.cars, self.sensors.plugs
            self._cars = cars
            self._command = partial(_command, wiring, servos, self._docked, cars)
        self._command()

    def advance(self, observe: Callable[[], None] | None = None) -> None:
        """Let one control period pass."""
        self.physics.advance(observe)
        self.sensors.observe()

    def drive(self, car: int, command: Command, slope: int) -> None:
        """Command the motors of one car, and the hinge of the slope that it is docked to, -1 for none."""
        self.motors.drive(car, command.wheels)
        self.physics.move_board(car, command.board)
        before = int(self._docked[car])
        self._docked[car] = slope
        for hinged_slope, speed in ((before, 0.0), (slope, command.hinge)):
            if hinged_slope >= 0:
                self.physics.turn_hinge(hinged_slope, speed)

    def stop(self, car: int) -> None:
        """Command a car's motors to zero, and the hinge of its slope."""
        self.drive(car, Command(), int(self._docked[car]))


@compiled
def _command(
    wiring: tuple[Records, Records], servos: Arrays, docked: NDArray[np.int64], cars: Records
) -> None:
    motors, plugs = wiring
    speeds, share, ctrl = servos
    for i in range(len(cars)):
        command = cars[i].command
        slope = cars[i].now.slope
        drive_wheels(command.wheels, speeds[i], share[0], motors[i], ctrl)
        ctrl[motors[i].board_motor] = command.board
        # A slope that loses its car loses the command.
        if docked[i] >= 0 and docked[i] != slope:
            ctrl[plugs[docked[i]].motor] = 0.0
        if slope >= 0:
            ctrl[plugs[slope].motor] = command.hinge
        docked[i] = slope


@dataclass(frozen=True)
class Disturbance:
    """A disturbance of a world at a time. Raises InputError for a time that is none."""

    kind: Literal["shove", "dead-car"]
    """``shove``: a block on the floor that bears nothing goes one cell aside. ``dead-car``: a car's motors get no
    commands from then on; wheels, board and hinge brake. Which one is drawn from the world's seed."""
    start_s: float
    """Simulated time from which on it happens; a shove waits until no car is near."""
    action: int | None = field(default=None, metadata={LEFT_OUT_IF_EMPTY: True})
    """Number, from 1, of the action with whose beginning a car dies, whatever the time; None: at ``start_s``."""

    def __post_init__(self) -> None:
        if not 0 <= self.start_s < math.inf:
            after = f"a disturbance begins after {self.start_s} s"
            raise InputError(f"{after}; allowed: a finite number from 0 on")
        if self.action is not None and (self.kind != "dead-car" or self.action < 1):
            raise InputError(
                f"a {self.kind} with action {self.action}; allowed: a dead-car, and numbers from 1"
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
        """Measure and command with these sensors and motors; ``rng`` draws which car or block is concerned."""
        super().__init__(physics, sensors, motors)
        self.disturbance = disturbance
        self._rng = rng
        self.happened = ""
        """The disturbance in words; empty before it."""
        self._dead: int | None = None
        self._n_begun = np.zeros(len(physics.cars), np.int64)
        """(n,): actions that the cars have begun."""
        self._mortal = -1
        """The car that is to die with one of its actions; drawn when the first begins."""
        self._shove: tuple[Joint, Floats, Floats, float] | None = None
        """A block that is shoved, its start and end in x and y, and the time at which that began."""

    def begin(self, car: int) -> None:
        """Count the action of a car, which may die with it."""
        if self.disturbance.action is None:
            return
        if self._mortal < 0:
            self._mortal = int(self._rng.integers(len(self.physics.cars)))
        self._n_begun[car] += 1
        if car == self._mortal and self._n_begun[car] == self.disturbance.action:
            self._disable(car)

    def advance(self, observe: Callable[[], None] | None = None) -> None:
        """Let one control period pass."""
        at_a_time = self.disturbance.action is None
        if (
            at_a_time
            and not self.happened
            and self.physics.time_s >= self.disturbance.start_s - _SAME_S
        ):
            self._begin()
        if self._dead is not None:
            self.stop(self._dead)
        if self._shove is None:
            super().advance(observe)
            return
        block, start, end, begun_s = self._shove

        def push() -> None:
            self._push(block, start, end, self.physics.time_s - begun_s)
            if observe is not None:
                observe()

        self._push(block, start, end, self.physics.time_s - begun_s)
        super().advance(push)
        if self.physics.time_s >= begun_s + 1.25 * SHOVE_S:
            self._let_go(block)
            self._shove = None

    def _begin(self) -> None:
        physics = self.physics
        if self.disturbance.kind == "dead-car":
            self._disable(int(self._rng.integers(len(physics.cars))))
            return
        shoves = self._possible_shoves()
        if shoves:
            number, start, end = shoves[int(self._rng.integers(len(shoves)))]
            block = physics.blocks[number]
            aim = (np.array(end[:2]) + 0.5) * CELL_PITCH_M
            self._shove = block, physics.free_body_state(block)[0][:2], aim, physics.time_s
            self.happened = (
                f"block {number} is shoved from {start} to {end} at {physics.time_s:.2f} s"
            )

    def _disable(self, car: int) -> None:
        self._dead = car
        self.happened = f"car {car} is out of action from {self.physics.time_s:.2f} s on"

    def _possible_shoves(self) -> list[tuple[int, Cell, Cell]]:
        """Return the blocks that can be shoved now, by number, with their cells and where to."""
        poses = self.physics.poses()
        reading = read_grid(poses, self.physics.size, self.physics.walls)
        grid = reading.grid
        shoves = []
        blocks = [index for index, kind in enumerate(poses.kinds) if kind == Kind.BLOCK]
        for block, index in enumerate(blocks):
            placed = reading.objects[index]
            x, y, z = placed.cell
            bears = z < grid.size[2] and grid.kind[x, y, z + 1] != Kind.AIR
            if placed.carrier is not None or z != 1 or bears:
                continue
            for aim in (beside(placed.cell, yaw) for yaw in range(4)):
                free = grid.inside(aim) and grid.kind[aim] == Kind.AIR
                middles = (np.array([placed.cell[:2], aim[:2]]) + 0.5) * CELL_PITCH_M
                offsets = poses.car_positions[:, None, :2] - middles[None]
                if free and (np.hypot(offsets[..., 0], offsets[..., 1]) > CLEAR_M).all():
                    shoves.append((block, placed.cell, aim))
        return shoves

    def _push(self, block: Joint, start: Floats, end: Floats, passed_s: float) -> None:
        physics = self.physics
        share = min(passed_s / SHOVE_S, 1.0)
        target = start + (end - start) * 0.5 * (1 - math.cos(math.pi * share))
        position, _ = physics.free_body_state(block)
        speed = physics.data.qvel[block.dof : block.dof + 2].copy()
        rate = 2 * math.pi * _STIFFNESS_HZ
        mass = float(physics.model.body_subtreemass[block.body])
        force = physics.data.xfrc_applied[block.body]
        force[:2] = mass * (rate**2 * (target - position[:2]) - 2 * rate * speed)
        force[2] = _LIFTED * mass * GRAVITY

    def _let_go(self, block: Joint) -> None:
        self.physics.data.xfrc_applied[block.body] = 0.0
