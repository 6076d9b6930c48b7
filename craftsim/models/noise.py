"""What is imperfect about a robot's sensors and motors: declared, seeded, off unless asked for."""

from __future__ import annotations

from dataclasses import dataclass, fields

from craftsim.discrete.errors import InputError


@dataclass(frozen=True)
class SensorNoise:
    """Noise, delay and lag of one car's sensors and motors; hashable. Raises InputError for a negative figure.

    They concern localisation (at the control rate of 50 Hz), wheel encoders and wheel motors. Pitch and roll, board and
    hinge are read as they are: good inclinometers and encoders err far less than localisation does.

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
        """Whether a car measures its true pose at once."""
        return self.exact_pose and not self.encoder_lag_s


EXACT = SensorNoise()
"""No noise, no delay, no lag."""

NOISY = SensorNoise(
    position_m=0.001,
    heading_rad=0.003,
    min_delay_s=0.02,
    max_delay_s=0.04,
    encoder_lag_s=0.01,
    motor_lag_s=0.01,
)
"""The noise under which skills are validated."""

MILD = SensorNoise(**{field.name: getattr(NOISY, field.name) / 2 for field in fields(SensorNoise)})
"""Half of it."""
