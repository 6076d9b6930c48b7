"""From what a car observes to a vector that a network learns from quickly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, assert_never

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.kinds import MOVE_DIRECTION, Action
from craftsim.learning.shape import FORMS, Shape
from craftsim.tasks.kernel import IS_CAR, IS_GOAL, IS_LOADED, ROW, YAW_HIGH, YAW_LOW


@dataclass(frozen=True)
class Features:
    """Observations of cars as inputs of a network."""

    places: Tensor  # (..., n, rows): row of the encoder's table for each entity, see Encoder.places
    offers: Tensor  # (..., n, 15) bool: action masks, with at least one action each

    def __getitem__(self, index: Any) -> Features:
        """Index the leading dimensions."""
        return Features(self.places[index], self.offers[index])

    def flat(self) -> Features:
        """Return the observations with the first two dimensions flattened."""
        return Features(self.places.flatten(0, 1), self.offers.flatten(0, 1))


def joined(parts: Sequence[Features], join: Callable[..., Tensor] = torch.cat) -> Features:
    """Concatenate along the first dimension, or combine with ``join``, such as torch.stack."""
    return Features(
        join([batch.places for batch in parts]), join([batch.offers for batch in parts])
    )


def with_hidden(
    vectors: NDArray[np.int32], ticks: NDArray[np.integer], busy: NDArray[np.bool_]
) -> NDArray[np.int32]:
    """Return what cars observe, (B, n, vector_length), with a row more of what that hides.

    It has the tick (B,) of the episode, whether the car's helper is under way, of ``busy`` (B, n), so that what the car
    decides is not done, and whether that of another car is; all other numbers are 0.
    """
    row = np.zeros((*vectors.shape[:-1], ROW), vectors.dtype)
    row[..., 0] = ticks[:, None]
    row[..., 1] = busy
    row[..., 2] = busy.sum(-1, keepdims=True) > busy
    return np.concatenate([vectors, row], axis=-1)


def decided(offered: NDArray[np.bool_], busy: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return masks (B, n, 15) of which a car whose helper is under way has STOP alone, as it does not decide."""
    masks = offered & ~busy[..., None]
    masks[..., Action.STOP] |= busy
    return masks


class Encoder(nn.Module):
    """Turns observations (..., n, vector_length) into places, and these with masks (..., n, 15) into vectors."""

    n_places: int
    """Numbers in a car's places."""
    bounds: tuple[float, float]
    """The least and the largest of them."""
    dtype: torch.dtype = torch.int32
    table: nn.EmbeddingBag

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.ticks = shape.ticks

    def places(self, observation: Tensor) -> Tensor:
        """Return the place in the table of every row of observations (..., 13 * rows), shape (..., rows)."""
        raise NotImplementedError

    def on_map(self, values: Tensor, places: Tensor) -> Tensor:
        """Return values of actions (..., n, 15) in the order of the map's actions."""
        return values

    def look(self, observations: NDArray[np.integer], masks: NDArray[np.generic]) -> Features:
        """Return observations (..., n, vector_length) and masks (..., n, 15) as inputs of a network."""
        device = self.table.weight.device
        places = self.places(torch.from_numpy(observations.astype(np.int32)).to(device))
        return Features(places.to(self.dtype), torch.from_numpy(masks.astype(np.bool_)).to(device))


class LinearEncoder(Encoder):
    """A linear layer on the numbers that a car observes, and on which car it is, as in CraftEnv's released learner.

    Its places are these numbers themselves, and its table has a row for each.
    """

    def __init__(self, shape: Shape) -> None:
        super().__init__(shape)
        self.n_places = shape.vector_length
        self.dtype = torch.int16
        if max(*shape.size, shape.ticks) < torch.iinfo(torch.int8).max:
            self.dtype = torch.int8  # a replay memory of it is half as large
        limits = torch.iinfo(self.dtype)
        self.bounds = (limits.min, limits.max)
        self.table = nn.EmbeddingBag(shape.places, shape.width)
        self.car = nn.Parameter(torch.empty(shape.n_cars, shape.width))
        self.begin(self.table.weight)
        self.begin(self.car)

    def begin(self, weight: Tensor) -> None:
        """Let weights begin as those of a linear layer do that has the last action among its inputs, too."""
        largest = (self.n_places + N_ACTIONS + len(self.car)) ** -0.5
        nn.init.uniform_(weight, -largest, largest)

    def places(self, observation: Tensor) -> Tensor:
        """Return the observations."""
        return observation

    def forward(self, features: Features) -> Tensor:
        """Return one vector a car (..., n, width)."""
        weight = self.table.weight
        encoded: Tensor = features.places.to(weight.dtype) @ weight + self.car
        return encoded


