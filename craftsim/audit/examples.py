"""Examples for learned rules: actions in physics, each with what was around the car and whether it went as predicted.

They come from random legal play, and from single situations that a learner asks for.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.audit.situation import Situation
from craftsim.checking.attempt import Verdict
from craftsim.checking.judge import Judge
from craftsim.checking.setup import Seed, Setup, set_up
from craftsim.compiled.jit import seldom
from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint
from craftsim.discrete.grid import CarField, Grid, Kind, Piece, cell_of
from craftsim.discrete.kernel import patterns as bits
from craftsim.discrete.kernel.state import CarState
from craftsim.discrete.kinds import Action
from craftsim.discrete.learned import CAR_STATES, cell_words, mirror_of_cell, mirror_of_state
from craftsim.discrete.rules import Rules
from craftsim.errors import InputError, StartError
from craftsim.experiments.experiment import Result
from craftsim.validation.play import choose
from craftsim.validation.worlds import MAX_RANDOM_CARS, RandomWorlds

_WORDS: Final = bits.N_CELLS + 1
_write_surroundings = seldom(bits.write_surroundings)
_TICKS: Final = 16
"""Length of an episode of play."""
MOST_PLAYED: Final = _TICKS * MAX_RANDOM_CARS
"""Actions that an episode has at most."""
ROTATE_RIGHT: Final = bits.VERBS.index("ROTATE_RIGHT")
ROTATE_LEFT: Final = bits.VERBS.index("ROTATE_LEFT")


class WorldAction(NamedTuple):
    """An action that a car could do in a world."""

    world: str
    """As a blueprint."""
    car: int
    action: Action

    @property
    def grid(self) -> Grid:
        """The world."""
        return parse_blueprint(self.world, "world of an example").grid(np.random.default_rng(0))


def is_single_action(situation: Situation) -> bool:
    """Return whether a situation of an audit is one car's action that does something."""
    is_single = situation.order is None and len(situation.acts) == 1
    return is_single and situation.acts[0] != Action.STOP


def placed_action(situation: Situation) -> WorldAction:
    """Return a situation of an audit as it is tried."""
    placed = situation.placed(np.random.default_rng(situation.digest))
    return WorldAction(blueprint_text(placed.grid), 0, placed.acts[0])


@dataclass(frozen=True)
class PlayJob:
    """Random legal play by the rules of a setup in a drawn world, one action after the other."""

    seed: tuple[int, ...]
    setup: Setup


@dataclass(frozen=True)
class ActionsJob:
    """Single situations, each in a world of its own, by the rules of a setup."""

    seed: tuple[int, ...]
    """Of physics, before the number of the situation."""
    situations: tuple[WorldAction, ...]
    setup: Setup


class Example(NamedTuple):
    """An action that was tried."""

    verb: int
    surroundings: NDArray[np.int64]
    """(N_CELLS + 1,): bits of each cell in the frame of the action, and the number of the car's state."""
    worked: bool
    situation: WorldAction | None = None
    """Of one that did not go as predicted."""
    reason: str = ""
    is_near_miss: bool = False
    """Whether it is a failure without one thing."""
    trial: str = ""
    """Key of the trial that it is of: an episode of play, or some situations."""


def surroundings_of(grid: Grid, car: int, action: int) -> tuple[int, NDArray[np.int64]]:
    """Return the number of an action's verb and what is around the car; turns to the right as their mirror images."""
    row = CarState(*grid.cars[car].tolist())
    out = np.empty(_WORDS, np.int64)
    _write_surroundings(grid.world(), car, row, int(action), out)
    verb = bits.VERBS.index(_verb_name(action))
    if verb == ROTATE_RIGHT:
        return ROTATE_LEFT, mirrored(out[None])[0]
    return verb, out


def _verb_name(action: int) -> str:
    name = Action(action).name
    if name.startswith("MOVE"):
        return "MOVE"
    return name


def _mirror_places() -> NDArray[np.int64]:
    """Return of each cell the place of its mirror image."""
    side = bits.SIDE
    levels = bits.HIGHEST - bits.LOWEST + 1
    places = np.arange(bits.N_CELLS).reshape(side, side, levels)
    return np.ascontiguousarray(places[:, ::-1]).ravel()


