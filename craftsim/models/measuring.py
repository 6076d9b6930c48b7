"""What a robot can measure, and how it is commanded: its pose, its joints, the slope that it stands under, its motors.

All cars are measured in one compiled call. Skills see the world through records of :data:`READING` or, one of
them at a time, :class:`CarMeasurement`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from pydantic import AfterValidator, Field

from craftsim.compiled.arrays import Arrays, Floats, Records
from craftsim.compiled.jit import Record, compiled, layout, records
from craftsim.discrete.kernel.rotation import arcsine, body_axes
from craftsim.models.world import PhysicsWorld
from craftsim.storage.limits import PHYSICS_PARTS, Range
from craftsim.workers.copying import Copyable

WIRING: Final = layout(
    i8="pose board board_dof board_activation board_motor",
    i8x4="wheel_speeds wheel_motors",
    f8="plug_m above_m along_m across_m line_m",
)
"""Where a car's joints and motors lie in MuJoCo's arrays, and its wheels' speeds in qvel; how far from its middle it
feels a slope's plug, and how high something is above it; how far its line sensors lie before and behind its middle, and
beside it, and how far to a side each sees."""

UNDERSIDE: Final = layout(i8="pose slope hinge motor")
"""What bears a cross below: where its pose lies in MjData.qpos; a slope's number, where its hinge lies there, and its
motor in MjData.ctrl; these are -1 for other things."""

CROSS_M: Final = 0.15
"""How far the two lines of a cross reach from its middle: assumed, to the legs of a block."""


Metres = Annotated[float, Range(-1e4, 1e4)]
"""Several times the largest world."""
Radians = Annotated[float, Range(-1e3, 1e3)]
"""A heading may count turns."""
WheelSpeed = Annotated[float, Range(-1e3, 1e3)]
"""rad/s: 50 times what the wheels do."""
Wheels = tuple[WheelSpeed, WheelSpeed, WheelSpeed, WheelSpeed]
"""A number for each wheel, in the order of WHEELS."""
Hinge = Annotated[float, Range(-1.0, math.pi + 1.0)]
"""rad; 0 unfolded, pi folded."""


def _near(line: float) -> float:
    if line > 1 and math.isfinite(line):
        raise ValueError("a line lies within 1 m, or infinitely far")
    return line


_Line = Annotated[float, Range(-1.0), Field(allow_inf_nan=True), AfterValidator(_near)]
"""How far a line lies from where it was looked for, in metres; infinitely where none is seen."""


class CarMeasurement(NamedTuple):
    """One car's view of itself at one instant, bounded by what a robot may send; world frame, metres and radians."""

    time_s: Annotated[float, Range(0.0, 1e9)]
    x: Metres
    y: Metres
    z: Metres
    """Height of the point on the floor between the wheels."""
    heading: Radians
    pitch: Radians
    """Nose up positive."""
    roll: Radians
    """Left side up positive."""
    wheel_speeds: Wheels
    """In rad/s."""
    board_m: Annotated[float, Range(-1.0, 1.0)]
    """Height of the board above its lower stop."""
    board_force_n: Annotated[float, Range(-1e6, 1e6)]
    """Force of the board's motor, up positive: the weight of board and load when it is at rest."""
    slope: Annotated[int, Range(0, PHYSICS_PARTS, below=True)] | None
    """The slope whose plug the car is docked to, if any."""
    hinge_rad: Hinge | None
    """Hinge angle of that slope."""
    position_std_m: Annotated[float, Range(0.0, 1e4)] = 0.0
    """How unsure the car is of its position: one standard deviation of x and of y."""
    heading_std_rad: Annotated[float, Range(0.0, 1e3)] = 0.0
    """How unsure the car is of its heading."""
    fresh: bool = True
    """Whether a localisation has arrived since the last reading; else x, y, z and heading are as they were."""
    lines: tuple[_Line, _Line, _Line, _Line] = (math.inf, math.inf, math.inf, math.inf)
    """Where the sensors before, behind, left and right in the board see a line above: how far to the left those before
    and behind, how far forward the others; inf where one sees none."""


