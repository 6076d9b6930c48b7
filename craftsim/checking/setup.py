"""The configuration of a world in physics, and the one place where a world is set up from it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, Final, Literal, cast, get_args

import numpy as np

from craftsim.checking.judge import Judge
from craftsim.checking.thresholds import Thresholds, thresholds_of
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.learned import as_rule_set
from craftsim.discrete.rules import Rules, RuleSet
from craftsim.errors import InputError, StartError, suggestion
from craftsim.mjcf.drives import Drive
from craftsim.mjcf.machines import NOMINAL, Machines, load_machines, machine_file
from craftsim.models.config import SimulationConfig
from craftsim.models.measuring import Motors
from craftsim.models.parts import ALLOWED_M
from craftsim.models.randomization import NONE, DomainRandomization, randomize
from craftsim.models.sensing import ASSUMED, SensorNoise, Sensors
from craftsim.models.world import PhysicsWorld
from craftsim.skills.executor import Executor
from craftsim.skills.fleet import Disturbance, DisturbedFleet, Fleet
from craftsim.skills.gains import Gains, load_gains
from craftsim.skills.library import OwnSkill, SkillChoice, own_skills
from craftsim.storage.records import record
from craftsim.storage.writing import LEFT_OUT_IF_EMPTY
from craftsim.storage.yaml import read_document

nominal_gains = cache(load_gains)


@dataclass(frozen=True)
class Setup:
    """Configuration of a world in physics; hashable, and written into every report and replay bundle."""

    rules: RuleSet = "physical"
    """Rule set for the predictions."""
    randomization: DomainRandomization = NONE
    """Randomization of physics and floor, and imperfections of sensors and motors."""
    assumed: SensorNoise = ASSUMED
    """Sensor noise that the cars' pose estimators assume at first; with none they use measured poses unfiltered."""
    simulation: SimulationConfig = field(default_factory=SimulationConfig)
    gains: Gains = field(default_factory=nominal_gains)
    machines: Machines = NOMINAL
    disturbance: Disturbance | None = None
    """A declared disturbance."""
    skills: tuple[OwnSkill, ...] = field(default=(), metadata={LEFT_OUT_IF_EMPTY: True})
    """User-defined skills."""
    recovers: bool = field(default=False, metadata={LEFT_OUT_IF_EMPTY: True})
    """Whether a car whose action has failed for good goes back to where it began; the action stays failed."""

    @property
    def thresholds(self) -> Thresholds:
        """The limits of the judge. They follow from the machines alone."""
        return thresholds_of(self.machines)

    @property
    def draws(self) -> bool:
        """Whether a run may draw anything at random, so that trials of one start and one plan may differ."""
        nominal = self.randomization.nominal and self.randomization.sensors == SensorNoise()
        return not nominal or self.disturbance is not None or bool(self.skills)

    @property
    def provenance(self) -> dict[str, Any]:
        """Setup, limits and digests, as reports hold them."""
        return {"setup": self, "thresholds": self.thresholds, "digests": self.digests}

    @property
    def digests(self) -> dict[str, str]:
        """SHA-256 of the user's files and skills."""
        return {"gains": self.gains.digest, "machines": self.machines.digest}


Randomize = Literal["none", "mild", "strong", "lab_floor", "workshop_floor"]

RANDOMIZE: Final[dict[Randomize, DomainRandomization]] = {"none": NONE}
"""The presets of ``--randomize``."""


@record(kw_only=True)
class _File(DomainRandomization):
    """A randomization file; missing values are those of its base."""

    base: Randomize = "none"


def _read(file: str | Path) -> DomainRandomization:
    document = read_document(Path(file))
    base = document.plain.get("base", "none")
    if not isinstance(base, str) or base not in RANDOMIZE:
        base = "none"  # the record below refuses it
    content = document.over(asdict(RANDOMIZE[base])).to(_File)
    values = {entry.name: getattr(content, entry.name) for entry in fields(DomainRandomization)}
    return DomainRandomization(**values)


