"""Setting up a world in physics from a Grid, a configuration and a seed: the one place where its parts are joined."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from craftsim.checking.checked_site import CheckedSite
from craftsim.checking.settings import Setup
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.rules import Rules
from craftsim.errors import InputError, StartError
from craftsim.models.measuring import Motors
from craftsim.models.overlaps import ALLOWED_M
from craftsim.models.randomization import randomize
from craftsim.models.sensing import Sensors
from craftsim.models.world import Site
from craftsim.skills.disturbances import DisturbedFleet
from craftsim.skills.executor import Executor
from craftsim.skills.fleet import Fleet

MAX_WORDS: Final = 64
"""Numbers in a seed."""


@dataclass(frozen=True)
class Seed:
    """Where a random generator starts: entropy and spawn key of NumPy's SeedSequence.

    Raises InputError for what NumPy does not take.
    """

    entropy: tuple[int, ...]
    spawn_key: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if min((*self.entropy, *self.spawn_key), default=0) < 0 or max(self.spawn_key, default=0) >= 2**32:
            raise InputError("a seed's entropy must be 0 or more, and its spawn key from 0 to 2**32 - 1")
        if len(self.entropy) + len(self.spawn_key) > MAX_WORDS:
            raise InputError(f"a seed of more than {MAX_WORDS} numbers")

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
SetUp = Callable[[Grid, Setup, Seed, Sequence[Cell]], CheckedSite]
"""Sets up a world from its start, its configuration, its seed and the cells to mark, as :func:`set_up` does."""


def compile_world(grid: Grid, setup: Setup, goals: Sequence[Cell] = ()) -> Site:
    """Return the compiled world of a grid, to be set up again and again; it stands nowhere yet."""
    floor = setup.randomization.floor
    return Site(grid, setup.simulation, goals, reset=False, machines=setup.machines, floor=floor)


def set_up(
    grid: Grid,
    setup: Setup,
    seed: Seed = SEED_0,
    goals: Sequence[Cell] = (),
    reuse: Site | None = None,
    watch_contacts: bool = True,
) -> CheckedSite:
    """Return a world in physics, ready for actions.

    Args:
        grid: the start.
        setup: everything that is configured.
        seed: decides the physics and the noise that are drawn.
        goals: cells to mark.
        reuse: a Site of an equal grid, simulation, floor and goals to be used again, which saves compiling; its
            numbers are the same as those of a fresh one.
        watch_contacts: as of :class:`CheckedSite`.

    Raises StartError where something would stand in something else.
    """
    physics, sensors, hits = (np.random.default_rng(s) for s in seed.sequence().spawn(3))
    site = reuse or compile_world(grid, setup, goals)
    if setup.randomization.nominal:
        site.reset_compiled()
    else:
        randomize(site, setup.randomization, physics)
    measured = Sensors(site, setup.randomization.sensors, sensors)
    fleet = None
    if setup.disturbance is not None:
        motors = Motors(site, setup.randomization.sensors.motor_lag_s)
        fleet = DisturbedFleet(site, measured, motors, setup.disturbance, hits)
    return judge_on(site, setup, measured, watch_contacts, fleet)


def check_start(site: Site) -> None:
    """Raise StartError where something stood in something else when a Site was reset."""
    if site.overlaps:
        raise StartError(
            f"this world cannot be: {'; '.join(map(str, site.overlaps))} (allowed {1e3 * ALLOWED_M:.0f} mm); "
            "move or turn one of them, or unload the car"
        )


def judge_on(
    site: Site,
    setup: Setup,
    sensors: Sensors | None = None,
    watch_contacts: bool = True,
    fleet: Fleet | None = None,
) -> CheckedSite:
    """Return the judge on a Site as it stands, whose machines and simulation are its own; sensors are exact if None.

    A ``fleet`` are robots elsewhere, of which the Site shows where they are.

    Raises StartError where something stood in something else when the Site was reset.
    """
    check_start(site)
    site.set_drivetrain(setup.randomization.drivetrain)
    motors = Motors(site, setup.randomization.sensors.motor_lag_s)
    executor = Executor(site, setup.gains, None, sensors, motors, setup.assumed, fleet, setup.skills)
    return CheckedSite(executor, Rules(setup.rules), setup.thresholds, watch_contacts)
