"""What is imperfect about a robot's sensors and motors: declared, seeded, off unless asked for."""

from __future__ import annotations

from dataclasses import dataclass, fields

from craftsim.errors import InputError


@dataclass(frozen=True)
class SensorNoise:
    """Noise, delay and lag of one car's sensors and motors; hashable. Raises InputError for a negative figure.

    All sensors are read at the control rate of 50 Hz; all noise is white, and drawn for each car.

    Example:
        >>> import craftsim
        >>> craftsim.SensorNoise(position_m=0.001, heading_rad=0.003).silent
        False
    """

    position_m: float = 0.0
    """Standard deviation of each position coordinate of one localisation, white."""
    heading_rad: float = 0.0
    """Standard deviation of the heading of one localisation, white."""
    min_delay_s: float = 0.0
    """Least age of a localisation; each car's own delay is drawn once, uniformly up to ``max_delay_s``."""
    max_delay_s: float = 0.0
    encoder_lag_s: float = 0.0
    """Time constant of the wheel speeds' low-pass filter."""
    motor_lag_s: float = 0.0
    """Time constant with which a wheel's commanded speed reaches its servo."""
    tilt_rad: float = 0.0
    """Standard deviation of pitch and of roll."""
    board_m: float = 0.0
    """Standard deviation of the board's height."""
    board_force_n: float = 0.0
    """Standard deviation of the force of the board's motor."""
    hinge_rad: float = 0.0
    """Standard deviation of the hinge angle of a docked slope."""
    undocked_share: float = 0.0
    """Share of the readings in which the plug of a docked slope has no contact: the car feels no slope, and its command
    does not reach the hinge."""

    def __post_init__(self) -> None:
        for field in fields(self):
            if not 0 <= getattr(self, field.name) < 1:
                raise InputError(
                    f"SensorNoise.{field.name} must be at least 0 and below 1, not {getattr(self, field.name)}"
                )
        if self.max_delay_s < self.min_delay_s:
            raise InputError("SensorNoise.max_delay_s must not be below min_delay_s")

    @property
    def exact_pose(self) -> bool:
        """Whether localisations are exact and in time."""
        return not (self.position_m or self.heading_rad or self.max_delay_s)

    @property
    def silent(self) -> bool:
        """Whether a car measures all that it measures exactly and at once."""
        joints = self.board_m or self.board_force_n or self.hinge_rad or self.undocked_share
        return self.exact_pose and not (self.encoder_lag_s or self.tilt_rad or joints)


EXACT = SensorNoise()
"""No noise, no delay, no lag."""

NOISY = SensorNoise(
    position_m=0.001,
    heading_rad=0.003,
    min_delay_s=0.02,
    max_delay_s=0.04,
    encoder_lag_s=0.01,
    motor_lag_s=0.01,
    # An accelerometer of 400 ug/sqrt(Hz) (data sheet of the InvenSense MPU-6050) over the 25 Hz that 50 readings a
    # second can hold: 2 mg, which is the tilt in mrad.
    tilt_rad=0.002,
    # Assumed: the lead screw is counted at its motor, a few micrometres a count.
    board_m=0.000005,
    # Assumed: felt by the current of the board's motor, 5 % of what it lifts with a block.
    board_force_n=0.3,
    # A magnetic encoder of 12 bits (ams AS5600, 0.015 degrees RMS in its slow filter mode).
    hinge_rad=0.00026,
    # Assumed: spring contacts that chatter.
    undocked_share=0.001,
)
"""The noise under which skills are validated."""

MILD = SensorNoise(**{field.name: getattr(NOISY, field.name) / 2 for field in fields(SensorNoise)})
"""Half of it."""
