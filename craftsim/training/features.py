"""From what a car observes to a vector that a network learns from quickly."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from craftsim.discrete.rules.legality import N_ACTIONS
from craftsim.discrete.tasks.observation import IS_CAR, IS_GOAL, IS_LOADED, ROW, YAW_HIGH, YAW_LOW
from craftsim.training.shape import FORMS, Shape


class Encoder(nn.Module):
    """Turns observations (..., n, vector_length) and masks (..., n, 15) into vectors (..., n, width).

    Every entity is looked up in a table by what it is and where; these vectors, and one each for the car's number and
    for what it may do, are added up. This is a linear layer on a one-hot drawing of the world without the
    multiplication by zeros, and the order of the blocks among themselves plays no part in it.
    """

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        length, width, height = shape.size
        self.map = (length, width, height + 1)  # a car may stand above the highest cell
        self.cells = shape.cells
        first = FORMS[IS_CAR]  # the own car has a part of the table to itself
        counts = [FORMS[kind] for kind in range(IS_CAR, IS_GOAL)]
        forms = torch.tensor([first, *counts[:-1]]).cumsum(0)
        self.register_buffer("forms", forms, persistent=False)
        self.register_buffer("turns", forms.new_tensor([n >= 4 for n in counts]), persistent=False)
        self.absent = shape.places - 1
        self.table = nn.EmbeddingBag(shape.places, shape.width, mode="sum")
        self.car = nn.Parameter(torch.zeros(shape.n_cars, shape.width))
        self.mask = nn.Linear(N_ACTIONS, shape.width)
        nn.init.normal_(self.table.weight, std=0.5)

    def places(self, observation: Tensor) -> Tensor:
        """Return the place in the table of every row of observations (..., 13 * rows), shape (..., rows)."""
        rows = observation.long().unflatten(-1, (-1, ROW))
        x, y, z = rows[..., 0], rows[..., 1], rows[..., 2] - 1
        length, width, height = self.map
        cell = (x * width + y) * height + z
        kinds = rows[..., IS_CAR:IS_GOAL]  # a goal never moves, so there is nothing to learn from its row
        yaw = 2 * rows[..., YAW_HIGH] + rows[..., YAW_LOW]
        form = (kinds * self.forms).sum(-1) + yaw * (kinds * self.turns).sum(-1) + 4 * rows[..., IS_LOADED]
        form[..., 0] -= FORMS[IS_CAR]
        shown = kinds.any(-1) & (x >= 0) & (y >= 0) & (z >= 0)
        shown &= (x < length) & (y < width) & (z < height)
        return torch.where(shown, form * self.cells + cell, self.absent)

    def forward(self, observation: Tensor, mask: Tensor) -> Tensor:
        """Return one vector a car."""
        return self.of_places(self.places(observation), mask)

    def of_places(self, places: Tensor, mask: Tensor) -> Tensor:
        """Return one vector a car from what :meth:`places` returned, and masks (..., n, 15)."""
        entities: Tensor = self.table(places.flatten(0, -2)).unflatten(0, places.shape[:-1])
        offered: Tensor = self.mask(mask.to(entities.dtype))
        return entities + self.car + offered