class EntityEncoder(Encoder):
    """Looks every entity up in a table by what it is and where.

    These vectors, and those of what a car may do, are added up. This is a linear layer on a one-hot drawing of the
    world without the multiplication by zeros, and the order of the blocks among themselves plays no part in it.
    """

    forms: Tensor
    turns: Tensor

    def __init__(self, shape: Shape) -> None:
        super().__init__(shape)
        self.n_places = shape.vector_length // ROW
        if shape.ticks:
            self.n_places += 1  # the row of what is hidden has two
        length, width, height = shape.size
        self.map = (length, width, height + 1)  # a car may stand above the highest cell
        self.cells = shape.cells
        counts = [FORMS[kind] for kind in range(IS_CAR, IS_GOAL)]
        self.n_forms = sum(counts)
        forms = torch.tensor([0, *counts[:-1]]).cumsum(0)
        self.register_buffer("forms", forms, persistent=False)
        self.register_buffer("turns", forms.new_tensor([n >= 4 for n in counts]), persistent=False)
        self.absent = shape.places - 1 - shape.n_hidden
        self.bounds = (0, shape.places - 1)
        self.table = nn.EmbeddingBag(shape.places, shape.width, mode="sum")
        self.mask = nn.Linear(N_ACTIONS, shape.width)

    def places(self, observation: Tensor) -> Tensor:
        """Return the place in the table of every row of observations (..., 13 * rows), shape (..., rows)."""
        if not self.ticks:
            return self.places_of_things(observation)
        things = observation[..., :-ROW]
        hidden = observation[..., -ROW:].long()
        tick = hidden[..., :1].clamp(max=self.ticks - 1)
        busy = hidden[..., 1:2] + 2 * hidden[..., 2:3]
        first = self.absent + 1
        places = [self.places_of_things(things), first + tick, first + self.ticks + busy]
        return torch.cat(places, -1)

    def places_of_things(self, observation: Tensor) -> Tensor:
        """Return the same of all rows but that of what is hidden."""
        raise NotImplementedError

    def _read(self, observation: Tensor) -> tuple[Tensor, ...]:
        """Return of each row its numbers, kinds, form without yaw, yaw, if it has one, cell, whether in the area."""
        rows = observation.long().unflatten(-1, (-1, ROW))
        x = rows[..., 0]
        y = rows[..., 1]
        z = rows[..., 2] - 1
        length, width, height = self.map
        kinds = rows[..., IS_CAR:IS_GOAL]
        turns = (kinds * self.turns).sum(-1)
        yaw = (2 * rows[..., YAW_HIGH] + rows[..., YAW_LOW]) * turns
        inside = (x >= 0) & (y >= 0) & (z >= 0) & (x < length) & (y < width) & (z < height)
        return (
            rows,
            kinds,
            (kinds * self.forms).sum(-1),
            yaw,
            turns,
            (x * width + y) * height + z,
            inside,
        )

    def _looked_up(self, places: Tensor) -> Tensor:
        entities: Tensor = self.table(places.flatten(0, -2)).unflatten(0, places.shape[:-1])
        return entities