READING: Final = np.dtype(
    [
        (
            name,
            "i8" if name in ("slope", "fresh") else "f8",
            4 if name in ("wheel_speeds", "lines") else (),
        )
        for name in CarMeasurement._fields
    ],
    align=True,
)
"""A :class:`CarMeasurement` as a record; without a slope, -1 and an angle of 0."""


def measurement_of(reading: np.void) -> CarMeasurement:
    """Return a reading, a record of READING, as a measurement."""
    values: dict[str, Any] = dict(zip(CarMeasurement._fields, reading.tolist(), strict=True))
    for name in ("wheel_speeds", "lines"):
        values[name] = tuple(values[name].tolist())
    if values["slope"] < 0:
        values["slope"] = values["hinge_rad"] = None
    return CarMeasurement(**values | {"fresh": bool(values["fresh"])})


def write_reading(measurement: CarMeasurement, reading: Records) -> None:
    """Write a measurement into a record, shape (1,) of READING."""
    if measurement.slope is None or measurement.hinge_rad is None:
        measurement = measurement._replace(slope=-1, hinge_rad=0.0)
    reading[0] = tuple(measurement)


def wire_cars(physics: PhysicsWorld) -> Records:
    """Return where the cars of a world lie in MuJoCo's arrays, (n,) WIRING."""
    wires = records(len(physics.cars), WIRING)
    for row, car in zip(wires, physics.cars, strict=True):
        board = car.board
        parameters = car.parameters
        row["pose"] = car.base.qpos
        row["board"] = board.qpos
        row["board_dof"] = board.dof
        row["board_activation"] = board.activation
        row["board_motor"] = board.actuator
        row["wheel_speeds"] = car.wheel_dofs
        row["wheel_motors"] = car.wheel_actuators
        row["plug_m"] = physics.machines.slope.docking_range_m
        row["above_m"] = physics.machines.block.underside_m / 2
        row["along_m"] = parameters.board_length_m / 2
        row["across_m"] = parameters.board_width_m / 2
        row["line_m"] = parameters.line_reach_m
    return wires


def wire_undersides(physics: PhysicsWorld) -> Records:
    """Return what bears a cross below, (n,) UNDERSIDE: tables, and then slopes."""
    rows = [(body.qpos, -1, -1, -1) for body in physics.tables]
    for number, slope in enumerate(physics.slopes):
        rows.append((slope.base.qpos, number, slope.hinge.qpos, slope.hinge.actuator))
    undersides = records(len(rows), UNDERSIDE)
    undersides[:] = rows
    return undersides


def exact_reader(physics: PhysicsWorld, cars: Records, undersides: Records) -> Callable[..., Any]:
    """Return a function of the time in seconds that measures all cars exactly into records, (n,) of READING."""
    model = physics.model
    data = physics.data
    state = data.qpos, data.qvel, data.act
    motors = model.actuator_gainprm, model.actuator_biasprm, model.actuator_forcerange
    return partial(_read_cars, state, motors, cars, undersides)


