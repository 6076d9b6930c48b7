"""What attempts in physics run under: limits that are set beforehand, noise, randomised physics, simulation."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from craftsim.models.config import SimulationConfig
from craftsim.models.noise import EXACT, NOISY, SensorNoise
from craftsim.models.variation import Spread


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
    """Of the cars' senses and motors."""
    spread: Spread | None = None
    """From which each trial draws its own physics; None for the nominal one."""
    simulation: SimulationConfig = field(default_factory=SimulationConfig)


NOMINAL: Final = TrialSettings()
"""Exact senses, nominal physics."""

WITH_NOISE: Final = TrialSettings(Thresholds(0.003, 0.009, 0.005, 0.002, 0.003), NOISY, Spread())
"""Noisy senses and randomised physics. A car that knows its place to 1 mm and 3 mrad is allowed three times that."""
