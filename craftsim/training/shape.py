"""What a network must know of a task to read its observations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from craftsim.discrete.grid import check_size
from craftsim.discrete.kernel.tasks import IS_BLOCK, IS_BODY, IS_CAR, IS_FLAG, IS_FOOT, IS_FSLOPE, ROW
from craftsim.discrete.tasks import Task
from craftsim.errors import InputError
from craftsim.storage.limits import NETWORK_WIDTH, POLICY, size_text

FORMS: Final = {IS_CAR: 8, IS_FSLOPE: 4, IS_BODY: 4, IS_FOOT: 4, IS_BLOCK: 1, IS_FLAG: 1}
"""In how many forms an entity of each kind comes: four yaws, and a car with or without a load."""
_WEIGHT_BYTES: Final = 4


@dataclass(frozen=True)
class Shape:
    """The shape of the networks for a task. Raises InputError for one that no policy file could hold."""

    size: tuple[int, int, int]
    """Length, width and height of the map."""
    n_cars: int
    vector_length: int
    """Numbers in one car's observation."""
    width: int
    """Length of the vectors inside the network."""
    network: Literal["map", "relative"] = "map"
    """Whether things are looked up by their cells, or by where they are as a car sees it."""
    layer_norm: bool = False
    """Whether the policy normalises its layers."""

    def __post_init__(self) -> None:
        check_size(self.size, self.n_cars)
        NETWORK_WIDTH.check("width", self.width)
        if self.n_cars < 0 or self.vector_length < ROW or self.vector_length % ROW:
            raise InputError(
                f"the shape has {self.n_cars} cars that observe {self.vector_length} numbers; allowed: {ROW} a thing"
            )
        if (n_bytes := self.places * self.width * _WEIGHT_BYTES) > POLICY.content_bytes:
            raise InputError(
                f"for a map of size {self.size} a network of width {self.width} has {size_text(n_bytes)}; allowed: at "
                f"most {size_text(POLICY.content_bytes)}; take a smaller map"
            )

    def __str__(self) -> str:
        cells = " x ".join(map(str, self.size))
        seen = f" with {self.n_cars} cars that observe {self.vector_length} numbers"
        return f"{cells} cells{seen if self.network == 'map' else ''} (network {self.network}, width {self.width})"

    @property
    def n_rows(self) -> int:
        """Things in one car's observation."""
        return self.vector_length // ROW

    @property
    def cells(self) -> int:
        """Cells in which something may be; a car may stand above the highest one."""
        length, width, height = self.size
        return length * width * (height + 1)

    @property
    def places(self) -> int:
        """Rows of the table of all things in all cells, with one for what is not there.

        The own car has a part of the table to itself.
        """
        if self.network == "map":
            return (FORMS[IS_CAR] + sum(FORMS.values())) * self.cells + 1
        return FORMS[IS_CAR] * self.cells + 3 * sum(FORMS.values()) * self.offsets + 1

    @property
    def offsets(self) -> int:
        """Offsets that a thing may have from a car, however the car is turned."""
        length, width, height = self.size
        return (2 * max(length, width) - 1) ** 2 * (2 * height + 1)

    @classmethod
    def of(
        cls, task: Task, width: int, network: Literal["map", "relative"] = "map", layer_norm: bool = False
    ) -> Shape:
        """Return the shape of networks for a task."""
        layout = task.layout
        return cls(task.starts[0].size, layout.n_cars, layout.vector_length, width, network, layer_norm)

    def fits(self, other: Shape) -> bool:
        """Whether networks for this shape serve the worlds of another; those that look from a car count nothing."""
        if self.network == "map":
            return self == other
        return (self.size, self.width, self.network) == (other.size, other.width, other.network)


def check_stage(stage: Task, shape: Shape) -> None:
    """Raise InputError for a task to learn on before another one that is of another shape."""
    if (own := Shape.of(stage, shape.width, shape.network, shape.layer_norm)) != shape:
        raise InputError(f"stage '{stage.name}' has {own}; allowed is what the task has: {shape}")