_mirror_of_cells: Final[Any] = mirror_of_cell
"""Of arrays as of numbers."""
_MIRROR_PLACES: Final = _mirror_places()
_MIRROR_STATES: Final = np.array([mirror_of_state(state) for state in range(bits.N_OWN)])


def mirrored(surroundings: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the mirror images of some surroundings (n, N_CELLS + 1)."""
    images = np.empty_like(surroundings)
    images[:, :-1] = _mirror_of_cells(surroundings[:, _MIRROR_PLACES])
    images[:, -1] = _MIRROR_STATES[surroundings[:, -1]]
    return images


def try_actions(job: PlayJob | ActionsJob) -> Result:
    """Try actions in physics; the examples are in ``extra``, as :func:`examples_of` reads them."""
    if isinstance(job, PlayJob):
        rows = list(_played(job))
    else:
        rows = []
        for number, situation in enumerate(job.situations):
            rows += _tried(situation, job.setup, Seed((*job.seed, number)))
    has_failed = any(row["worked"] is False for row in rows)
    return Result(agrees=not has_failed, extra={"examples": rows})


def _played(job: PlayJob) -> Iterator[dict[str, Any]]:
    """Play until something fails: what failed is elsewhere than a grid says, and later actions might fail for it."""
    world_seed, physics_seed, play_seed = np.random.SeedSequence(job.seed).spawn(3)
    grid = RandomWorlds().grid(np.random.default_rng(world_seed))
    judge = _judge(grid, job.setup, Seed.of(physics_seed))
    if judge is None:
        return
    rng = np.random.default_rng(play_seed)
    done: Counter[str] = Counter()
    for _ in range(_TICKS):
        for car in rng.permutation(grid.n_cars).tolist():
            chosen = choose(judge.grid, judge.rules, rng, car, done)
            if chosen is None or chosen[0] == Action.STOP:
                continue
            row = _performed(judge, car, chosen[0])
            yield row
            if judge.problems or not row["worked"]:
                return


def _tried(situation: WorldAction, setup: Setup, seed: Seed) -> Iterator[dict[str, Any]]:
    """Try a situation, if the rules allow it."""
    grid = situation.grid
    if not Rules(setup.rules).legal(grid, situation.car, situation.action):
        return
    judge = _judge(grid, setup, seed)
    if judge is not None:
        yield _performed(judge, situation.car, situation.action)


def _judge(grid: Grid, setup: Setup, seed: Seed) -> Judge | None:
    """Return a world in physics; None for one that cannot stand."""
    try:
        judge = set_up(grid, setup, seed)
    except StartError:
        return None
    if judge.problems or not judge.grid.same_visible(grid):
        return None
    return judge


def _performed(judge: Judge, car: int, action: Action) -> dict[str, Any]:
    """Perform an action and return its example as JSON values; "worked" is None where the solver gave up."""
    grid = judge.grid
    verb, surroundings = surroundings_of(grid, car, action)
    attempt = judge.perform(car, action)
    if attempt.result == Verdict.NUMERICS:
        return {"verb": verb, "worked": None}
    row: dict[str, Any] = {
        "verb": verb,
        "around": base64.b64encode(zlib.compress(surroundings.tobytes())).decode(),
        "worked": attempt.agrees,
    }
    if not attempt.agrees:
        row |= {"world": blueprint_text(grid), "car": car, "action": action.name}
        row["reason"] = attempt.reason
    return row


def examples_of(records: Iterable[Mapping[str, Any]]) -> Iterator[Example]:
    """Yield the examples of the trials of jobs, in their order, without those in which the solver gave up."""
    for record in records:
        for row in record["extra"].get("examples", ()):
            if row["worked"] is None:
                continue
            packed = zlib.decompress(base64.b64decode(row["around"]))
            situation = None
            if "world" in row:
                situation = WorldAction(row["world"], row["car"], Action[row["action"]])
            surroundings = np.frombuffer(packed, np.int64)
            yield Example(
                row["verb"],
                surroundings,
                row["worked"],
                situation,
                row.get("reason", ""),
                trial=record["key"],
            )


def unsolved_in(records: Iterable[Mapping[str, Any]]) -> int:
    """Return the number of actions in which the solver gave up."""
    n_unsolved = 0
    for record in records:
        for row in record["extra"].get("examples", ()):
            n_unsolved += row["worked"] is None
    return n_unsolved


def episodes_of(examples: Iterable[Example]) -> tuple[list[int], list[bool]]:
    """Return the number of actions of each episode of play, and whether its last one failed."""
    n_actions: Counter[str] = Counter()
    failed: dict[str, bool] = {}
    for example in examples:
        n_actions[example.trial] += 1
        failed[example.trial] = not example.worked
    return list(n_actions.values()), list(failed.values())


def near_misses(situation: WorldAction) -> list[WorldAction]:
    """Return the same action in worlds without one thing, car or load near the car, where that can be."""
    grid = situation.grid
    x, y, z = cell_of(grid, situation.car)
    worlds: list[tuple[Grid, int]] = []
    for piece in grid.pieces(Kind.BLOCK, Kind.FLAG, Kind.FSLOPE, Kind.BODY, Kind.WALL):
        if _is_near((x, y, z), piece.cell) and not _bears(grid, piece):
            without = grid.copy()
            without.take(piece.cell)
            worlds.append((without, situation.car))
    for other_car in range(grid.n_cars):
        if other_car == situation.car or not _is_near((x, y, z), cell_of(grid, other_car)):
            continue
        if grid.cars[other_car, CarField.LOAD] != Kind.AIR:
            unloaded = grid.copy()
            unloaded.cars[other_car, CarField.LOAD : CarField.SLOPE] = 0
            worlds.append((unloaded, situation.car))
        emptied = Grid(grid.cells.copy(), np.delete(grid.cars, other_car, axis=0))
        worlds.append((emptied, situation.car - int(other_car < situation.car)))
    misses: list[WorldAction] = []
    for world, car in worlds:
        world.derive_marks()
        try:
            text = blueprint_text(world)
            parse_blueprint(text, "near miss")
        except InputError:
            continue
        misses.append(WorldAction(text, car, situation.action))
    return misses


def _bears(grid: Grid, piece: Piece) -> bool:
    """Return whether something stands on a thing, or a car is on it."""
    for x, y, z in piece.cells:
        # A gear may reach out of the map.
        above = (x, y, z + 1)
        if grid.inside((x, y, z)) and grid.kind_at(above) not in (Kind.AIR, Kind.GEAR, Kind.WALL):
            return True
    for x, y, z, *_, slope in grid.cars.tolist():
        on_foot = slope == 1 and (x, y, z) in piece.cells
        if on_foot or (x, y, z - 1) in piece.cells:
            return True
    return False


def _is_near(place: tuple[int, int, int], cell: tuple[int, int, int]) -> bool:
    """Return whether a cell is one that patterns name."""
    dx = abs(cell[0] - place[0])
    dy = abs(cell[1] - place[1])
    return max(dx, dy) <= bits.REACH_CELLS and bits.LOWEST <= cell[2] - place[2] <= bits.HIGHEST


def trace_lines(examples: Iterable[Example]) -> Iterator[str]:
    """Yield a JSON line for each example: the action, the car, what is around it but air, and whether it worked.

    Cells are ahead, left and up from the car, with the words of files of learned rules; turns are to the left.
    """
    levels = bits.HIGHEST - bits.LOWEST + 1
    for example in examples:
        cells: dict[str, tuple[str, ...]] = {}
        for number in np.flatnonzero(example.surroundings[:-1] != 1).tolist():
            forward, remaining = divmod(number, bits.SIDE * levels)
            aside, up = divmod(remaining, levels)
            at = (forward - bits.REACH_CELLS, aside - bits.REACH_CELLS, up + bits.LOWEST)
            cells[",".join(map(str, at))] = cell_words(int(example.surroundings[number]))
        line = {
            "action": bits.VERBS[example.verb],
            "car": CAR_STATES[int(example.surroundings[-1])],
            "cells": cells,
            "worked": example.worked,
            "reason": example.reason,
        }
        yield json.dumps(line) + "\n"
