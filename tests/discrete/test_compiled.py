"""Compiled functions are cached by all sources together, and do not hold on to the arrays they are given."""

import os
import subprocess
import sys
import weakref

import pytest
from numba import config

from craftsim.discrete import compiled
from craftsim.discrete.actions import Action
from craftsim.discrete.grid import Kind
from craftsim.discrete.rules import Rules
from craftsim.discrete.rules.table import legal
from craftsim.skills.control import step_cars

needs_compiler = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled")


@needs_compiler
def test_the_cache_is_stamped_with_a_digest_of_every_source(tmp_path, monkeypatch):
    assert legal._cache._cache_file._version.endswith(compiled._source_digest("discrete"))
    assert step_cars._cache._cache_file._version.endswith(compiled._source_digest("skills"))
    for room in ("discrete", "discrete/rules", "models", "skills"):
        (tmp_path / room).mkdir()
        (tmp_path / room / "some.py").write_text("1")
    monkeypatch.setattr(compiled, "__file__", str(tmp_path / "discrete" / "compiled.py"))

    def digests():
        compiled._source_digest.cache_clear()
        return [compiled._source_digest(room) for room in ("discrete", "models", "skills", "elsewhere")]

    try:
        before = digests()
        assert digests() == before
        assert len(set(before)) == 4
        for room, changed in (("discrete/rules", 4), ("models", 3), ("skills", 2)):
            (tmp_path / room / "some.py").write_text("2")
            after = digests()
            assert sum(a != b for a, b in zip(after, before, strict=True)) == changed
            assert after[: 4 - changed] == before[: 4 - changed]
            before = after
    finally:
        compiled._source_digest.cache_clear()


@needs_compiler
def test_a_function_that_cannot_be_cached_safely_is_compiled_without(monkeypatch):
    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile.__init__", lambda self, *args, **kwargs: None)
    function = compiled.compiled(lambda number: number + 1)
    assert function(1) == 2


@needs_compiler
def test_of_many_processes_one_compiles_and_the_others_read_what_it_left(tmp_path):
    (tmp_path / "own.py").write_text(
        "from craftsim.discrete.kernel.jit import compiled\n"
        "@compiled\n"
        "def inner(number): return number + 1\n"
        "@compiled\n"
        "def outer(number): return inner(number) + 1\n"
    )
    asks = "import own; print(own.outer(1), len(own.outer.stats.cache_misses), len(own.inner.stats.cache_misses))"
    processes = [
        subprocess.Popen([sys.executable, "-c", asks], cwd=tmp_path, stdout=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    told = sorted(process.communicate(timeout=60)[0].split() for process in processes)
    assert told == [["3", "0", "0"], ["3", "0", "0"], ["3", "1", "1"]]


@needs_compiler
@pytest.mark.parametrize("named", [False, True])
def test_a_file_of_the_working_folder_does_not_say_where_the_cache_is(tmp_path, named):
    """What is in a cache is unpickled, which runs code."""
    (tmp_path / ".numba_config.yaml").write_text(f"cache_dir: {tmp_path / 'planted'}\n")
    (tmp_path / "own.py").write_text(
        "from craftsim.discrete.kernel.jit import compiled\n@compiled\ndef more(number): return number + 1\n"
    )
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    if named:
        environment["NUMBA_CACHE_DIR"] = str(tmp_path / "named")
    words = [sys.executable, "-c", "import own; print(own.more(1))"]
    done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == "2\n"
    assert not (tmp_path / "planted").exists()
    assert (tmp_path / "named").exists() == named


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
