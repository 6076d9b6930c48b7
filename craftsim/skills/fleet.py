"""What an executor drives: the cars of a PhysicsWorld, or robots that are reached in another way."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol

import numpy as np

from craftsim.models.measuring import Floats, Motors, Records
from craftsim.models.sensing import Sensors
from craftsim.models.world import PhysicsWorld


class Wires(NamedTuple):
    """Where compiled laws leave the motors' commands, as :func:`craftsim.skills.laws.step_cars` takes them."""

    cars: Records
    """(n,) WIRING: where a car's motors lie in ``ctrl``."""
    plugs: Records
    """UNDERSIDE of each slope: where its hinge's motor lies."""
    speeds: Floats
    """(n, 4) rad/s: what the wheels' servos were told last."""
    share: Floats
    """(1,): by what share these approach a new command in a control period."""
    ctrl: Floats
    """The commands."""


class Fleet(Protocol):
    """Cars that can be measured and commanded, one control period after the other."""

    wires: Wires
    lost: str
    """Why the cars cannot be driven any more; empty while they can."""

    @property
    def lost_cars(self) -> Mapping[int, str]:
        """Why single cars cannot be driven any more, by car."""

    @property
    def late_periods(self) -> int:
        """Control periods until what is commanded now has been done and seen."""

    def read(self) -> Records:
        """Return the newest readings of all cars, shape (n,) of READING; the array is used again by the next ones."""

    def attend(self) -> None:
        """Get ready: cars that were left alone are about to act."""

    def advance(self, observe: Callable[[], None] | None = None) -> None:
        """Let one control period pass under the commands on the wires, and take the readings of its end.

        ``observe`` is called after every physics step, where there are some. Once :attr:`lost`, nothing passes.
        """

    def stop(self, car: int, slope: int) -> None:
        """Command the motors of a car to zero, and the hinge of the slope that it commands, -1 for none."""


class PhysicsFleet:
    """The cars of a PhysicsWorld."""

    lost = ""
    lost_cars: Mapping[int, str] = {}
    late_periods = 0

    def __init__(
        self, physics: PhysicsWorld, sensors: Sensors | None = None, motors: Motors | None = None
    ) -> None:
        """Measure and command with these sensors and motors: exact and prompt ones unless given."""
        self.physics = physics
        self.sensors, self.motors = sensors or Sensors(physics), motors or Motors(physics)
        share = np.array([self.motors.share])
        self.wires = Wires(
            self.sensors.cars, self.sensors.plugs, self.motors.speeds, share, physics.data.ctrl
        )

    def read(self) -> Records:
        """Return the newest readings of all cars."""
        return self.sensors.read()

    def attend(self) -> None:
        """Do nothing: while nobody acts, no time passes."""

    def advance(self, observe: Callable[[], None] | None = None) -> None:
        """Let one control period pass."""
        self.physics.advance(observe)
        self.sensors.observe()

    def stop(self, car: int, slope: int) -> None:
        """Command a car's motors to zero, and the hinge of a slope."""
        self.motors.drive(car, (0.0, 0.0, 0.0, 0.0))
        self.physics.move_board(car, 0.0)
        if slope >= 0:
            self.physics.turn_hinge(slope, 0.0)
