"""The search: by its generator alone, within bounds, to the best."""

import numpy as np
import pytest

from craftsim.errors import InputError
from craftsim.tuning.tune import cma_es, need_cma, population

BOUNDS = [(-1.0, 1.0), (-1.0, 0.0), (-1.0, 0.3)]
BEST = np.array([0.6, -0.1, 0.3])


def _search(seed):
    return cma_es(BOUNDS, [0.0, 0.0, 0.0], 0.25, np.random.default_rng(seed))


def _run(search, generations):
    asked = []
    for _ in range(generations):
        positions = search.ask()
        asked += [x.copy() for x in positions]
        search.tell(positions, [float(((x - BEST) ** 2).sum()) for x in positions])
    return np.array(asked)


def test_it_finds_the_best_within_its_bounds():
    search = _search(1)
    asked = _run(search, 60)
    assert np.allclose(search.result.xfavorite, BEST, atol=0.02)
    low, high = np.array(BOUNDS).T
    assert (asked >= low - 1e-9).all()
    assert (asked <= high + 1e-9).all()


def test_equal_generators_give_equal_candidates_whatever_the_global_one_does():
    first = _run(_search(5), 6)
    np.random.seed(3)  # noqa: NPY002
    state = np.random.get_state()[1].copy()  # noqa: NPY002
    assert (_run(_search(5), 6) == first).all()
    assert (np.random.get_state()[1] == state).all()  # noqa: NPY002
    assert (_run(_search(6), 6) != first).any()


def test_a_generation_has_its_number_of_candidates():
    assert len(_search(0).ask()) == population(3)


def test_without_its_library_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setattr("craftsim.extras.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"tuning needs cma, not installed here; .*-m pip install 'cma>="):
        need_cma()
