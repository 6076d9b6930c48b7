"""Random worlds hold what they promise, and many cars play in them as predicted."""

import numpy as np
import pytest

from craftsim.checking.attempt import Attempt
from craftsim.discrete.errors import InputError
from craftsim.discrete.grid import CarField, Kind
from craftsim.validation.runs.random_worlds import RandomWorlds
from craftsim.validation.validation import validate


@pytest.mark.parametrize("seed", range(20))
def test_a_random_world_holds_what_it_promises(seed):
    worlds = RandomWorlds()
    grid = worlds.grid(np.random.default_rng(seed))
    assert grid.size == worlds.size
    slopes = np.isin(grid.kind, (Kind.FSLOPE, Kind.BODY)).sum()
    assert slopes == np.isin(grid.kind, (Kind.GEAR, Kind.FOOT)).sum() == worlds.n_slopes
    assert (grid.kind == Kind.BLOCK).sum() == worlds.n_slopes + worlds.n_blocks
    cells = {tuple(row[:3]) for row in grid.cars[:, : CarField.Z + 1].tolist()}
    assert len(cells) == worlds.n_cars
    assert all(grid.kind[cell] == Kind.AIR for cell in cells)


def test_a_world_is_drawn_from_the_seed_and_every_run_draws_its_own():
    worlds = RandomWorlds()
    one, again, other = (worlds.grid(np.random.default_rng(seed)) for seed in (0, 0, 1))
    assert one.same_visible(again)
    assert not one.same_visible(other)
    assert worlds.task(np.random.default_rng(0)).draw(np.random.default_rng(5)).same_visible(one)


@pytest.mark.parametrize("figures", [{"n_cars": 0}, {"n_cars": 13}, {"n_blocks": 99}, {"max_steps": 0}])
def test_figures_that_do_not_fit_are_refused(figures):
    with pytest.raises(InputError, match="allowed"):
        RandomWorlds(**figures)


def test_four_cars_act_as_predicted_in_a_random_world_and_what_they_set_down_does_not_drift():
    result = validate(RandomWorlds(max_steps=18), seed=21)
    assert result.agrees, result.records
    attempts = result.attempts
    assert len(attempts) >= 60
    assert {attempt.car for attempt in attempts} == {0, 1, 2, 3}
    assert max(attempt.car_error_m for attempt in attempts) <= 0.5e-3
    assert max(attempt.placed_error_m or 0.0 for attempt in attempts) <= 0.5e-3


def test_what_a_random_policy_does_is_legal_in_its_turn_and_each_car_acts_at_most_once_a_tick():
    result = validate(RandomWorlds(n_cars=3, max_steps=6), seed=3)
    (record,) = result.records
    attempts = [Attempt.of(attempt) for attempt in record["attempts"]]
    assert all(attempt.legal for attempt in attempts)
    acts = [(attempt.tick, attempt.car) for attempt in attempts]
    assert len(set(acts)) == len(acts)
    assert record["extra"]["forbidden"] < len(acts)


def test_noise_is_drawn_from_the_seed():
    family = RandomWorlds(n_cars=2, max_steps=3)
    noisy, again, exact = (
        validate(family, seed=4, randomize=randomize).attempts for randomize in ("strong", "strong", "none")
    )
    assert noisy == again
    assert [a.car_error_m for a in noisy] != [a.car_error_m for a in exact]
