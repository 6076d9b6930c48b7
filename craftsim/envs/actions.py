"""The action form: the actions that are offered as columns of masks, what they stand for, and which were forbidden.

With object choices a car drives to a block, a slope or a free cell near it by the action helper's plan. This is the
local mode of CraftEnv (Zhao et al., AAMAS 2023), whose order of action ids is another one: continue, blocks, slopes,
free cells, and the 15 primitive actions last.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from craftsim.compiled.jit import compiled
from craftsim.discrete.grid import Kind
from craftsim.discrete.kernel.batch import Cars, Cells
from craftsim.discrete.kernel.codes import LAST_MOVE, ROTATE_LEFT
from craftsim.discrete.kernel.rules import legal_actions
from craftsim.discrete.kernel.search import (
    SUCCESSORS,
    UNKNOWN,
    UNSEEN,
    SearchBuffers,
    node_of,
    search_buffers,
    search_path,
    state_at,
    write_path,
)
from craftsim.discrete.kernel.state import (
    AIR,
    BLOCK,
    BODY,
    FSLOPE,
    CarState,
    Patterns,
    World,
    after,
    kind_at,
    state_of_car,
)
from craftsim.discrete.kinds import Action
from craftsim.errors import InputError
from craftsim.storage.limits import Range
from craftsim.storage.records import record
from craftsim.tasks import Task
from craftsim.tasks.episodes import Episodes
from craftsim.tasks.kernel import IS_BLOCK, IS_BODY, IS_FSLOPE, ROW, YAW_HIGH, YAW_LOW

_FLAGS: Final = {Kind.BLOCK: IS_BLOCK, Kind.FSLOPE: IS_FSLOPE, Kind.BODY: IS_BODY}
_Count = Annotated[int, Range(0, 10_000)]
Masks = NDArray[np.int8]
"""(B, n, n_actions): 1 for each action that a car is offered."""


def by_agent(actions: Mapping[str, Any], agents: Sequence[str]) -> list[Any]:
    """Return the actions of agents in their order; raise InputError where one has none."""
    missing = [agent for agent in agents if agent not in actions]
    if missing:
        raise InputError(
            f"no action for {', '.join(missing)}; actions must be a dictionary with one for each agent"
        )
    return [actions[agent] for agent in agents]


def checked_actions(
    actions: Any, shape: tuple[int, ...], n_actions: int = len(Action)
) -> NDArray[np.int64]:
    """Return actions as integers of this shape, whose last dimension is the cars.

    Raises InputError for another shape, and for anything but whole numbers from 0 to ``n_actions`` - 1.
    """
    try:
        chosen = np.asarray(actions)
    except ValueError as error:  # rows of different lengths
        raise InputError(f"actions must have shape {shape}, not {actions}") from error
    if chosen.shape != shape:
        raise InputError(f"actions must have shape {shape}, not {chosen.shape}")
    if chosen.dtype.kind not in "iu" or (chosen < 0).any() or (chosen >= n_actions).any():
        raise InputError(f"actions must be whole numbers from 0 to {n_actions - 1}, not {actions}")
    return chosen.astype(np.int64)


class ActionForm:
    """The 15 primitive actions, and after them registered ones, for a batch of worlds."""

    def __init__(self, registered: Sequence[Action] = ()) -> None:
        """Offer the registered actions ``registered`` in this order."""
        self.own = tuple(registered)
        self.n_actions = len(Action) + len(self.own)
        # The number of the action of each column, unless it is the same.
        if not self.own:
            self._numbers = None
        else:
            self._numbers = np.array([*Action, *self.own], np.int64)

    def masks(self, episodes: Episodes) -> Masks:
        """Return the offered actions; STOP, which does nothing, where the rules leave a car nothing."""
        return episodes.offered().view(np.int8)

    def begin(
        self, episodes: Episodes, chosen: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_] | None]:
        """Return the numbers of chosen actions (B, n), and which cars go on with the queue of the action helper.

        The latter is None without the helper. Whatever such a car is asked for is not done: it counts as STOP.
        """
        queued = None
        if episodes.depth is not None:
            queued = episodes.queue[:, :, 0] >= 0
        if self._numbers is None:
            return chosen, queued
        numbers = self._numbers[chosen]
        return (numbers if queued is None else np.where(queued, int(Action.STOP), numbers)), queued

    def spaces(self) -> dict[str, spaces.Space[Any]]:
        """Return the spaces of what a car observes, by key, to choose its actions by."""
        return {}

    def observed(self, episodes: Episodes) -> dict[str, NDArray[Any]]:
        """Return what cars observe to choose their actions by, each (B, n, ...), after :meth:`masks`."""
        return {}


def illegal(
    chosen: NDArray[np.int64],
    applied: NDArray[np.bool_],
    offered: Masks,
    queued: NDArray[np.bool_] | None,
) -> NDArray[np.bool_]:
    """Return (B, n): which cars had a forbidden action chosen, and therefore did nothing.

    ``chosen`` (B, n) are columns of the masks ``offered`` before the tick, ``applied`` says whether the rules allowed
    each when its turn came, and ``queued`` which cars went on with the queue of the helper, None without it.
    """
    forbidden = ~applied
    if queued is not None:
        # A helper that finds no way makes a STOP of a move, which is legal but not what was asked for.
        unoffered = np.take_along_axis(offered, chosen[..., None], -1)[..., 0] == 0
        forbidden |= unoffered & ~queued
    wrong: NDArray[np.bool_] = forbidden & (chosen != int(Action.STOP))
    return wrong


@record()
class ObjectChoice:
    """How many objects a car may choose from, and how far away they may be. Raises InputError for a bad value."""

    blocks: _Count | None = None  # as many as the task has unless given
    slopes: _Count | None = None  # folded or unfolded; as many as the task has unless given
    free: _Count = 20  # cells without an object
    radius: Annotated[int, Range(1, 256)] = 3  # cells along x and y; CraftEnv's view of 7 x 7 cells
    floor: bool = (
        False  # whether free cells of the floor are offered, too; in CraftEnv those above it alone
    )


class ChoiceForm(ActionForm):
    """The primitive and registered actions, then "continue", then a column for each block, slope and free cell.

    Offered are objects that the car could reach without its load within the radius, in the order of their cells, and of
    these the ones to which the action helper has a plan now that no running action stands against. A choice puts the
    plan, made in the world that was observed, into the helper's queue. While something is queued, "continue" alone is
    offered.
    """

    def __init__(self, registered: Sequence[Action], choice: ObjectChoice, task: Task) -> None:
        super().__init__(registered)
        layout = task.layout
        blocks = layout.n_blocks if choice.blocks is None else choice.blocks
        slopes = layout.n_slopes if choice.slopes is None else choice.slopes
        self.choice = choice
        self.counts = np.array([blocks, slopes, choice.free], np.int64)  # columns of each
        self.go_on = self.n_actions  # the column "continue"
        n_columns = 1 + int(self.counts.sum())
        self.n_actions += n_columns
        self._size = task.starts[0].size
        self._space = search_buffers(self._size)
        self._numbers = np.array([*Action, *self.own, *[Action.STOP] * n_columns], np.int64)
        self._cells: NDArray[np.int64]  # (B, n, choices, 3): of the choices, 0 where there is none
        self._plans: NDArray[
            np.int8
        ]  # (B, n, choices, depth + 1): of the helper to each, -1 where it has none

    def masks(self, episodes: Episodes) -> Masks:
        """Return the offered actions, and find the choices of each car."""
        queued = episodes.queue[:, :, 0] >= 0
        shape = (*queued.shape, int(self.counts.sum()))
        assert episodes.depth is not None, "the options demand the action helper"
        self._cells = np.zeros((*shape, 3), np.int64)
        self._plans = np.full((*shape, episodes.depth + 1), -1, np.int8)
        grids = episodes.grids
        choice = self.choice
        world = grids.world(episodes.corrections, episodes.patterns)
        limits = choice.radius, choice.floor, episodes.depth
        _find(*world, self._space, *limits, self.counts, self._cells, self._plans)
        parts = super().masks(episodes), queued[..., None], episodes.begins(self._plans[..., 0])
        masks = np.concatenate(parts, axis=-1, dtype=np.int8)
        masks[queued] = np.arange(self.n_actions) == self.go_on
        return masks

    def begin(
        self, episodes: Episodes, chosen: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_] | None]:
        """Return as :meth:`ActionForm.begin` does; plans to chosen objects are queued."""
        numbers, queued = super().begin(episodes, chosen)
        assert queued is not None
        column = np.maximum(chosen - self.go_on - 1, 0)
        plans = np.take_along_axis(self._plans, column[..., None, None], -2)[..., 0, :]
        newly_chosen = (chosen > self.go_on) & ~queued
        episodes.queue[newly_chosen] = plans[newly_chosen]
        return numbers, queued

    def spaces(self) -> dict[str, spaces.Space[Any]]:
        """Return the space of a car's ``choices``: a row of 13 numbers for each, zeros where there is none."""
        shape = int(self.counts.sum()), ROW
        return {"choices": spaces.Box(0, max(self._size), shape, np.int32)}

    def observed(self, episodes: Episodes) -> dict[str, NDArray[Any]]:
        """Return the rows of the choices that :meth:`masks` found, (B, n, choices, 13); a free cell has no type."""
        x, y, z = np.moveaxis(self._cells, -1, 0)
        worlds = np.arange(len(x))[:, None, None]
        kind = episodes.grids.kind[worlds, x, y, z]
        yaw = episodes.grids.yaw[worlds, x, y, z]
        rows = np.zeros((*x.shape, ROW), np.int32)
        rows[..., :3] = self._cells
        for object_kind, flag in _FLAGS.items():
            rows[..., flag] = kind == object_kind
        turned = (kind == Kind.FSLOPE) | (kind == Kind.BODY)
        rows[..., YAW_HIGH], rows[..., YAW_LOW] = turned * (yaw >> 1), turned * (yaw & 1)
        rows[z == 0] = 0
        return {"choices": rows}


