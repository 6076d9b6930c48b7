"""The search: by its generator alone, within bounds, to the best."""

import numpy as np
import pytest

from craftsim.errors import InputError
from craftsim.tuning.tune import cma_es, need_cma, population

BOUNDS = [(-1.0, 1.0), (-1.0, 0.0), (-1.0, 0.3)]
BEST = np.array([0.6, -0.1, 0.3])


def _run(seed, generations):
    """Return a search, and all that it asked for."""
    search, asked = cma_es(BOUNDS, [0.0, 0.0, 0.0], 0.25, np.random.default_rng(seed)), []
    for _ in range(generations):
        positions = search.ask()
        assert len(positions) == population(3)
        asked += [x.copy() for x in positions]
        search.tell(positions, [float(((x - BEST) ** 2).sum()) for x in positions])
    return search, np.array(asked)


def test_it_finds_the_best_within_its_bounds():
    search, asked = _run(1, 60)
    assert np.allclose(search.result.xfavorite, BEST, atol=0.02)
    low, high = np.array(BOUNDS).T
    assert ((asked >= low - 1e-9) & (asked <= high + 1e-9)).all()


def test_equal_generators_give_equal_candidates_whatever_the_global_one_does():
    first = _run(5, 6)[1]
    np.random.seed(3)  # noqa: NPY002
    state = np.random.get_state()[1].copy()  # noqa: NPY002
    assert (_run(5, 6)[1] == first).all()
    assert (np.random.get_state()[1] == state).all()  # noqa: NPY002
    assert (_run(6, 6)[1] != first).any()


def test_without_its_library_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setattr("craftsim.extras.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"tuning needs cma, not installed here; .*-m pip install 'cma>="):
        need_cma()
