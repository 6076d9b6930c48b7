"""Long episodes of random legal actions with many cars at once: does anything drift or fail in the long run?

Each tick every car draws one of the actions that the rules allow it on the predicted world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from craftsim.checking.scheduled_run import run_schedule
from craftsim.discrete.actions import Action
from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.readback import Reading, read_grid
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import make_schedule
from craftsim.models.noise import EXACT, NOISY
from craftsim.models.randomization import DomainRandomization, RandomizedSite
from craftsim.models.sensing import Sensors, read_poses
from craftsim.models.site import Site
from craftsim.skills.executor import Executor
from craftsim.validation.campaign import Done, Item
from craftsim.validation.statistics.records import Record, carried_out, error_counts

SIZE: Final = (6, 6, 4)
N_SLOPES: Final = 2
N_BLOCKS: Final = 10
EARLY: Final = 30
"""Actions after which the placement error is noted, to be compared with the end."""
TIMEOUT_S: Final = (60.0, 10.0)
"""An episode counts as hanging after so many seconds, and so many more for each action; most take a tenth of one."""
_WEIGHTS: Final = {
    Action.STOP: 0.0,
    Action.ROTATE_LEFT: 0.3,
    Action.ROTATE_RIGHT: 0.3,
    Action.FOLD: 0.15,
    Action.UNFOLD: 0.15,
    Action.LIFT: 2.0,
    Action.DROP: 0.6,
}
"""How much likelier an action is drawn than a move: so that cars do not turn on the spot all the time."""


@dataclass(frozen=True)
class EpisodeTrial:
    """One random episode."""

    seed: int
    n_actions: int = 300
    n_cars: int = 4
    noise: bool = False


@dataclass(frozen=True)
class EpisodeRecord:
    """What came of an episode; errors in metres."""

    trial: EpisodeTrial
    n_actions: int
    """Actions until the end, or until the first disagreement."""
    disagreement: tuple[str, ...]
    """What differed then; empty when all went as predicted."""
    early_error_m: float
    """The furthest that any object was from its place, carried ones from their car, in the first EARLY actions."""
    error_m: float
    """The same at the end."""
    worst_error_m: float
    """The same over the whole episode."""
    car_error_m: float
    """The furthest that any car was from its cell's centre, over the whole episode."""
    set_down: tuple[tuple[int, float], ...]
    """(actions so far, error) of everything that was set down, in order."""


