"""What decides a world in physics besides its Grid and its seed: limits, noise and what cars assume of it, gains."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from pathlib import Path
from typing import Final, Literal

from craftsim.discrete.rules import RuleSet
from craftsim.errors import InputError, suggestion
from craftsim.models.config import SimulationConfig
from craftsim.models.noise import EXACT, MILD, NOISY, SensorNoise
from craftsim.models.parameter_files import load_machines, load_noise
from craftsim.models.parameters import NOMINAL, Drive, Machines
from craftsim.models.randomization import DomainRandomization
from craftsim.skills.gains import Gains, load_gains

nominal_gains = cache(load_gains)


@dataclass(frozen=True)
class Thresholds:
    """The largest errors with which an action still agrees with its prediction; set before anything is run.

    Raises InputError for what is no finite number.
    """

    car_m: float = 0.001
    """Distance of the car from its cell's centre."""
    heading_rad: float = 0.003
    placed_m: float = 0.002
    """Distance of what was set down, folded or unfolded from its cell's centre."""
    bystander_m: float = 0.001
    """Displacement of anything that the action does not concern."""
    height_m: float = 0.002

    def __post_init__(self) -> None:
        for f in fields(self):
            if not math.isfinite(getattr(self, f.name)):
                raise InputError(f"Thresholds.{f.name} must be a finite number, not {getattr(self, f.name)}")


@dataclass(frozen=True)
class Setup:
    """Configuration of a world in physics; hashable, and written into every report and replay bundle."""

    rules: RuleSet = "physical"
    """The rule set that predicts."""
    thresholds: Thresholds = field(default_factory=Thresholds)
    noise: SensorNoise = EXACT
    """Of the cars' sensors and motors: what the world does."""
    assumed: SensorNoise = EXACT
    """What the cars' pose estimate takes that noise to be; with none they take each measured pose as it is."""
    randomization: DomainRandomization | None = None
    """From which each seed draws its own physics; None for the nominal one."""
    simulation: SimulationConfig = field(default_factory=SimulationConfig)
    gains: Gains = field(default_factory=nominal_gains)
    machines: Machines = NOMINAL

    @property
    def digests(self) -> dict[str, str]:
        """SHA-256 of what a user may bring."""
        return {"gains": self.gains.digest, "machines": self.machines.digest}


Randomize = Literal["none", "mild", "strong"]

_STRONG: Final = (Thresholds(0.003, 0.009, 0.005, 0.002, 0.003), NOISY, DomainRandomization())
"""A car that knows its place to 1 mm and 3 mrad is allowed three times that."""
_MILD: Final = (
    Thresholds(0.0015, 0.0045, 0.0025, 0.001, 0.002),
    MILD,
    DomainRandomization(
        **{f.name: getattr(DomainRandomization(), f.name) / 2 for f in fields(DomainRandomization)}
    ),
)
"""Half of that noise and randomization; limits are halved where that leaves them above those without noise."""

RANDOMIZE: Final[Mapping[Randomize, tuple[Thresholds, SensorNoise, DomainRandomization | None]]] = {
    "none": (Thresholds(), EXACT, None),
    "mild": _MILD,
    "strong": _STRONG,
}
"""What the option ``--randomize`` stands for: thresholds, sensor noise and domain randomization."""


def setup_of(
    randomize: Randomize = "none",
    rules: RuleSet = "physical",
    gains: Gains | str | Path | None = None,
    machines: Machines | str | Path | None = None,
    noise: SensorNoise | str | Path | None = None,
    assume: SensorNoise | str | Path | None = None,
    drive: Drive | None = None,
) -> Setup:
    """Return the configuration that the options of the commands stand for.

    Args:
        randomize: sensor noise and domain randomization, with limits that suit them.
        rules: the rule set that predicts.
        gains: of the skills, a preset's name, or a file of them; those of the file of the machines, if it has some,
            unless given.
        machines: their parameters, or a file of them; the nominal ones unless given.
        noise: of the sensors and motors, or a file of it, in place of that of ``randomize``.
        assume: what the cars take that noise to be: none, mild, strong, noise, or a file of it. Unless given, that of
            ``randomize``, whatever ``noise`` says.
        drive: rollers or reduced; that of the machines unless given.

    Raises InputError for what no file should say.
    """
    if gains is None and isinstance(machines, str | Path):
        gains = machines
    if not isinstance(gains, Gains):
        gains = nominal_gains() if gains is None else load_gains(gains)
    if not isinstance(machines, Machines):
        machines = NOMINAL if machines is None else load_machines(Path(machines))
    if drive is not None:
        machines = replace(machines, drive=drive)
    thresholds, declared, randomization = RANDOMIZE[randomize]
    return Setup(
        rules,
        thresholds,
        _noise(noise, declared),
        _noise(assume, declared),
        randomization,
        SimulationConfig.of(machines.drive),
        gains=gains,
        machines=machines,
    )


def _noise(given: SensorNoise | str | Path | None, declared: SensorNoise) -> SensorNoise:
    if given is None:
        return declared
    if isinstance(given, SensorNoise):
        return given
    for name, (_, noise, _) in RANDOMIZE.items():
        if given == name:
            return noise
    if not Path(given).suffix:
        known = ", ".join(RANDOMIZE)
        raise InputError(
            f"unknown noise '{given}'{suggestion(str(given), RANDOMIZE)}; there are {known}, or give a YAML file"
        )
    return load_noise(given, declared)
