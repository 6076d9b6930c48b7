"""Entity sets: the same in the car's frame however the world is turned, masked beyond a radius, in their space."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import craftsim
from craftsim.designs.tasks import with_reflections
from craftsim.discrete.tasks import as_task
from craftsim.envs.observations import FILLED, OWN, WHAT, X, Y, Z, entity_sets, observe_entities
from craftsim.errors import InputError


def _sorted(rows: NDArray[np.int16]) -> NDArray[np.int16]:
    return rows[np.lexsort(rows.T)]


def test_in_the_cars_frame_a_turned_world_looks_the_same() -> None:
    task = as_task("designs")
    starts = task.draw_starts(np.random.default_rng(0), 8)
    turned = with_reflections(starts)
    seen = entity_sets(turned.grids, task.layout, turned.designs)
    for turn in (16, 32, 48):  # the reflected ones stand between
        for i in range(8):
            for car in range(2):
                np.testing.assert_array_equal(_sorted(seen[i, car]), _sorted(seen[turn + i, car]))
    on_map = entity_sets(turned.grids, task.layout, turned.designs, "map")
    assert any((_sorted(on_map[i, 0]) != _sorted(on_map[16 + i, 0])).any() for i in range(8))


def test_own_row_stands_at_the_origin_and_nothing_beyond_the_radius_is_seen() -> None:
    task = as_task("designs")
    starts = task.draw_starts(np.random.default_rng(1), 8)
    everything = entity_sets(starts.grids, task.layout, starts.designs)
    near = entity_sets(starts.grids, task.layout, starts.designs, radius=1)
    own = everything[everything[..., OWN] == 1]
    assert len(own) == 16
    assert not own[:, X : Z + 1].any()
    far = np.abs(everything[..., [X, Y]]).max(-1) > 1
    assert far.any()
    assert not near[far].any()
    np.testing.assert_array_equal(near[~far], everything[~far])


def test_cells_of_the_design_are_filled_exactly_when_it_is_built() -> None:
    task = as_task("strip")
    observe = observe_entities(task)
    grid = task.draw(np.random.default_rng(0))
    rows = observe.of(grid, 0)
    targets = rows[task.layout.n_rows - 1 :]
    assert task.design is not None
    assert (targets[:, WHAT] > 0).all()
    built = [grid.kind[target.cell] == target.kind for target in task.design.targets]
    assert targets[:, FILLED].sum() == sum(built) < len(built)


def test_an_environment_gives_them_within_their_space() -> None:
    task = as_task("strip")
    env = craftsim.parallel_env("strip", "grid", observe=observe_entities(task, "map", 2))
    seen, _ = env.reset(seed=0)
    assert env.observation_space("car_0").contains(seen["car_0"])


@pytest.mark.parametrize("bad", [{"frame": "world"}, {"radius": -1}])
def test_a_bad_frame_or_radius_is_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"allowed|there are"):
        observe_entities(as_task("strip"), **bad)


def test_a_task_that_draws_designs_is_refused() -> None:
    with pytest.raises(InputError, match="design of its own"):
        observe_entities(as_task("designs"))