def random_world(trial: EpisodeTrial, rng: np.random.Generator) -> Grid:
    """Return a level world of scattered blocks, two slopes, each with a block at its top, and cars."""
    grid = Grid.empty(SIZE, trial.n_cars)
    length, width, _ = SIZE
    cells = [(int(i) // width, int(i) % width) for i in rng.permutation(length * width)]
    used: set[tuple[int, int]] = set()
    placed = 0
    for x, y in cells:
        yaw = int(rng.integers(4))
        dx, dy = (int(v) for v in DIRECTIONS[yaw])
        three = {(x, y), (x + dx, y + dy), (x - dx, y - dy)}
        if placed == N_SLOPES or three & used or not three <= set(cells):
            continue
        folded = bool(rng.integers(2))
        grid.kind[x, y, 1] = Kind.FSLOPE if folded else Kind.BODY
        grid.kind[x + dx, y + dy, 1] = Kind.GEAR if folded else Kind.FOOT
        grid.yaw[x, y, 1] = grid.yaw[x + dx, y + dy, 1] = yaw
        grid.kind[x - dx, y - dy, 1] = Kind.BLOCK
        used |= three
        placed += 1
    free = [cell for cell in cells if cell not in used]
    for car in range(trial.n_cars):
        grid.cars[car, [CarField.X, CarField.Y]] = free[car]
        grid.cars[car, CarField.YAW] = int(rng.integers(4))
    for x, y in free[trial.n_cars : trial.n_cars + N_BLOCKS]:
        grid.kind[x, y, 1] = Kind.BLOCK
    grid.derive_marks()
    return grid


def run_episode(trial: EpisodeTrial) -> EpisodeRecord:
    """Run a random episode in physics until its end or its first disagreement."""
    world, sensors, physics = (np.random.default_rng(s) for s in np.random.SeedSequence(trial.seed).spawn(3))
    grid, rules = random_world(trial, world), Rules("physical")
    site = Site(grid)
    if trial.noise:
        RandomizedSite(site).draw(DomainRandomization(), physics)
    executor = Executor(site, sensors=Sensors(site, NOISY if trial.noise else EXACT, sensors))
    reading = read_grid(read_poses(site), site.size, site.walls)
    n = 0
    early = worst = worst_car = 0.0
    set_down: list[tuple[int, float]] = []
    disagreement: tuple[str, ...] = reading.problems
    while n < trial.n_actions and not disagreement:
        joint = _draw_tick(reading.grid, rules, world)
        if not joint:
            disagreement = ("no car has anything to do",)
            break
        run = run_schedule(executor, make_schedule(reading.grid, [joint], rules))
        n += len(joint)
        if not run.agrees:
            disagreement = (
                *run.verdict.differences,
                *(
                    f"{r.outcome} {r.difference}"
                    for r in run.records
                    if not r.outcome.succeeded or not r.in_place
                ),
            )
        before, reading = reading, run.final
        set_down += [
            (n, now.offset_m)
            for was, now in zip(before.objects, reading.objects, strict=True)
            if was.carrier is not None and now.carrier is None
        ]
        worst, worst_car = max(worst, _worst(reading)), max(worst_car, *(c.offset_m for c in reading.cars))
        early = worst if n <= EARLY else early
    return EpisodeRecord(trial, n, disagreement, early, _worst(reading), worst, worst_car, tuple(set_down))


def _worst(reading: Reading) -> float:
    return max(placed.offset_m for placed in reading.objects)


def _draw_tick(grid: Grid, rules: Rules, rng: np.random.Generator) -> list[tuple[int, Action]]:
    """Draw a legal action for each car that has one, in a random order."""
    joint: list[tuple[int, Action]] = []
    for car in (int(c) for c in rng.permutation(grid.n_cars)):
        legal = [action for action in Action if rules.legal(grid, car, action)]
        weights = np.array([_WEIGHTS.get(action, 1.0) for action in legal])
        if not weights.any():
            continue
        action = legal[int(rng.choice(len(legal), p=weights / weights.sum()))]
        joint.append((car, action))
        grid = rules.apply(grid, car, action)
    return joint


def items_of(episodes: int, seed: int, n_actions: int, n_cars: int, noise: bool) -> list[Item]:
    """Return the episodes of a campaign, of that many seeds in a row."""
    seeds = range(seed, seed + episodes)
    return [
        Item(f"episode {s}", "random", s, EpisodeTrial(s, n_actions, n_cars, noise), episode=s) for s in seeds
    ]


def do_episode(trial: EpisodeTrial) -> Done:
    """Do the work of an item; ``extra`` is the :class:`EpisodeRecord`."""
    record = run_episode(trial)
    return Done(agrees=not record.disagreement, extra=asdict(record))


def episode_figures(records: Sequence[Record], n_actions: int) -> dict[str, Any]:
    """Return what a report says of episodes of so many actions."""
    done = [record["extra"] for record in carried_out(records)]
    thirds: dict[str, list[float]] = {"first": [], "middle": [], "last": []}
    for episode in done:
        for n, error_m in episode["set_down"]:
            thirds[list(thirds)[min(2, 3 * n // (n_actions + 1))]].append(1e3 * error_m)
    return {
        "set_down_mm": {
            name: {"n": len(errors), "p50": float(np.median(errors or [0])), "max": max(errors, default=0.0)}
            for name, errors in thirds.items()
        },
        "records": done,
        "good": sum(record["agrees"] for record in records),
        "errors": error_counts(records),
    }
