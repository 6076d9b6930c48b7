"""Compiled functions are cached by all sources together, and do not hold on to the arrays they are given."""

import sys
import weakref

import pytest
from numba import config

from craftsim.discrete import compiled
from craftsim.discrete.actions import Action
from craftsim.discrete.grid import Kind
from craftsim.discrete.rules import Rules
from craftsim.discrete.rules.table import legal

needs_compiler = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled")


@needs_compiler
def test_the_cache_is_stamped_with_a_digest_of_every_source(tmp_path, monkeypatch):
    assert legal._cache._cache_file._version.endswith(compiled._source_digest())
    (tmp_path / "rules").mkdir()
    for name in ("rules/moves.py", "grid.py"):
        (tmp_path / name).write_text("1")
    monkeypatch.setattr(compiled, "__file__", str(tmp_path / "compiled.py"))
    digest = compiled._source_digest.__wrapped__
    before = digest()
    assert digest() == before
    (tmp_path / "grid.py").write_text("2")
    assert digest() != before


@needs_compiler
def test_a_function_that_cannot_be_cached_safely_is_compiled_without(monkeypatch):
    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile.__init__", lambda self, *args, **kwargs: None)
    function = compiled.compiled(lambda number: number + 1)
    assert function(1) == 2


@pytest.mark.parametrize("rule_set", ["published", "physical"])
def test_calls_neither_keep_nor_lose_the_arrays_of_a_world(rule_set, scene, car):
    rules = Rules(rule_set)
    grid = scene([(Kind.BLOCK, (3, 3, 1))], [car(3, 3)])
    arrays = (grid.kind, grid.yaw, grid.top, grid.back, grid.cars)
    counts = [sys.getrefcount(array) for array in arrays]
    for _ in range(100):
        rules.mask(grid)
        rules.tick(grid, [(0, Action.LIFT)])
    assert [sys.getrefcount(array) for array in arrays] == counts
    gone = weakref.ref(grid.kind)
    del grid, arrays
    assert gone() is None
