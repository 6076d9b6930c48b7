"""What is imperfect about a robot's sensors and motors: declared, seeded, off unless asked for."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final

from craftsim.errors import InputError
from craftsim.models.imperfection import check_shares


@dataclass(frozen=True)
class SensorNoise:
    """What one car's sensors and motors lack; hashable. Raises InputError for a negative figure, or one of 1 or more.

    All sensors are read at the control rate of 50 Hz, and localisations arrive as often unless a period is given. All
    noise is drawn for each car; standard deviations are those of white noise, but of a drift and of jitter.

    Example:
        >>> import craftsim
        >>> craftsim.SensorNoise(position_m=0.001, heading_rad=0.003).silent
        False
    """

    position_m: float = 0.0
    """Standard deviation of each position coordinate of one localisation, white."""
    heading_rad: float = 0.0
    """Standard deviation of the heading of one localisation, white."""
    position_bias_m: float = 0.0
    """By so much each car is localised beside its place, in a horizontal direction of the world that is drawn once."""
    heading_bias_rad: float = 0.0
    """By so much each car's heading is localised off, to a side that is drawn once."""
    position_drift_m: float = 0.0
    """Standard deviation of what the bias of x and that of y walk in a second: sqrt(t) as much in t seconds."""
    heading_drift_rad: float = 0.0
    """Standard deviation of what the heading's bias walks in a second."""
    min_delay_s: float = 0.0
    """Least age of a localisation; each car's own delay is drawn once, uniformly up to ``max_delay_s``."""
    max_delay_s: float = 0.0
    jitter_s: float = 0.0
    """Standard deviation of the age of single localisations; none comes before it was taken."""
    localisation_period_s: float = 0.0
    """Time between two localisations, as of a camera; a car reads the last one until then. Each car has its own phase.
    0: the control period."""
    lost_share: float = 0.0
    """Share of the localisations that do not arrive: the car reads the one before."""
    outlier_share: float = 0.0
    """Share of the localisations that are wrong..."""
    outlier_m: float = 0.0
    """...and by how much, in a horizontal direction that is drawn each time."""
    encoder_lag_s: float = 0.0
    """Time constant of the wheel speeds' low-pass filter."""
    encoder_step_rad: float = 0.0
    """Angle of one count of a wheel's encoder; speeds are differences of counts over a control period. 0: the speed of
    the moment."""
    motor_lag_s: float = 0.0
    """Time constant with which a wheel's commanded speed reaches its servo."""
    tilt_rad: float = 0.0
    """Standard deviation of pitch and of roll."""
    tilt_bias_rad: float = 0.0
    """By so much pitch and roll are off, up or down, drawn once each."""
    board_m: float = 0.0
    """Standard deviation of the board's height."""
    board_bias_m: float = 0.0
    """By so much the board's height is off, up or down, drawn once."""
    board_force_n: float = 0.0
    """Standard deviation of the force of the board's motor."""
    board_force_bias_n: float = 0.0
    """By so much that force is off, drawn once."""
    hinge_rad: float = 0.0
    """Standard deviation of the hinge angle of a docked slope."""
    hinge_bias_rad: float = 0.0
    """By so much that angle is off, drawn once."""
    line_m: float = 0.0
    """Standard deviation of where a line sensor sees a line."""
    undocked_share: float = 0.0
    """Share of the readings in which the plug of a docked slope has no contact: the car feels no slope, and its command
    does not reach the hinge."""

    def __post_init__(self) -> None:
        check_shares(self)
        if self.max_delay_s < self.min_delay_s:
            raise InputError("SensorNoise.max_delay_s must not be below min_delay_s")

    @property
    def exact_pose(self) -> bool:
        """Whether localisations are exact and in time."""
        return not any(getattr(self, name) for name in _OF_LOCALISATIONS)

    @property
    def silent(self) -> bool:
        """Whether a car measures all that it measures exactly and at once."""
        return not any(getattr(self, f.name) for f in fields(self) if f.name != "motor_lag_s")


_OF_LOCALISATIONS: Final = (
    *(
        "position_m",
        "heading_rad",
        "position_bias_m",
        "heading_bias_rad",
        "position_drift_m",
        "heading_drift_rad",
    ),
    *("max_delay_s", "jitter_s", "localisation_period_s", "lost_share", "outlier_share"),
)

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
    # Assumed: a row of reflex sensors 8 mm apart, interpolated.
    line_m=0.0004,
    # Assumed: spring contacts that chatter.
    undocked_share=0.001,
)
"""The noise under which skills are validated."""

ASSUMED = SensorNoise(
    position_m=0.001,
    heading_rad=0.003,
    position_bias_m=0.005,
    heading_bias_rad=0.01,
    # A bias that is learnt is not kept for ever: 1 mm and 2 mrad in a minute and a half.
    position_drift_m=0.0001,
    heading_drift_rad=0.0002,
    max_delay_s=0.15,
    jitter_s=0.01,
    line_m=0.0004,
)
"""What cars take the noise of their sensors to be unless told otherwise, whatever it is: where they start from before
they find out. Only what the pose estimate uses is in it."""

MILD = SensorNoise(**{field.name: getattr(NOISY, field.name) / 2 for field in fields(SensorNoise)})
"""Half of it."""
