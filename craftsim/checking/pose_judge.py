"""The judge as a library: the verdict on one action of any robot or simulator, from poses before and after it."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import Attempt, Cause, attempt_of, compare_reading
from craftsim.checking.contacts import (
    TIPPED_RAD,
    Contact,
    Hazard,
    apart,
    handled,
    under,
    unexpected_contacts,
)
from craftsim.checking.measurements import Ending, sample_all
from craftsim.checking.thresholds import thresholds_of
from craftsim.checking.watched import Watched
from craftsim.compiled.arrays import Floats
from craftsim.compiled.jit import plain
from craftsim.discrete.actions import footprint
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.kinds import Action
from craftsim.discrete.readback import Poses, describe_car, own_differences, read_grid
from craftsim.discrete.rules import Rules, RuleSet
from craftsim.discrete.schedule import ScheduledAction
from craftsim.errors import InputError
from craftsim.mjcf.machines import NOMINAL, Machines
from craftsim.skills.outcome import Outcome

_apart = plain(apart)


def judge_poses(
    before: Poses,
    after: Poses,
    car: int,
    action: Action | str,
    *,
    size: Cell,
    walls: NDArray[np.integer] | None = None,
    rules: RuleSet = "physical",
    predicted: Grid | None = None,
    machines: Machines = NOMINAL,
    contacts: Iterable[tuple[str, str, float]] = (),
    duration_s: float = 0.0,
    tries: int = 1,
    boards_m: Floats | None = None,
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
        action: what it did, or its name.
        size: length, width and height of the area in cells.
        walls: cells (n, 3) of fixed obstacles.
        rules: the rule set that predicts.
        predicted: the grid that should follow, instead of what the rules predict.
        machines: parameters of the machines.
        contacts: machines that touched during the action and did not before, each with the largest force in newtons:
            ``("car 0", "block 1", 12.0)``. Names are those of :meth:`Poses.name`, ``wall`` and ``ground``.
        duration_s: simulated or real time of the action; 0 is held against no limit.
        tries: number of tries.
        boards_m: (cars,) heights of the boards above their lower stops.
        way_m: largest distance of the car beside the line through the middles of its cells.
        way_lean_rad: largest lean of the car beyond that of the ground.

    Raises:
        InputError: there is no such car or action, the poses are of different things, or a number is not finite.

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
    n_cars = len(before.car_positions)
    if len(after.car_positions) != n_cars or after.kinds != before.kinds:
        raise InputError("the poses after an action must be of the same cars and objects as before")
    if not 0 <= car < n_cars:
        raise InputError(f"there is no car {car}: there are {n_cars}, counted from 0")
    if isinstance(action, str):
        if action not in Action.__members__:
            raise InputError(
                f"unknown action '{action}'; there are {', '.join(Action.__members__)}"
            )
        action = Action[action]
    if walls is None:
        walls = np.zeros((0, 3), np.int64)
    start = read_grid(before, size, walls)
    end = read_grid(after, size, walls)
    rule_set = Rules(rules)
    legal = rule_set.legal(start.grid, car, action)
    if predicted is None:
        predicted = rule_set.apply(start.grid, car, action)
    step = ScheduledAction(
        0, car, action, start.grid, predicted, footprint(start.grid, predicted, car, action)
    )
    names = [f"car {number}" for number in range(n_cars)]
    names += [before.name(index) for index in range(len(before.kinds))]
    rows = [n_cars + index for index in handled(start, predicted, car)]
    acting = (names[car], *(names[row] for row in rows))
    found = [Contact(first, second, 0.0, force_n, False) for first, second, force_n in contacts]
    concerned = [
        contact for contact in found if contact.first in acting or contact.second in acting
    ]
    watched = Watched(
        step,
        legal,
        start_s=0.0,
        capped_before=0,
        poses=_rows_of(before),
        reading=start,
        handled=rows,
        names=acting,
        below=[n_cars + index for index in under(start, predicted, car)],
        cars={car},
        movable=set(rows),
        outcome=Outcome(None, duration_s, tries=tries),
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
        rows=_rows_of(after),
        boards_m=np.full(n_cars, math.nan) if boards_m is None else boards_m,
        reading=end,
        furthest=_moved(before, after),
        way_m=way_m,
        way_lean_rad=way_lean_rad,
        reported=~(start.bounded <= (limits.place_m, limits.turn_rad)),
        peak_force_n=max((contact.peak_n for contact in found), default=0.0),
    )
    watched.measured, watched.bystanders = sample_all(ending, {car, *rows}, names)
    hazards: list[Hazard] = []
    for contact in found:
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
    return attempt_of(watched, cause, limits)


def _rows_of(poses: Poses) -> Floats:
    """Return the poses of cars and objects, (n, 7)."""
    cars = np.hstack([poses.car_positions, poses.car_quaternions])
    objects = np.hstack([poses.positions, poses.quaternions])
    return np.vstack([cars.reshape(-1, 7), objects.reshape(-1, 7)])


def _moved(before: Poses, after: Poses) -> Floats:
    """Return how far everything was moved and turned, (n, 2); a hinge counts as a turn."""
    start_rows = _rows_of(before)
    end_rows = _rows_of(after)
    moved = np.array(
        [
            _apart(first.tolist(), second.tolist())
            for first, second in zip(end_rows, start_rows, strict=True)
        ]
    ).reshape(-1, 2)
    n_cars = len(before.car_positions)
    turned = np.abs(after.hinges - before.hinges)
    moved[n_cars:, 1] = np.fmax(moved[n_cars:, 1], turned)  # nan without a hinge
    return moved