for _preset in get_args(Randomize)[1:]:
    with as_file(files("craftsim.data").joinpath(f"randomizations/{_preset}.yaml")) as _file:
        RANDOMIZE[_preset] = _read(_file)


def setup_of(
    randomize: DomainRandomization | Randomize | str | Path = "none",
    rules: RuleSet | str | Path = "physical",
    gains: Gains | str | Path | None = None,
    machines: Machines | str | Path | None = None,
    noise: SensorNoise | str | Path | None = None,
    assume: SensorNoise | str | Path | None = None,
    drive: Drive | None = None,
    skills: SkillChoice | None = None,
) -> Setup:
    """Return the configuration for the options of the commands.

    Args:
        randomize: name of a preset, a YAML file (docs/explanation/imperfections.md), or a randomization.
        rules: rule set for the predictions, or a YAML file of learned rules.
        gains: name of a preset, or a file; default: those in the file of the machines, or robust.
        machines: parameters, or a file of them; default: nominal.
        noise: noise of sensors and motors, or a file; default: that of ``randomize``.
        assume: noise that the cars assume at first: none, mild, strong, noise, or a file; default: ASSUMED of
            :mod:`craftsim.models.sensing`, independent of ``randomize`` and ``noise``.
        drive: wheels or rollers; default: that of the machines.
        skills: user-defined skills, as for :class:`craftsim.Executor`.

    Raises InputError for an invalid file.
    """
    if isinstance(machines, str | Path):
        machines = machine_file(machines)
    if gains is None and isinstance(machines, Path):
        gains = machines
    # Machines first: an error in a file of both then names the sections of machines, not the keys of gains.
    if not isinstance(machines, Machines):
        if machines is None:
            machines = NOMINAL
        else:
            machines = load_machines(machines)
    if not isinstance(gains, Gains):
        if gains is None:
            gains = nominal_gains()
        else:
            gains = load_gains(gains)
    if drive is not None:
        machines = replace(machines, drive=drive)
    randomization = _drawn(randomize)
    randomization = replace(randomization, sensors=_noise(noise, randomization.sensors))
    return Setup(
        as_rule_set(rules),
        randomization,
        _noise(assume, ASSUMED),
        SimulationConfig(),
        gains=gains,
        machines=machines,
        skills=own_skills(skills),
    )


def _drawn(randomize: DomainRandomization | str | Path) -> DomainRandomization:
    """Return the randomization of a preset or a file, or the one given."""
    if isinstance(randomize, DomainRandomization):
        return randomize
    if _is_preset(randomize, "randomization"):
        return RANDOMIZE[cast(Randomize, randomize)]
    return _read(randomize)


def _noise(noise: SensorNoise | str | Path | None, declared: SensorNoise) -> SensorNoise:
    if noise is None:
        return declared
    if isinstance(noise, SensorNoise):
        return noise
    if _is_preset(noise, "noise"):
        return RANDOMIZE[cast(Randomize, noise)].sensors
    return read_document(Path(noise)).over(asdict(declared)).to(SensorNoise)


def _is_preset(choice: str | Path, option: str) -> bool:
    """Return whether this is the name of a preset. Raises InputError for an unknown name without a file suffix."""
    if choice not in RANDOMIZE and not Path(str(choice)).suffix:
        presets = ", ".join(RANDOMIZE)
        raise InputError(
            f"unknown {option} '{choice}'{suggestion(str(choice), RANDOMIZE)}; there are {presets}, or give a YAML file"
        )
    return choice in RANDOMIZE


_MAX_WORDS: Final = 64
"""Numbers in a seed."""