@compiled
def _read_cars(
    state: Arrays, motors: Arrays, cars: Records, undersides: Records, time_s: float, out: Records
) -> None:
    """Measure all cars, by positions, speeds and activations, and by what boards' motors give."""
    qpos, qvel, act = state
    gains, biases, ranges = motors
    for i in range(len(cars)):
        car = cars[i]
        reading = out[i]
        reading.time_s = time_s
        at = car.pose
        reading.x = qpos[at]
        reading.y = qpos[at + 1]
        reading.z = qpos[at + 2]
        forward, leftward, up = body_axes(qpos[at + 3], qpos[at + 4], qpos[at + 5], qpos[at + 6])
        reading.heading = math.atan2(forward[1], forward[0])
        reading.pitch = arcsine(forward[2])
        reading.roll = arcsine(leftward[2])
        for wheel in range(4):
            reading.wheel_speeds[wheel] = qvel[car.wheel_speeds[wheel]]
        reading.board_m = qpos[car.board]
        # That of a position-holding drive; MuJoCo's own figure is 0 while the drive's tree sleeps.
        motor = car.board_motor
        force = gains[motor, 0] * act[car.board_activation] + biases[motor, 0]
        force += biases[motor, 1] * qpos[car.board] + biases[motor, 2] * qvel[car.board_dof]
        reading.board_force_n = min(max(force, ranges[motor, 0]), ranges[motor, 1])
        reading.slope = -1
        reading.hinge_rad = 0.0
        reading.position_std_m = reading.heading_std_rad = 0.0
        reading.fresh = 1
        for k in range(4):
            reading.lines[k] = math.inf
        for number in range(len(undersides)):
            underside = undersides[number]
            at = underside.pose
            x = qpos[at] - reading.x
            y = qpos[at + 1] - reading.y
            z = qpos[at + 2] - reading.z
            above = up[0] * x + up[1] * y + up[2] * z
            if abs(above) >= car.above_m:
                continue
            # The slope right above: its plug reaches a car that is centred below it.
            if underside.slope >= 0 and reading.slope < 0:
                along = forward[0] * x + forward[1] * y + forward[2] * z
                across = leftward[0] * x + leftward[1] * y + leftward[2] * z
                if math.sqrt(along * along + across * across) < car.plug_m:
                    reading.slope = underside.slope
                    reading.hinge_rad = qpos[underside.hinge]
            # Where the line sensors see the cross below what is right above the car.
            if abs(x) > 2 * CROSS_M or abs(y) > 2 * CROSS_M:
                continue
            first, second, _ = body_axes(qpos[at + 3], qpos[at + 4], qpos[at + 5], qpos[at + 6])
            for k in range(4):
                if k < 2:
                    place = forward
                    far_m = car.along_m * (1 - 2 * k)
                    axis = leftward
                else:
                    place = leftward
                    far_m = car.across_m * (5 - 2 * k)
                    axis = forward
                # From the middle of the cross to the sensor, and from there on along the axis, by its two lines.
                off = (far_m * place[0] - x, far_m * place[1] - y, far_m * place[2] - z)
                off_first = off[0] * first[0] + off[1] * first[1] + off[2] * first[2]
                off_second = off[0] * second[0] + off[1] * second[1] + off[2] * second[2]
                to_first = axis[0] * first[0] + axis[1] * first[1] + axis[2] * first[2]
                to_second = axis[0] * second[0] + axis[1] * second[1] + axis[2] * second[2]
                # The axis meets the line that lies more across it.
                if abs(to_second) > abs(to_first):
                    line_at = -off_second / to_second
                    from_middle = off_first + line_at * to_first
                else:
                    line_at = -off_first / to_first
                    from_middle = off_second + line_at * to_second
                if abs(line_at) < car.line_m and abs(from_middle) < CROSS_M:
                    reading.lines[k] = line_at


class Motors(Copyable):
    """The wheel motors of all cars of a PhysicsWorld, with the lag of a SensorNoise; a stopped drive brakes at once."""

    _bound = ("_ctrl",)

    def __init__(self, physics: PhysicsWorld, lag_s: float = 0.0) -> None:
        """Take commands once a control period; ``lag_s`` is the time constant with which they reach the servos."""
        self._physics = physics
        self._cars = wire_cars(physics)
        if lag_s:
            self.share = 1 - math.exp(-physics.config.control_period_s / lag_s)
        else:
            self.share = 1.0
        """Share by which a servo's command approaches a new one in a control period."""
        self.speeds = np.zeros((len(physics.cars), 4))
        """(n, 4) rad/s: the servos' commands."""
        self._bind()

    def _bind(self) -> None:
        self._ctrl = self._physics.data.ctrl

    def drive(self, car: int, wheels: Wheels) -> None:
        """Command the wheels of a car, in rad/s."""
        commanded = np.array(wheels, dtype=float)
        drive_wheels(commanded, self.speeds[car], self.share, self._cars[car], self._ctrl)


@compiled
def drive_wheels(wheels: Floats, speeds: Floats, share: float, car: Record, ctrl: Floats) -> None:
    """Command the wheels of a car whose servos are commanded ``speeds`` so far."""
    stopped = wheels[0] == 0.0 and wheels[1] == 0.0 and wheels[2] == 0.0 and wheels[3] == 0.0
    for wheel in range(4):
        if stopped or share == 1.0:
            speeds[wheel] = wheels[wheel]
        else:
            speeds[wheel] += share * (wheels[wheel] - speeds[wheel])
        ctrl[car.wheel_motors[wheel]] = speeds[wheel]
