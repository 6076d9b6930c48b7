"""Random legal episodes with many cars: as predicted, nothing drifts, and equal at any number of workers."""

import numpy as np
import pytest
from craftsim.validation.jobs import episodes
from craftsim.validation.jobs.episodes import (
    EARLY,
    N_BLOCKS,
    N_SLOPES,
    SIZE,
    EpisodeTrial,
    do_episode,
    items_of,
    random_world,
    run_episode,
)

from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.rules import Rules
from craftsim.validation.campaign import Header, run_campaign


def test_four_cars_do_sixty_actions_as_predicted_and_nothing_drifts():
    record = run_episode(EpisodeTrial(seed=21, n_actions=60, n_cars=4))
    assert record.disagreement == ()
    assert record.n_actions >= 60
    assert record.error_m <= 0.4e-3
    assert record.worst_error_m <= 0.5e-3
    assert record.car_error_m <= 0.5e-3
    assert 0.0 < record.early_error_m <= record.worst_error_m
    assert record.error_m <= record.worst_error_m


def test_noise_is_drawn_from_the_seed():
    noisy, again, exact = (run_episode(EpisodeTrial(4, 6, 2, noise)) for noise in (True, True, False))
    assert noisy.disagreement == exact.disagreement == ()
    assert noisy == again
    assert noisy.car_error_m != exact.car_error_m


def test_episodes_are_equal_bit_for_bit_at_one_and_at_two_workers(tmp_path):
    items = items_of(2, 0, 6, 2, noise=False)
    header = Header("episodes", 0, {})
    alone, shared = (run_campaign(items, do_episode, tmp_path / str(n), header, workers=n) for n in (1, 2))
    assert alone == shared
    assert [record["extra"]["trial"]["seed"] for record in alone] == [0, 1]
    assert [record["error"] for record in alone] == [None, None]
    here = run_episode(EpisodeTrial(0, 6, 2))
    assert alone[0]["extra"]["worst_error_m"] == here.worst_error_m


@pytest.mark.parametrize("seed", range(20))
def test_a_random_world_holds_what_it_promises(seed):
    trial = EpisodeTrial(seed)
    grid = random_world(trial, np.random.default_rng(seed))
    assert grid.size == SIZE
    slopes = np.isin(grid.kind, (Kind.FSLOPE, Kind.BODY)).sum()
    assert slopes == np.isin(grid.kind, (Kind.GEAR, Kind.FOOT)).sum() == N_SLOPES
    assert (grid.kind == Kind.BLOCK).sum() == N_SLOPES + N_BLOCKS
    cells = {tuple(row[:3]) for row in grid.cars[:, : CarField.Z + 1].tolist()}
    assert len(cells) == trial.n_cars
    assert all(grid.kind[cell] == Kind.AIR for cell in cells)


def test_what_is_drawn_is_legal_in_its_turn_and_each_car_acts_at_most_once():
    rules = Rules("physical")
    rng = np.random.default_rng(0)
    grid = random_world(EpisodeTrial(0), rng)
    for _ in range(30):
        joint = episodes._draw_tick(grid, rules, rng)
        assert len({car for car, _ in joint}) == len(joint) >= 1
        grid, applied = rules.tick(grid, joint)
        assert applied.all()


def test_an_episode_ends_with_its_first_disagreement_and_says_what_differed(monkeypatch):
    class Weak(episodes.Executor):
        def __init__(self, site, *args, **kwargs):
            super().__init__(site, *args, **kwargs)
            for car in site.cars:
                site.model.actuator_forcerange[car.wheel_actuators] = 0.0

    monkeypatch.setattr(episodes, "Executor", Weak)
    record = run_episode(EpisodeTrial(0, 60))
    assert record.n_actions < EARLY
    assert any("blocked" in line for line in record.disagreement)
