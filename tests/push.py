"""A registered action with a skill of its own: an unloaded car pushes the block in front of it one cell on.

With its board raised a car meets the edge of a block's table, shoves the block on, and backs off into its old cell.
"""

import math
from functools import partial

import craftsim
from craftsim import Kind
from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.grid import beside
from craftsim.discrete.readback import nearest_yaw
from craftsim.skills.skill import LawSkill, begin_board, begin_path, cell_middle

BOARD_M = 0.030
"""How far the board is raised: its plate is 14 mm above a block's underside, its boss far below the top."""


def _cells(grid, car):
    """Return the cell of the block, and the one after it."""
    x, y, z, yaw = grid.cars[car, :4].tolist()
    block = beside((x, y, z), yaw)
    return block, beside(block, yaw)


def why_not(grid, car):
    """Return why a car cannot push now."""
    x, y, z, _, load, _, slope = grid.cars[car].tolist()
    block, beyond = _cells(grid, car)
    if slope or load or z != 1 or grid.kind_at((x, y, z)) != Kind.AIR:
        return "a car pushes from a free cell of the floor, and without a load"
    if nothing := nothing_to_push(grid, car):
        return nothing
    if grid.occupant[block] != -1:
        return f"something stands on {block}"
    near = [
        row for row in grid.cars.tolist() if abs(row[0] - beyond[0]) + abs(row[1] - beyond[1]) <= 2
    ]
    busy = any(tuple(row[:3]) in (block, beyond) or row[4] for row in near)
    return "a car, or its load, is in the way" if busy else None


def nothing_to_push(grid, car):
    """Return why no push is worth a try."""
    block, beyond = _cells(grid, car)
    if (
        grid.cars[car, 4]
        or grid.cars[car, 6]
        or not grid.inside(block)
        or grid.kind_at(block) != Kind.BLOCK
    ):
        return "there is nothing to push"
    return (
        ""
        if grid.inside(beyond) and grid.kind_at(beyond) == Kind.AIR
        else "there is no room to push"
    )


def push(grid, car):
    """Move the block on, and the car into its cell."""
    block, beyond = _cells(grid, car)
    grid.put(grid.take(block)._replace(cell=beyond))
    grid.cars[car, :3] = block


def ahead(setup, now, task, ahead_m):
    """Drive straight on, or back, to a place so far past the middle of the cell on the line through it."""
    x, y, heading = cell_middle(now, nearest_yaw(now.heading)[0])
    target = x + ahead_m * math.cos(heading), y + ahead_m * math.sin(heading), heading
    # So slowly that the block does not slide on when the car brakes: its feet would brake it with 0.8 g.
    begin_path(setup, now, task, target, (0.3, 1.0))


class Push(craftsim.Skill):
    """Four laws one after the other."""

    def __init__(self, setup):
        """Prepare for this car, world and tuning."""
        super().__init__(setup)
        gap_m = CELL_PITCH_M - setup.machines.block.side_m / 2 - setup.machine.board_length_m / 2
        begins = (
            partial(begin_board, target_m=BOARD_M),
            partial(ahead, ahead_m=CELL_PITCH_M + gap_m),
            partial(ahead, ahead_m=0.0),
            partial(begin_board, target_m=0.0),
        )
        self._parts = [LawSkill(setup, begin) for begin in begins]

    def start(self, now):
        """Start the first of them."""
        self._parts[0].start(now)

    def step(self, now):
        """Step the present one, and start the next when it has ended."""
        command, ended = self._parts[0].step(now), self._parts[0].outcome
        if ended is None:
            return command
        if ended.reason is not None:
            self.fail(ended.reason, ended.detail)
        elif len(self._parts) == 1:
            self.succeed()
        else:
            del self._parts[0]
            self._parts[0].start(now)
        return craftsim.Command()


PUSH = craftsim.register_action(
    "PUSH",
    why_not,
    push,
    duration_s=4.1,
    footprint=lambda before, after, car: _cells(before, car),
    skill=Push,
    ahead=(0,),
    over=True,
    beyond=0,
    nothing_to_try=nothing_to_push,
)
