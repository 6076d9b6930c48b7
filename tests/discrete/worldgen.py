"""Random sane worlds and the ways to mirror and turn them, for tests of properties."""

import numpy as np

from craftsim.discrete.files.blueprint import parse_blueprint
from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import KINDS_WITH_YAW, CarField, Grid, Kind
from craftsim.discrete.kernel.claims import CHANGES, LOADS, RELIES, SPACE
from craftsim.discrete.kinds import Action

MOVE_BY_DIRECTION = (Action.MOVE_RIGHT, Action.MOVE_FORWARD, Action.MOVE_LEFT, Action.MOVE_BACK)


def by_cell(claims):
    """Return the claims of an action as a dictionary, bits by cell."""
    found = {}
    for *cell, bits in claims.tolist():
        found[*cell,] = found.get((*cell,), 0) | bits
    return found


def conflict(one, other):
    """Return whether two actions with these footprints must not run at the same time, cell by cell."""
    one, other = by_cell(one), by_cell(other)

    def against(mine, theirs):
        changes = mine & CHANGES and theirs & (CHANGES | RELIES)
        return mine & theirs & (SPACE | LOADS) or changes or (mine & RELIES and theirs & CHANGES)

    return any(against(bits, other.get(cell, 0)) for cell, bits in one.items()) or any(
        bits & LOADS and other.get((x + dx, y + dy, z), 0) & LOADS
        for (x, y, z), bits in one.items()
        for dx, dy in DIRECTIONS.tolist()
    )


def random_world(rng):
    """Return a world of random size with random blocks, slopes, cars and sometimes a flag, all placed by chance."""
    length, width, height = (int(rng.integers(low, high)) for low, high in ((3, 7), (3, 7), (1, 4)))
    flag = (
        f"flag: [{{id: 0, x: {rng.integers(length)}, y: {rng.integers(width)}, z: 1}}]"
        if rng.random() < 0.5
        else ""
    )
    text = f"""
area_length: {length}
area_width: {width}
area_height: {height}
block_num: {rng.integers(0, 4)}
slope_num: {rng.integers(0, 2) if min(length, width) > 3 else 0}
smartcar_num: {rng.integers(1, 4)}
{flag}
"""
    return parse_blueprint(text, "random").grid(rng)


def play(rules, grid, rng, ticks, eager=True):
    """Yield (joint, world after) of random play; eager cars prefer what is legal, and work on objects."""
    for _ in range(ticks):
        mask = rules.mask(grid)
        joint = []
        for car in rng.permutation(grid.n_cars):
            choices = np.flatnonzero(mask[car]) if eager and mask[car].any() else np.arange(15)
            work = [action for action in choices if action in (0, 1, 2, 3)]
            pick = rng.choice(work) if work and rng.random() < 0.4 else rng.choice(choices)
            joint.append((int(car), Action(pick)))
        grid, _ = rules.tick(grid, joint)
        yield joint, grid


def mirrored(grid):
    """Return the world with y reversed."""
    other = Grid(np.ascontiguousarray(grid.cells[:, ::-1]), grid.cars.copy())
    _turn_yaws(other, lambda yaw: -yaw % 4)
    other.cars[:, CarField.Y] = grid.size[1] - 1 - grid.cars[:, CarField.Y]
    return other


def turned(grid):
    """Return the world turned by a quarter to the left: +x becomes +y."""
    other = Grid(np.ascontiguousarray(np.rot90(grid.cells, axes=(0, 1))), grid.cars.copy())
    _turn_yaws(other, lambda yaw: (yaw + 1) % 4)
    other.cars[:, CarField.X] = grid.size[1] - 1 - grid.cars[:, CarField.Y]
    other.cars[:, CarField.Y] = grid.cars[:, CarField.X]
    return other


def _turn_yaws(grid, change):
    slopes = np.isin(grid.kind, KINDS_WITH_YAW)
    grid.yaw[slopes] = change(grid.yaw[slopes])
    grid.cars[:, CarField.YAW] = change(grid.cars[:, CarField.YAW])
    carried = grid.cars[:, CarField.LOAD] == Kind.FSLOPE
    grid.cars[carried, CarField.LOAD_YAW] = change(grid.cars[carried, CarField.LOAD_YAW])


def renamed_actions(change_direction, flips_turns):
    """Return for each action the one it becomes when directions change so."""
    names = np.arange(15)
    for direction, move in enumerate(MOVE_BY_DIRECTION):
        names[move] = MOVE_BY_DIRECTION[change_direction(direction)]
    if flips_turns:
        names[[Action.ROTATE_LEFT, Action.ROTATE_RIGHT]] = Action.ROTATE_RIGHT, Action.ROTATE_LEFT
    return names


MIRRORED_ACTIONS = renamed_actions(lambda direction: -direction % 4, True)
TURNED_ACTIONS = renamed_actions(lambda direction: (direction + 1) % 4, False)
