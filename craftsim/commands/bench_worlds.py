"""Worlds to time physics in: cars in a row that drive to and fro, and blocks at rest beside them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from craftsim.discrete.files.blueprint import parse_blueprint
from craftsim.discrete.kinds import Action
from craftsim.discrete.tasks import Task, free_play

if TYPE_CHECKING:
    from collections.abc import Iterable

_FLOOR: Final = (6, 64, 3)
_BLOCKS_AT_X: Final = (3, 5)
"""Columns that blocks stand in, the first one cell away from where cars come."""
MOST_CARS: Final = 32
MOST_BLOCKS: Final = 128


def yard(n_cars: int, n_blocks: int) -> Task:
    """Return a task of two ticks on a floor of 6 x 64 cells, whatever stands on it.

    Args:
        n_cars: every second cell of one edge has one, up to 32.
        n_blocks: on the floor in two rows along the other edge, up to 128.
    """
    assert n_cars <= MOST_CARS
    assert n_blocks <= MOST_BLOCKS
    length, width, height = _FLOOR
    cars = ((0, 2 * i) for i in range(n_cars))
    blocks = ((_BLOCKS_AT_X[i // width], i % width) for i in range(n_blocks))
    text = "\n".join(
        (
            f"area_length: {length}",
            f"area_width: {width}",
            f"area_height: {height}",
            f"block_num: {n_blocks}",
            "slope_num: 0",
            f"smartcar_num: {n_cars}",
            f"block: [{_listed(blocks)}]",
            f"smartcar: [{_listed(cars, ', yaw: 0')}]",
        )
    )
    name = f"yard_{n_cars}_{n_blocks}"
    return free_play(name, (parse_blueprint(text, name),), max_steps=0)


def _listed(cells: Iterable[tuple[int, int]], more: str = "") -> str:
    return ", ".join(f"{{id: {i}, x: {x}, y: {y}, z: 1{more}}}" for i, (x, y) in enumerate(cells))


def to_and_fro(tick: int, _: Any, observations: dict[str, Any]) -> dict[str, int]:
    """Return the actions of a tick in a yard: all cars drive a cell away from their edge, and back in the next."""
    return dict.fromkeys(observations, int(Action.MOVE_LEFT if tick % 2 else Action.MOVE_RIGHT))