@dataclass(frozen=True)
class Seed:
    """Start of a random generator: entropy and spawn key of NumPy's SeedSequence."""

    entropy: tuple[int, ...]
    spawn_key: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if (
            min((*self.entropy, *self.spawn_key), default=0) < 0
            or max(self.spawn_key, default=0) >= 2**32
        ):
            raise InputError(
                "a seed's entropy must be 0 or more, and its spawn key from 0 to 2**32 - 1"
            )
        if len(self.entropy) + len(self.spawn_key) > _MAX_WORDS:
            raise InputError(f"a seed of more than {_MAX_WORDS} numbers")

    @classmethod
    def of(cls, sequence: np.random.SeedSequence) -> Seed:
        """Return the seed of a sequence, spawned or not."""
        entropy = sequence.entropy
        words = (entropy,) if isinstance(entropy, int) else tuple(entropy or ())
        return cls(tuple(int(word) for word in words), tuple(sequence.spawn_key))

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Seed:
        """Return a seed that a generator decides."""
        return cls(tuple(rng.integers(0, 2**32, 4).tolist()))

    def sequence(self) -> np.random.SeedSequence:
        """Return a fresh sequence."""
        return np.random.SeedSequence(self.entropy, spawn_key=self.spawn_key)


SEED_0: Final = Seed((0,))
SetUp = Callable[[Grid, Setup, Seed, Sequence[Cell]], Judge]
"""Sets up a world from its start, its configuration, its seed and the cells to mark, as :func:`set_up` does."""


def compile_world(grid: Grid, setup: Setup, goals: Sequence[Cell] = ()) -> PhysicsWorld:
    """Return the compiled world of a grid, to be set up repeatedly."""
    floor = setup.randomization.floor
    return PhysicsWorld(
        grid, setup.simulation, goals, reset=False, machines=setup.machines, floor=floor
    )


def set_up(
    grid: Grid,
    setup: Setup,
    seed: Seed = SEED_0,
    goals: Sequence[Cell] = (),
    reuse: PhysicsWorld | None = None,
    watch_contacts: bool = True,
) -> Judge:
    """Return a world in physics, ready for actions. Raises StartError if solids would overlap.

    ``goals`` are cells to mark. ``reuse`` is a PhysicsWorld of an equal grid, simulation, floor and goals, which saves
    compiling; results are the same as with a new one. ``watch_contacts`` is as of :class:`Judge`.
    """
    world_rng, sensor_rng, disturbance_rng = (
        np.random.default_rng(sequence) for sequence in seed.sequence().spawn(3)
    )
    physics = reuse or compile_world(grid, setup, goals)
    if setup.randomization.nominal:
        physics.reset_compiled()
    else:
        randomize(physics, setup.randomization, world_rng)
    measured = Sensors(physics, setup.randomization.sensors, sensor_rng)
    fleet = None
    if setup.disturbance is not None:
        motors = Motors(physics, setup.randomization.sensors.motor_lag_s)
        fleet = DisturbedFleet(physics, measured, motors, setup.disturbance, disturbance_rng)
    return judge_on(physics, setup, measured, watch_contacts, fleet)


def check_start(physics: PhysicsWorld) -> None:
    """Raise StartError if solids overlapped when a PhysicsWorld was reset."""
    if physics.overlaps:
        raise StartError(
            f"this world cannot be: {'; '.join(map(str, physics.overlaps))} (allowed {1e3 * ALLOWED_M:.0f} mm); "
            "move or turn one of them, or unload the car"
        )


def judge_on(
    physics: PhysicsWorld,
    setup: Setup,
    sensors: Sensors | None = None,
    watch_contacts: bool = True,
    fleet: Fleet | None = None,
) -> Judge:
    """Return the judge on a world in its present state. Raises StartError if solids overlapped at its start.

    ``sensors`` are exact unless given; a ``fleet`` are robots elsewhere, whose poses the PhysicsWorld shows.
    """
    check_start(physics)
    physics.set_drivetrain(setup.randomization.drivetrain)
    motors = Motors(physics, setup.randomization.sensors.motor_lag_s)
    executor = Executor(
        physics,
        setup.gains,
        None,
        sensors,
        motors,
        setup.assumed,
        fleet,
        setup.skills,
        setup.recovers,
    )
    return Judge(executor, Rules(setup.rules), watch_contacts)
