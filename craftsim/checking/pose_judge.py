"""The judge as a library: the verdict on one action of any robot or simulator, from poses before and after it."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from craftsim.checking.attempt import Attempt, Cause, attempt_of, compare_reading
from craftsim.checking.contacts import (
    TIPPED_RAD,
    Contact,
    Hazard,
    distances,
    handled,
    pose_rows,
    under,
    unexpected_contacts,
)
from craftsim.checking.measurements import Ending, sample_all
from craftsim.checking.thresholds import thresholds_of
from craftsim.checking.watched import Watched
from craftsim.compiled.arrays import Floats
from craftsim.discrete.actions import footprint
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.kinds import CARRIED, Action
from craftsim.discrete.readback import Poses, describe_car, own_differences, read_grid
from craftsim.discrete.rules import Rules, RuleSet
from craftsim.discrete.schedule import ScheduledAction
from craftsim.errors import InputError, check_choice
from craftsim.mjcf.building import GROUND
from craftsim.mjcf.machines import NOMINAL, Machines
from craftsim.models.parts import WALL
from craftsim.skills.outcome import Outcome


def judge_poses(
    before: Poses,
    after: Poses,
    car: int,
    action: Action | str,
    *,
    size: Cell,
    walls: ArrayLike = (),
    rules: RuleSet = "physical",
    predicted: Grid | None = None,
    machines: Machines = NOMINAL,
    contacts: Iterable[tuple[str, str, float]] = (),
    duration_s: float = 0.0,
    tries: int = 1,
    boards_m: ArrayLike | None = None,
    way_m: float = 0.0,
    way_lean_rad: float = 0.0,
) -> Attempt:
    """Return the verdict on one action that ran alone, by the limits of :func:`thresholds_of`.

    It is the judge of ``craftsim.perform`` and of all commands, without a simulator: for another one, or for a robot
    that is measured. What is not given counts as ideal.

    Args:
        before: poses of everything at the action's start, at rest.
        after: the same at its end.
        car: number of the car that acted.
        action: what it did, or its name. What the rules forbid has failed, unless ``predicted`` says what
            should follow.
        size: length, width and height of the area in cells.
        walls: cells (n, 3) of fixed obstacles.
        rules: the rule set that predicts.
        predicted: the grid that should follow, instead of what the rules predict.
        machines: parameters of the machines.
        contacts: machines that touched during the action and did not before, each with the largest force in newtons:
            ``("car 0", "block 1", 12.0)``. Names are those of :meth:`Poses.name`, ``wall`` and ``ground``.
        duration_s: simulated or real time of the action; 0 is held against no limit.
        tries: number of tries.
        boards_m: (cars,) heights of the boards above their lower stops, of which that of ``car`` counts; nan where it
            is not known.
        way_m: largest distance of the car from the line between the middles of its cells.
        way_lean_rad: largest lean of the car beyond that of the ground.

    Raises:
        InputError: there is no such car, action or thing, an array has a wrong shape, the poses are of different
            things, or a number is not finite or is below 0.

    Example:
        >>> import craftsim
        >>> from craftsim.testing import judge_poses
        >>> physics = craftsim.PhysicsWorld(craftsim.Grid.empty((3, 1, 1), n_cars=1))
        >>> before = physics.poses()
        >>> _ = craftsim.perform(physics, 0, "MOVE_RIGHT")
        >>> judge_poses(before, physics.poses(), 0, "MOVE_RIGHT", size=(3, 1, 1)).result
        'as predicted'
        >>> judge_poses(before, before, 0, "MOVE_RIGHT", size=(3, 1, 1)).reason
        'car 0: predicted 1,0,1 +x, read 0,0,1 +x'
    """
    before = _checked_poses(before, "before")
    after = _checked_poses(after, "after")
    n_cars = len(before.car_positions)
    if len(after.car_positions) != n_cars or after.kinds != before.kinds:
        raise InputError("the poses after an action must be of the same cars and objects as before")
    if not isinstance(car, int | np.integer) or not 0 <= car < n_cars:
        raise InputError(f"there is no car {car!r}: there are {n_cars}, counted from 0")
    car = int(car)
    if not isinstance(action, Action):
        check_choice("action", action, Action.__members__)
        action = Action[action]
    if not isinstance(machines, Machines):
        raise InputError(f"machines are {machines!r}; allowed: craftsim.Machines")
    machines.check_number(n_cars)
    length, width, height = _whole_numbers(size, (3,), "size").tolist()
    size = length, width, height
    walls = _checked_walls(walls, size)
    names = [f"car {number}" for number in range(n_cars)]
    names += [before.name(index) for index in range(len(before.kinds))]
    touching = _checked_contacts(contacts, names)
    _check_number("duration_s", duration_s)
    _check_number("way_m", way_m)
    _check_number("way_lean_rad", way_lean_rad)
    if not isinstance(tries, int | np.integer) or tries < 1:
        raise InputError(f"tries is {tries!r}; allowed: a whole number from 1 on")
    if boards_m is None:
        boards_m = np.full(n_cars, math.nan)
    boards_m = _floats(boards_m, (n_cars,), "boards_m")
    if np.isinf(boards_m).any():
        raise InputError(f"boards_m are {boards_m}; allowed: finite numbers, and nan for unknown")
    start = read_grid(before, size, walls)
    for number, fit in enumerate(start.cars):
        if (walls == fit.cell).all(axis=1).any():
            raise InputError(f"car {number} and a wall are in the cell {fit.cell}; allowed: one")
    end = read_grid(after, size, walls)
    rule_set = Rules(rules)
    legal = rule_set.legal(start.grid, car, action)
    is_performed = legal or predicted is not None
    if predicted is None:
        predicted = rule_set.apply(start.grid, car, action)
    elif not isinstance(predicted, Grid) or (predicted.size, predicted.n_cars) != (size, n_cars):
        raise InputError(
            f"the predicted world is none of {n_cars} cars in {size} cells; allowed: a craftsim.Grid of these"
        )
    step = ScheduledAction(
        0, car, action, start.grid, predicted, footprint(start.grid, predicted, car, action)
    )
    rows = [n_cars + index for index in handled(start, predicted, car)]
    acting = (names[car], *(names[row] for row in rows))
    concerned = [
        contact for contact in touching if contact.first in acting or contact.second in acting
    ]
    outcome = None
    if is_performed:
        outcome = Outcome(None, float(duration_s), tries=int(tries))
    watched = Watched(
        step,
        legal,
        start_s=0.0,
        capped_before=0,
        poses=pose_rows(before),
        reading=start,
        handled=rows,
        names=acting,
        below=[n_cars + index for index in under(start, predicted, car)],
        cars={car},
        movable=set(rows),
        outcome=outcome,
        differences=tuple(own_differences(start.grid, predicted, end.grid, car)),
        read=describe_car(end.grid, car),
        readable=not end.problems,
        contacts=unexpected_contacts(concerned, names[n_cars:], start, end, predicted, {car}),
    )
    limits = thresholds_of(machines)
    ending = Ending(
        action=watched,
        machines=machines,
        poses=after,
        rows=pose_rows(after),
        boards_m=boards_m,
        reading=end,
        furthest=distances(before, after),
        way_m=float(way_m),
        way_lean_rad=float(way_lean_rad),
        reported=~(start.bounded <= (limits.place_m, limits.turn_rad)),
        excused={car, *rows},
        peak_force_n=max((contact.peak_n for contact in touching), default=0.0),
    )
    watched.measured, watched.bystanders = sample_all(ending, names)
    hazards: list[Hazard] = []
    for contact in touching:
        if contact.peak_n > limits.impact_n:
            pair = contact.first, contact.second
            force = f"({contact.peak_n:.0f} N, allowed {limits.impact_n:.0f})"
            hazards.append((pair, f"{pair[0]} and {pair[1]} hit each other {force}"))
    for name, row in zip(names, ending.rows, strict=True):
        tilt = math.acos(max(-1.0, min(1.0, 1 - 2 * float(row[4] ** 2 + row[5] ** 2))))
        if tilt > TIPPED_RAD:
            hazards.append(((name,), f"{name} tipped ({tilt:.2f} rad, allowed {TIPPED_RAD:.2f})"))
    watched.hazards = tuple(hazards)
    cause = compare_reading(start.grid, predicted, end)
    if hazards:
        cause = Cause("unsafe", tuple(text for _, text in hazards))
    elif not is_performed:
        explanation = rule_set.explain(start.grid, car, action)
        cause = Cause("not executed", (f"the rules forbid it: {explanation.why}",))
    return attempt_of(watched, cause, limits)


def _checked_poses(poses: Poses, when: str) -> Poses:
    """Return poses of arrays, with quaternions of length 1. Raises InputError for what are none."""
    if not isinstance(poses, Poses):
        raise InputError(
            f"the poses {when} are a {type(poses).__name__}; allowed: craftsim.testing.Poses"
        )
    kinds = tuple(poses.kinds)
    if any(kind not in CARRIED for kind in kinds):
        allowed = ", ".join(kind.name for kind in CARRIED)
        raise InputError(f"the kinds {when} are {kinds}; allowed: {allowed}")
    try:
        n_cars = len(poses.car_positions)
    except TypeError:
        n_cars = 0
    n_things = len(kinds)
    shapes = {
        "car_positions": (n_cars, 3),
        "car_quaternions": (n_cars, 4),
        "positions": (n_things, 3),
        "quaternions": (n_things, 4),
        "hinges": (n_things,),
    }
    arrays: dict[str, Any] = {}
    for name, shape in shapes.items():
        arrays[name] = _floats(getattr(poses, name), shape, f"{name} {when}")
        if name != "hinges" and not np.isfinite(arrays[name]).all():
            raise InputError(f"{name} {when} are {arrays[name].tolist()}; allowed: finite numbers")
    for name in ("car_quaternions", "quaternions"):
        lengths = np.linalg.norm(arrays[name], axis=1, keepdims=True)
        if not lengths.all():
            raise InputError(f"{name} {when} has one of zeros; allowed: any other length")
        arrays[name] = arrays[name] / lengths
    return replace(poses, kinds=kinds, **arrays)


def _checked_walls(walls: ArrayLike, size: Cell) -> NDArray[np.integer]:
    """Return the cells of walls, (n, 3). Raises InputError for what is outside the area."""
    if np.size(walls) == 0:
        return np.zeros((0, 3), np.int64)
    cells = _whole_numbers(walls, (None, 3), "walls")
    length, width, height = size
    if (cells < (0, 0, 1)).any() or (cells >= (length, width, height + 1)).any():
        raise InputError(
            f"a wall is outside the area: {cells.tolist()}; allowed: x from 0 to {length - 1}, "
            f"y from 0 to {width - 1}, level 1 to {height}"
        )
    return cells


def _checked_contacts(
    contacts: Iterable[tuple[str, str, float]], names: Collection[str]
) -> list[Contact]:
    """Return the contacts of these cars and things. Raises InputError for others, and for impossible forces."""
    if not isinstance(contacts, Iterable):
        raise InputError(f"contacts are {contacts!r}; allowed: tuples (name, other name, newtons)")
    known = (*names, WALL, GROUND)
    checked = []
    for contact in contacts:
        if not isinstance(contact, Sequence) or len(contact) != 3:
            raise InputError(
                f"a contact is {contact!r}; allowed: a tuple (name, other name, newtons)"
            )
        first, second, force_n = contact
        check_choice("machine", first, known)
        check_choice("machine", second, known)
        if first == second:
            raise InputError(f"a contact of {first} with itself; allowed: two machines")
        _check_number(f"the force between {first} and {second}", force_n)
        checked.append(Contact(first, second, 0.0, float(force_n), False))
    return checked


def _check_number(name: str, value: Any) -> None:
    """Raise InputError for anything but a finite number from 0 on."""
    is_number = isinstance(value, int | float | np.integer | np.floating)
    if not is_number or not 0 <= value < math.inf:  # nan is not
        raise InputError(f"{name} is {value!r}; allowed: a finite number from 0 on")


def _floats(values: ArrayLike, shape: tuple[int, ...], name: str) -> Floats:
    """Return an array of this shape. Raises InputError for another one, and for what are no numbers."""
    try:
        array = np.asarray(values, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} are {values!r}; allowed: numbers in the shape {shape}") from error
    if array.size == 0 and 0 in shape:
        return array.reshape(shape)
    if array.shape != shape:
        raise InputError(f"{name} have the shape {array.shape}; allowed: {shape}")
    return array


def _whole_numbers(
    values: ArrayLike, shape: tuple[int | None, ...], name: str
) -> NDArray[np.integer]:
    """Return an array of this shape, of which None is any length. Raises InputError for anything else."""
    words = str(shape).replace("None", "n")
    refusal = InputError(f"{name} is {values!r}; allowed: whole numbers in the shape {words}")
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise refusal from error
    if array.dtype.kind not in "iu" or len(array.shape) != len(shape):
        raise refusal
    for length, allowed in zip(array.shape, shape, strict=True):
        if allowed not in (None, length):
            raise refusal
    return array