class MapEncoder(EntityEncoder):
    """Looks entities up by their cells of the map, the own car in a part of the table to itself."""

    def __init__(self, shape: Shape) -> None:
        super().__init__(shape)
        self.car = nn.Parameter(torch.zeros(shape.n_cars, shape.width))  # by its number
        nn.init.normal_(self.table.weight, std=0.5)

    def places_of_things(self, observation: Tensor) -> Tensor:
        """Return the place in the table of every row of observations (..., 13 * rows), shape (..., rows)."""
        rows, kinds, form, yaw, _, cell, inside = self._read(observation)
        form = form + yaw + 4 * rows[..., IS_LOADED]
        form[..., 1:] += FORMS[IS_CAR]
        # A goal never moves, so there is nothing to learn from its row; a design that does is not for a table of cells.
        visible = kinds.any(-1) & (rows[..., IS_GOAL] == 0) & inside
        return torch.where(visible, form * self.cells + cell, self.absent)

    def forward(self, features: Features) -> Tensor:
        """Return one vector a car (..., n, width)."""
        offered: Tensor = self.mask(features.offers.to(self.car.dtype))
        return self._looked_up(features.places) + self.car + offered


class RelativeEncoder(EntityEncoder):
    """Looks entities up from a car's own point of view: by how they lie and are turned as the car sees it.

    Cars are alike, and so are all four directions: a move is one ahead, to the left, back or to the right until
    :meth:`on_map` says which that is. What is to be built is looked up, too, apart by whether it is there.
    The car's own cell has a table to itself, which says where the area ends; a square area is turned as the car is.
    """

    steps: Tensor
    from_map: Tensor
    to_map: Tensor
    turned: Tensor

    def __init__(self, shape: Shape) -> None:
        super().__init__(shape)
        self.reach = max(shape.size[:2]) - 1
        self.offsets = shape.offsets
        self.own = FORMS[IS_CAR] * shape.cells
        seen_as = _moves_as_seen()
        self.register_buffer(
            "steps", torch.tensor([[1, 0], [0, 1], [-1, 0], [0, -1]]), persistent=False
        )
        self.register_buffer("from_map", seen_as.argsort(-1), persistent=False)
        self.register_buffer("to_map", seen_as, persistent=False)
        self.register_buffer("turned", _as_seen_from(self.map), persistent=False)
        self.inner = nn.Linear(shape.width, shape.width)
        nn.init.normal_(self.table.weight, std=0.3)

    def places_of_things(self, observation: Tensor) -> Tensor:
        """Return the place in the table of every row of observations (..., 13 * rows), shape (..., rows)."""
        rows, kinds, form, yaw, turns, cell, inside = self._read(observation)
        cell = cell.clamp(0, self.cells - 1)
        is_goal = rows[..., IS_GOAL] != 0
        heading = yaw[..., :1]
        look = form + (yaw - heading) % 4 * turns + 4 * rows[..., IS_LOADED]
        # A cell to be built is looked up by whether the thing is there; one that a car carries past is not.
        entity = (form + yaw) * self.cells + cell
        is_thing = ~is_goal & kinds.any(-1)
        same_place = (entity[..., :, None] == entity[..., None, :]) & is_thing[..., None, :]
        loaded = (cell[..., :, None] == cell[..., None, :]) & (rows[..., IS_LOADED] != 0)[
            ..., None, :
        ]
        built = same_place.any(-1) & ~loaded.any(-1)
        look = look + self.n_forms * (is_goal * (1 + built))
        turn = self.steps[heading]
        dx, dy, dz = (rows[..., :3] - rows[..., :1, :3]).unbind(-1)
        side = 2 * self.reach + 1
        size = 2 * self.map[2] - 1
        front = dx * turn[..., 0] + dy * turn[..., 1] + self.reach
        side_offset = dy * turn[..., 0] - dx * turn[..., 1] + self.reach
        offset = (front * side + side_offset) * size + dz + self.map[2] - 1
        places = self.own + look * self.offsets + offset
        places[..., 0] = (heading[..., 0] + 4 * rows[..., 0, IS_LOADED]) * self.cells + cell[..., 0]
        # A cell that the flag is to reach is none of a car's to be built, whose place it has.
        return torch.where((kinds.any(-1) | is_goal) & inside, places, self.absent)

    def forward(self, features: Features) -> Tensor:
        """Return one vector a car (..., n, width)."""
        car_rows = self.turned[features.places[..., :1].long()]
        entities = self._looked_up(torch.cat([car_rows, features.places[..., 1:]], -1))
        offered = features.offers.gather(-1, self.from_map[self._heading(features.places)]).to(
            entities.dtype
        )
        vectors: Tensor = self.inner((entities + self.mask(offered)).relu())
        return vectors

    def on_map(self, values: Tensor, places: Tensor) -> Tensor:
        """Return values of actions (..., n, 15) that a car sees as its own, in the order of the map's."""
        return values.gather(-1, self.to_map[self._heading(places)])

    @torch.no_grad()
    def take_over(self, source: RelativeEncoder, learnt: Tensor) -> None:
        """Take over what another encoder of the same width has learnt, whatever its area.

        Things that lie alike from a car are looked up alike. The own cell is the one as far from the nearer borders.
        ``learnt`` (places,) says which rows of its table the other one has learnt.
        """
        self.mask.load_state_dict(source.mask.state_dict())
        self.inner.load_state_dict(source.inner.state_dict())
        rows = self._rows_in(source)
        learnt_rows = learnt[rows] & (rows != source.absent)
        self.table.weight[learnt_rows] = source.table.weight[rows[learnt_rows]]

    def _rows_in(self, source: RelativeEncoder) -> Tensor:
        """Return (places,): the row of another encoder's table that each row is like, or its row for nothing."""
        x, y = (_as_far(*lengths) for lengths in zip(self.map[:2], source.map[:2], strict=True))
        z = torch.arange(self.map[2]).clamp(max=source.map[2] - 1)
        cells = torch.arange(source.own).view(-1, *source.map)[:, x][:, :, y][..., z]
        wider = self.reach - source.reach
        higher = self.map[2] - source.map[2]
        side = 2 * source.reach + 1
        offsets = torch.arange(source.own, source.absent).view(
            -1, side, side, 2 * source.map[2] - 1
        )
        offsets = functional.pad(offsets, (higher, higher, *4 * (wider,)), value=source.absent)
        nothing = torch.full((self.table.num_embeddings - self.absent,), source.absent)
        return torch.cat([source.turned[cells.flatten()], offsets.flatten(), nothing])

    def _heading(self, places: Tensor) -> Tensor:
        """Return (..., n): the yaw of each car, from its own place in the table."""
        return places[..., 0].long() // self.cells % 4


