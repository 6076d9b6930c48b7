"""Worlds, tasks and actions in words, for those who read and do not look."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import compress
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.drawing import LEGEND, world_text
from craftsim.discrete.grid import SECOND_PART, CarField, Cell, Grid, Kind, Piece, beside
from craftsim.discrete.kinds import NAMES, Action
from craftsim.discrete.readback import HEADINGS
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks import Task
from craftsim.envs.answers import FORM, MARK, words_of

_SECOND: Final = tuple(SECOND_PART.values())

INSTRUCTIONS: Final = f"""\
You steer {{n_cars}} cars that build together in an area of {{length}} x {{width}} cells, {{height}} levels high.
A cell is (x, y, z): in the drawings x goes to the right and y up; z = 1 is the floor. Signs of the drawings:
{LEGEND}

Goal: {{goal}}

In each tick every car does one action; there are {{ticks}} ticks. The cars act one after the other, in an order that is
drawn anew for each tick. What the rules forbid when a car's turn comes is not done. The actions:
  lift: take up the block, flag or folded slope in the car's own cell, which the car is under
  drop: put the load down into the car's own cell
  unfold, fold: turn the slope in the car's own cell into a ramp, or back; its foot comes to lie in the next cell
  rotate left, rotate right: turn by 90 degrees on the spot, counterclockwise or clockwise
  move right (+x), move forward (+y), move left (-x), move back (-y): to the next cell, whatever the car's heading
  stop: do nothing
A car without a load can be in one cell with a block, a flag or a slope, below it; a car with a load cannot. A car
enters and leaves a block or a flag along its heading only. A ramp leads from its foot up over its body to the
level above it; cars drive up and down on it, with or without a load, facing the way they move, and do nothing else
there. Blocks bear cars, blocks and slopes.

Answer with one line such as: {FORM}
A car that you do not name stops. What stands before the last "{MARK}" is not read."""


def instructions(task: Task) -> str:
    """Return what one who steers the cars must know, the goal included."""
    length, width, height = task.starts[0].size
    return INSTRUCTIONS.format(
        n_cars=task.layout.n_cars,
        length=length,
        width=width,
        height=height,
        goal=goal_text(task),
        ticks=ticks_of(task),
    )


def ticks_of(task: Task) -> int:
    """Return how many ticks an episode has at most (docs/rules.md#episode-length)."""
    return task.max_steps + 2


def goal_text(task: Task) -> str:
    """Return what is to be reached, in words, each part of a design with its cell."""
    if task.design is not None:
        parts = "\n".join(f"  {_target(target)}" for target in task.design.targets)
        return f"these cells hold this, put down and not carried:\n{parts}"
    if task.layout.goal is not None:
        return f"the flag is at {task.layout.goal}."
    if task.success == "one_platform":
        return "all blocks are side by side on one level, and so form one platform."
    if task.success == "three_high":
        return "three blocks stand on one another, the lowest on the floor; ramps on blocks are rewarded, too."
    return f"what the task '{task.name}' rewards."


def world_words(grid: Grid, task: Task) -> str:
    """Return a world as a drawing and as a list of things, and how much of the design stands."""
    goal = task.layout.goal if task.design is None else None
    drawing = "\n".join(line.rstrip() for line in world_text(grid, goal).plain.splitlines())
    lines = [drawing, "Things:", *(f"  {line}" for line in _things(grid))]
    if task.design is not None:
        hits = list(task.design.hits(grid))
        lines.append(f"Design: {sum(hit for _, hit in hits)} of {len(hits)} cells as they should be")
        lines += [f"  missing: {_target(target)}" for target, hit in hits if not hit]
    return "\n".join(lines)


def _target(target: Piece) -> str:
    slope = target.kind in (Kind.BODY, Kind.FOOT)
    return f"{NAMES[target.kind]} at {target.cell}" + (f", downhill {HEADINGS[target.yaw]}" if slope else "")


def _things(grid: Grid) -> Iterator[str]:
    for car in range(grid.n_cars):
        yield f"car_{car} {_car(grid, car)}"
    for x, y, z in np.argwhere(grid.kind[:, :, 1:] != Kind.AIR).tolist():
        cell = x, y, z + 1
        kind, yaw = grid.kind_at(cell), int(grid.yaw[cell])
        if kind in _SECOND:
            continue
        words = f"{NAMES[kind]} at {cell}"
        if kind == Kind.BODY:
            words = f"a ramp: body at {cell}, foot at {beside(cell, yaw)}, downhill {HEADINGS[yaw]}"
        elif kind == Kind.FSLOPE:
            words += f", its gear at {beside(cell, yaw)}; unfolded there it leads downhill {HEADINGS[yaw]}"
        yield words


def _car(grid: Grid, car: int) -> str:
    row = grid.cars[car].tolist()
    words = f"at {_cell(grid, car)}, facing {HEADINGS[row[CarField.YAW]]}"
    load = Kind(row[CarField.LOAD])
    if load != Kind.AIR:
        words += f", with {NAMES[load]}"
        words += f" (gear {HEADINGS[row[CarField.LOAD_YAW]]})" if load == Kind.FSLOPE else ""
    return words + (", on a ramp" if row[CarField.SLOPE] else "")


def _cell(grid: Grid, car: int) -> Cell:
    x, y, z = grid.cars[car, : CarField.YAW].tolist()
    return x, y, z


def legal_words(grid: Grid, masks: NDArray[np.int8], rules: Rules) -> str:
    """Return what each car may do now, with where that leads, a line a car; ``masks`` (n, 15) as they are offered."""
    return "\n".join(
        f"  car_{car}: "
        + "; ".join(words_of(a) + _effect(grid, rules, car, a) for a in compress(rules.actions, mask))
        for car, mask in enumerate(masks)
    )


def _effect(grid: Grid, rules: Rules, car: int, action: Action) -> str:
    """Return what an action leads to, in brackets; nothing where that goes without saying."""
    after = rules.apply(grid, car, action)
    old, new = grid.cars[car].tolist(), after.cars[car].tolist()
    if action in (Action.LIFT, Action.DROP):
        load = Kind(max(old[CarField.LOAD], new[CarField.LOAD]))
        return f" ({NAMES[load]})"
    if _cell(grid, car) != _cell(after, car):
        return f" (to {_cell(after, car)})"
    if old[CarField.YAW] != new[CarField.YAW]:
        return f" (to face {HEADINGS[new[CarField.YAW]]})"
    if action == Action.UNFOLD:
        cell = _cell(grid, car)
        return f" (the foot to {beside(cell, int(grid.yaw[cell]))})"
    return ""
