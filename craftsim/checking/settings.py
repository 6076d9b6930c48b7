"""What attempts in physics run under: limits that are set beforehand, noise, randomised physics, simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Final, Literal

from craftsim.models.config import SimulationConfig
from craftsim.models.noise import EXACT, NOISY, SensorNoise
from craftsim.models.randomization import DomainRandomization


@dataclass(frozen=True)
class Thresholds:
    """The largest errors with which an action counts as done well."""

    car_m: float = 0.001
    heading_rad: float = 0.003
    placed_m: float = 0.002
    others_m: float = 0.001
    height_m: float = 0.002


@dataclass(frozen=True)
class TrialSettings:
    """What a trial runs under besides its world; hashable, and written into the report."""

    thresholds: Thresholds = field(default_factory=Thresholds)
    noise: SensorNoise = EXACT
    """Of the cars' sensors and motors."""
    randomization: DomainRandomization | None = None
    """From which each trial draws its own physics; None for the nominal one."""
    simulation: SimulationConfig = field(default_factory=SimulationConfig)


NOMINAL: Final = TrialSettings()
"""Exact sensors, nominal physics."""

WITH_NOISE: Final = TrialSettings(Thresholds(0.003, 0.009, 0.005, 0.002, 0.003), NOISY, DomainRandomization())
"""Noisy sensors and randomised physics. A car that knows its place to 1 mm and 3 mrad is allowed three times that."""

MILDLY: Final = TrialSettings(
    Thresholds(0.0015, 0.0045, 0.0025, 0.001, 0.002),
    SensorNoise(**{f.name: getattr(NOISY, f.name) / 2 for f in fields(SensorNoise)}),
    DomainRandomization(
        **{f.name: getattr(DomainRandomization(), f.name) / 2 for f in fields(DomainRandomization)}
    ),
)
"""Half of that noise and randomisation; limits are halved where that leaves them above those without noise."""

Randomize = Literal["none", "mild", "strong"]

SETTINGS: Final[Mapping[Randomize, TrialSettings]] = {
    "none": NOMINAL,
    "mild": MILDLY,
    "strong": WITH_NOISE,
}
"""What the option ``--randomize`` stands for."""