def _moves_as_seen() -> Tensor:
    """Return (4, 15): by a car's yaw, the action that each action of the map is to the car: yaw 0 sees the map's."""
    actions = {yaw: action for action, yaw in MOVE_DIRECTION.items()}
    moves = torch.arange(N_ACTIONS).repeat(4, 1)
    for heading in range(4):
        for direction, action in actions.items():
            moves[heading, action] = int(actions[(direction - heading) % 4])
    return moves


def _as_seen_from(size: tuple[int, int, int]) -> Tensor:
    """Return, for each place of a car's own, which it is looked up by: those that a square area turns into each other
    are one.
    """
    length, width, height = size
    places = torch.arange(FORMS[IS_CAR] * length * width * height)
    if length != width:
        return places
    by_form = places.view(2, 4, length, width, height).clone()
    for yaw in range(1, 4):
        by_form[:, yaw] = by_form[:, 0].rot90(yaw, (1, 2))
    return by_form.flatten()


def _as_far(length: int, source_length: int) -> Tensor:
    """Return (length,): for each cell of a row the one of another row that is as far from the border nearer to it."""
    cells = torch.arange(length)
    return torch.where(2 * cells < length, cells, source_length - length + cells).clamp(
        0, source_length - 1
    )


def make_encoder(shape: Shape) -> Encoder:
    """Return the encoder of a shape."""
    match shape.network:
        case "map":
            return MapEncoder(shape)
        case "relative":
            return RelativeEncoder(shape)
        case "linear":
            return LinearEncoder(shape)
        case _:
            assert_never(shape.network)