@compiled
def _find(
    cells: Cells,
    cars: Cars,
    corrections: int,
    patterns: Patterns,
    space: SearchBuffers,
    radius: int,
    floor: bool,
    limit: int,
    counts: NDArray[np.int64],
    choices: NDArray[np.int64],
    plans: NDArray[np.int8],
) -> None:
    """Write the cells of each car's choices (B, n, choices, 3), and the helper's plan to each, where it has one."""
    for i in range(cells.shape[0]):
        w = World(cells[i], cars[i], corrections, patterns)
        for me in range(cars.shape[1]):
            _flood(w, me, space, radius)
            _list(w, space, floor, counts, choices[i, me])
            car = state_of_car(w, me)
            space.legal[:] = UNKNOWN
            for k in range(choices.shape[2]):
                x, y, z = choices[i, me, k]
                elsewhere = x != car.x or y != car.y or z != car.z
                node = search_path(w, me, space, x, y, z, limit) if z > 0 and elsewhere else -1
                if node >= 0:
                    write_path(space, node, plans[i, me, k])


@compiled
def _flood(w: World, me: int, space: SearchBuffers, radius: int) -> None:
    """Mark, by ``space.state``, where a car could drive without its load, within a radius."""
    car = state_of_car(w, me)
    start = CarState(car.x, car.y, car.z, car.yaw, AIR, 0, car.slope)
    space.state[:] = UNSEEN
    space.heap[0] = node_of(w, start)
    space.state[space.heap[0]] = 1
    space.slope[space.heap[0]] = start.slope
    head = 0
    tail = 1
    while head < tail:
        node = int(space.heap[head])
        head += 1
        pose = state_at(w, start, node, space.slope[node])
        legal = legal_actions(w, me, pose, ROTATE_LEFT, LAST_MOVE)
        for k in range(len(SUCCESSORS)):
            if not legal & (1 << SUCCESSORS[k]):
                continue
            new = after(w, pose, SUCCESSORS[k])
            next_node = node_of(w, new)
            is_near = abs(new.x - start.x) <= radius and abs(new.y - start.y) <= radius
            if is_near and space.state[next_node] == UNSEEN:
                space.state[next_node] = 1
                space.slope[next_node] = new.slope
                space.heap[tail] = next_node
                tail += 1


@compiled
def _list(
    w: World,
    space: SearchBuffers,
    floor: bool,
    counts: NDArray[np.int64],
    choices: NDArray[np.int64],
) -> None:
    """Write the marked cells with a block, with a slope and without an object, as many of each as there is room for."""
    blocks = 0
    slopes = 0
    free = 0
    for x in range(w.cells.shape[0]):
        for y in range(w.cells.shape[1]):
            for z in range(1, w.cells.shape[2]):
                node = node_of(w, CarState(x, y, z, 0, AIR, 0, 0))
                if not space.state[node : node + 4].any():
                    continue
                kind = kind_at(w, x, y, z)
                place = -1
                if kind == BLOCK and blocks < counts[0]:
                    place = blocks
                    blocks = blocks + 1
                elif kind in (FSLOPE, BODY) and slopes < counts[1]:
                    place = counts[0] + slopes
                    slopes = slopes + 1
                elif kind == AIR and (floor or z > 1) and free < counts[2]:
                    place = counts[0] + counts[1] + free
                    free = free + 1
                if place >= 0:
                    choices[place, 0] = x
                    choices[place, 1] = y
                    choices[place, 2] = z
