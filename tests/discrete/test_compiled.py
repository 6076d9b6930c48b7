"""Compiled functions: what their cache depends on, their signatures, and the arrays that they are given."""

import math
import os
import shutil
import subprocess
import sys
import tempfile
import weakref
from collections import Counter
from contextlib import contextmanager
from pathlib import Path

import forked
import numpy as np
import pytest
from numba import config

import craftsim
from craftsim.compiled import code_cache, jit
from craftsim.compiled.jit import compiled, plain, seldom
from craftsim.compiled.progress import PROGRESS_LOG
from craftsim.discrete import actions, grid, rules
from craftsim.discrete.actions import Action, built_in_claims
from craftsim.discrete.grid import Kind
from craftsim.discrete.kernel import batch, claims
from craftsim.discrete.kernel import state as marks
from craftsim.discrete.kernel.rotation import wrap
from craftsim.discrete.rules import Rules
from craftsim.tasks import kernel as scores
from craftsim.tasks import potentials
from craftsim.validation.worlds import RandomWorlds

needs_compiler = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled")

OWN = '''
"""A module with compiled functions."""
import enum
import math
import numpy as np
from craftsim.compiled.jit import compiled

STEP = 1
PAIR = (1, 2.0)
TABLE = np.array([1, 2])
class Kind(enum.IntEnum):
    A = 1
    B = 2

@compiled
def inner(number):
    """Add one."""
    return number + STEP

@compiled
def outer(number):
    return inner(number) + Kind.A + TABLE[0] + int(PAIR[1] * math.floor(2.5))

@compiled
def other(number):
    return number - 1

def not_compiled(number):
    return number
'''


def contents(source):
    """Return the digests of outer, inner and other of a module with this source."""
    names = {"__name__": "own"}
    exec(compile(source, "own.py", "exec"), names)
    return [names[name].content for name in ("outer", "inner", "other")]


@needs_compiler
def test_the_cache_depends_on_code_callees_and_constants_alone():
    for old, new, changed in (
        ("A module with", "Some", []),
        ("return number\n", "return number + 5\n", []),
        ("    return number - 1", "    # Go back.\n    return number - 1", []),
        ("number - 1", "number - 2", ["other"]),
        ("number + STEP", "number - STEP", ["inner", "outer"]),
        ("STEP = 1", "STEP = 2", ["inner", "outer"]),
        ("PAIR = (1, 2.0)", "PAIR = (1, 3.0)", ["outer"]),
        ("array([1, 2])", "array([1, 3])", ["outer"]),
        ("A = 1", "A = 3", ["outer"]),
        ("@compiled\ndef inner", "@compiled(inline=False)\ndef inner", ["inner", "outer"]),
    ):
        assert OWN.count(old) == 1
        before, after = contents(OWN), contents(OWN.replace(old, new))
        names = ("outer", "inner", "other")
        assert {name for name, a, b in zip(names, before, after, strict=True) if a != b} == set(
            changed
        )


@contextmanager
def _environment(folder, own, environment):
    """Let processes that are started find own.py in a folder, and no cache but what the environment names."""
    (folder / "own.py").write_text(own)
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("NUMBA_CACHE_DIR", raising=False)
        for name, value in environment.items():
            patch.setenv(name, value)
        yield


def run(folder, code, own=OWN, **environment):
    """Run Python code beside own.py in a process that has compiled nothing yet, and return what it prints."""
    (folder / "call.py").write_text(code)
    with _environment(folder, own, environment):
        done = forked.run(folder / "call.py", cwd=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout


def run_anew(folder, code, **environment):
    """Do the same in a process that imports numba."""
    with _environment(folder, OWN, environment):
        words = [sys.executable, "-c", code]
        return subprocess.run(words, cwd=folder, capture_output=True, text=True, check=True).stdout


COUNT = "import own; print(own.outer(1), sum(map(len, (own.outer.stats.cache_misses, own.inner.stats.cache_misses))))"


@needs_compiler
def test_a_second_process_compiles_nothing_and_a_damaged_file_is_compiled_again(tmp_path):
    place = {"XDG_CACHE_HOME": str(tmp_path)}
    assert run(tmp_path, COUNT, **place) == "8 2\n"
    assert run(tmp_path, COUNT, **place) == "8 0\n"
    folder = tmp_path / "craftsim" / "compiled"
    assert folder.stat().st_mode & 0o777 == 0o700
    (file,) = folder.glob("own.outer.entry-*")
    file.write_bytes(file.read_bytes()[:-1])
    assert run(tmp_path, COUNT, **place) == "8 1\n"


@needs_compiler
def test_a_called_function_is_there_for_code_of_the_cache_though_python_called_it_first(tmp_path):
    own = OWN.replace("@compiled\ndef inner", "@compiled(inline=False)\ndef inner")
    assert own != OWN
    for calls in ("own.inner(1), own.outer(1), own.inner(1)", "own.outer(1), own.inner(1)"):
        said = run(
            tmp_path,
            f"import own; print({calls}, own.outer(1))",
            own,
            NUMBA_CACHE_DIR=str(tmp_path),
        )
        assert said.split()[-1] == "8"


@needs_compiler
def test_a_folder_that_others_may_write_to_is_not_used(tmp_path):
    place = {"XDG_CACHE_HOME": str(tmp_path)}
    (tmp_path / "craftsim" / "compiled").mkdir(parents=True)
    (tmp_path / "craftsim").chmod(0o777)
    for _ in range(2):
        assert run(tmp_path, COUNT, **place) == "8 2\n"
    assert not any((tmp_path / "craftsim" / "compiled").iterdir())


@needs_compiler
@pytest.mark.parametrize(("mode", "compiled"), [(0o777, 2), (0o770, 2), (0o1777, 0), (0o755, 0)])
def test_a_folder_in_which_others_may_replace_it_is_not_used(mode, compiled, tmp_path):
    place = tmp_path / "shared"
    place.mkdir()
    place.chmod(mode)
    if mode == 0o770 and os.geteuid() == os.getegid():
        compiled = 0  # the group is this user's own
    assert run(tmp_path, COUNT, NUMBA_CACHE_DIR=str(place)) == "8 2\n"
    assert run(tmp_path, COUNT, NUMBA_CACHE_DIR=str(place)) == f"8 {compiled}\n"
    assert (place / "craftsim-compiled").exists() == (compiled == 0)


@needs_compiler
def test_links_in_the_place_of_the_cache_are_not_followed(tmp_path):
    victim = tmp_path / "victim"
    victim.mkdir()
    for number in range(9):
        (victim / f"own.{number}.part-{'0' * 32}").touch()
    before = sorted(victim.iterdir())
    place = tmp_path / "linked"
    place.mkdir()
    (place / "craftsim-compiled").symlink_to(victim)
    code = "from craftsim.compiled import code_cache; code_cache._MOST = 4; " + COUNT
    for _ in range(2):
        assert run(tmp_path, code, NUMBA_CACHE_DIR=str(place)) == "8 2\n"
    assert sorted(victim.iterdir()) == before


@needs_compiler
@pytest.mark.parametrize("linked", [True, False])
def test_the_lock_empties_no_file_that_is_there(linked, tmp_path):
    folder = tmp_path / "craftsim-compiled"
    folder.mkdir(mode=0o700)
    letter = tmp_path / "letter" if linked else folder / "lock"
    letter.write_text("precious")
    letter.chmod(0o600)
    if linked:
        (folder / "lock").symlink_to(letter)
    assert run(tmp_path, COUNT, NUMBA_CACHE_DIR=str(tmp_path)) == "8 2\n"
    assert letter.read_text() == "precious"
    assert run(tmp_path, COUNT, NUMBA_CACHE_DIR=str(tmp_path)) == "8 0\n"


@needs_compiler
def test_a_linked_file_in_the_cache_is_not_read(tmp_path):
    assert run(tmp_path, COUNT, NUMBA_CACHE_DIR=str(tmp_path)) == "8 2\n"
    for file in (tmp_path / "craftsim-compiled").glob("own.*"):
        file.rename(tmp_path / file.name)
        file.symlink_to(tmp_path / file.name)
    assert run(tmp_path, COUNT, NUMBA_CACHE_DIR=str(tmp_path)) == "8 2\n"


def _as_user(number, function):
    """Return what a function returns, a text, in a copy of this process that is another user's."""
    reading, writing = os.pipe()
    pid = os.fork()
    if not pid:
        os.setgroups([])
        os.setgid(number)
        os.setuid(number)
        os.write(writing, function().encode())
        os._exit(0)
    os.close(writing)
    with open(reading, encoding="utf-8") as said:
        text = said.read()
    os.waitpid(pid, 0)
    return text


@pytest.mark.skipif(os.geteuid() != 0, reason="needs the right to be another user")
def test_what_another_user_owns_or_may_swap_is_not_used(monkeypatch):
    with tempfile.TemporaryDirectory() as place:
        Path(place).chmod(0o1777)
        monkeypatch.setenv("NUMBA_CACHE_DIR", place)

        def used():
            code_cache.folder.cache_clear()
            return str(code_cache.folder() is not None)

        assert _as_user(12345, used) == "True"
        assert _as_user(54321, used) == "False"  # what somebody else has put there
        assert used() == "False"

        def swapped():
            with pytest.raises(PermissionError):
                (Path(place) / "craftsim-compiled").rename(Path(place) / "aside")
            return "kept"

        assert _as_user(54321, swapped) == "kept"
        shutil.rmtree(Path(place) / "craftsim-compiled")
        os.chown(place, 54321, 54321)
        assert _as_user(12345, used) == "False"  # the owner of a folder may replace what is in it
        Path(place).chmod(0o755)
        assert _as_user(54321, used) == "True"
    code_cache.folder.cache_clear()


@pytest.mark.parametrize("home", [None, ""])
def test_a_cache_without_a_home_is_none_and_makes_no_folder_here(
    home, monkeypatch, tmp_path, caplog
):
    monkeypatch.chdir(tmp_path)
    for name in ("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR"):
        monkeypatch.delenv(name, raising=False)
    if home is not None:
        monkeypatch.setenv("HOME", home)
    monkeypatch.setattr("pwd.getpwuid", lambda number: {}[number])
    code_cache.folder.cache_clear()
    monkeypatch.setattr(PROGRESS_LOG, "propagate", True)
    assert code_cache.folder() is None
    code_cache.folder.cache_clear()
    assert "HOME" in caplog.text
    assert not any(tmp_path.iterdir())


def plant(folder):
    """Let a file of the working folder say where the cache is: what is in it is unpickled, which runs code."""
    (folder / ".numba_config.yaml").write_text(f"cache_dir: {folder / 'planted'}\n")


@needs_compiler
def test_a_file_of_the_working_folder_does_not_say_where_the_cache_is(tmp_path):
    plant(tmp_path)
    assert run_anew(tmp_path, COUNT, XDG_CACHE_HOME=str(tmp_path / "usual")) == "8 2\n"
    assert (tmp_path / "usual").exists()
    assert not (tmp_path / "planted").exists()


@needs_compiler
def test_code_for_any_processor_that_a_wheel_brings_is_read_and_not_compiled(tmp_path):
    made, own = tmp_path / "made", tmp_path / "own"
    plant(tmp_path)  # what the environment names counts
    assert run_anew(tmp_path, COUNT, NUMBA_CACHE_DIR=str(made), NUMBA_CPU_NAME="generic") == "8 2\n"
    assert not (tmp_path / "planted").exists()
    shipped = f"code_cache.SHIPPED_CODE = pathlib.Path({str(made / 'craftsim-compiled')!r}); "
    code = "import pathlib; from craftsim.compiled import code_cache; " + shipped + COUNT
    assert run(tmp_path, code, NUMBA_CACHE_DIR=str(own)) == "8 0\n"
    assert not any((own / "craftsim-compiled").iterdir())


@needs_compiler
def test_old_files_are_removed(tmp_path):
    folder = tmp_path / "craftsim-compiled"
    folder.mkdir()
    for number in range(5):
        for name in (f"own.{number}.part-{'0' * 32}", f"mine{number}.txt", f"own.part-{number}"):
            (folder / name).touch()
            os.utime(folder / name, (number, number))
    code = "from craftsim.compiled import code_cache; code_cache._MOST = 4; " + COUNT
    assert run(tmp_path, code, NUMBA_CACHE_DIR=str(tmp_path)) == "8 2\n"
    kept = sorted(file.name.partition("-")[0] for file in folder.glob("*-?????*"))
    assert kept == ["own.3.part", "own.4.part", "own.inner.part", "own.outer.entry"]
    assert len([*folder.glob("mine*")]) == len([*folder.glob("own.part-?")]) == 5


@needs_compiler
def test_of_many_processes_one_compiles_and_the_others_read_what_it_left(tmp_path):
    (tmp_path / "call.py").write_text(COUNT)
    said = [tmp_path / f"said{number}" for number in range(3)]
    for file in said:
        file.touch()
    with _environment(tmp_path, OWN, {"NUMBA_CACHE_DIR": str(tmp_path)}):
        processes = [
            forked.start(tmp_path / "call.py", cwd=tmp_path, out=str(file)) for file in said
        ]
    for process in processes:
        process.join(60)
    assert sorted(file.read_text() for file in said) == ["8 0\n", "8 0\n", "8 2\n"]


@needs_compiler
def test_a_literal_and_an_enum_make_no_second_signature_and_only_what_python_calls_has_a_wrapper(
    monkeypatch,
):
    monkeypatch.setattr(code_cache, "folder", lambda: None)

    @compiled
    def inner(number):
        return number + 1

    @compiled
    def outer(number):
        return inner(number) + inner(1) + inner(Action.LIFT) + inner(True)

    assert outer(1) == outer(Action(1)) == 2 + 2 + (Action.LIFT + 1) + 2
    assert len(outer.signatures) == 1
    assert {str(arguments) for arguments in inner.signatures} == {"(int64,)", "(bool,)"}
    assert not inner._wrapped
    assert inner(1) == 2
    assert len(inner._wrapped) == 1


@needs_compiler
def test_what_is_called_seldom_is_plain_python_until_that_takes_as_long_as_compiling(monkeypatch):
    monkeypatch.setattr(code_cache, "folder", lambda: None)
    monkeypatch.setattr(jit, "INTERPRETED_S", 0.1)

    @compiled
    def inner(number):
        return number + 11

    @compiled
    def outer(numbers, place):
        numbers[place] = inner(numbers[place])
        return numbers[place]

    call, numbers = seldom(outer), np.zeros(1)
    assert [call(numbers, 0) for _ in range(3)] == [11, 22, 33]
    assert not outer.signatures
    assert plain(outer)(numbers, 0) == 44
    while not outer.signatures:
        call(numbers, 0)
    assert call(numbers, 0) == numbers[0]
    assert len(outer.signatures) == len(inner.signatures) == 1


def _copied(value):
    if isinstance(value, tuple):
        found = [_copied(one) for one in value]
        return type(value)._make(found) if hasattr(value, "_make") else tuple(found)
    return value.copy() if isinstance(value, np.ndarray) else value


def _arrays(value):
    if isinstance(value, tuple):
        return [array for one in value for array in _arrays(one)]
    return [np.asarray(value)]


@needs_compiler
def test_plain_python_gives_what_compiled_code_gives(monkeypatch):
    """How long a function stays plain depends on the machine's speed, so that results must not depend on it."""
    calls = Counter()
    for module, name, function in (
        (rules, "_masks", batch.masks),
        (rules, "_step", batch.step),
        (rules, "_reason", batch.reason),
        (grid, "_derive_marks", marks.derive_marks),
        (actions, "_write_claims", claims.write_claims),
        (potentials, "_score_building", scores.score_buildings),
    ):

        def both(*arguments, name=name, function=function):
            calls[name] += 1
            others = _copied(arguments)
            one, other = function(*arguments), function.plain(*others)
            for a, b in zip(
                _arrays((one or 0, arguments)), _arrays((other or 0, others)), strict=True
            ):
                assert a.tobytes() == b.tobytes() if a.shape else a == b, name
            return one

        monkeypatch.setattr(module, name, both)
    rng = np.random.default_rng(0)
    for _ in range(6):
        for rule_set in ("published", "physical"):
            world, legal = RandomWorlds().grid(rng), craftsim.Rules(rule_set)
            legal.mask(world)
            every = [(car, action) for car in range(world.n_cars) for action in range(15)]
            for car, action in every:
                legal.explain(world, car, Action(action))
            for car, action in every:
                if not legal.legal(world, car, action):
                    continue
                built_in_claims(world, car, Action(action))
                after = legal.apply(world, car, Action(action))
            after.derive_marks()
    for name in ("simple_two_story", "complex_two_story"):
        env = craftsim.parallel_env(name, "grid")
        seen, _ = env.reset(seed=0)
        for _ in range(5):
            chosen = {
                a: int(rng.choice(np.flatnonzero(one["action_mask"]))) for a, one in seen.items()
            }
            seen, *_ = env.step(chosen)
    assert len(calls) == 6, calls


@needs_compiler
def test_what_is_called_seldom_is_compiled_if_the_cache_has_it(tmp_path):
    seldom_ = OWN + "\nfrom craftsim.compiled.jit import seldom\nrare = seldom(outer)\n"
    count = "import own; print(own.{}(1), len(own.outer.signatures))"
    place = {"XDG_CACHE_HOME": str(tmp_path)}
    assert run(tmp_path, count.format("rare"), seldom_, **place) == "8 0\n"
    assert run(tmp_path, count.format("outer"), seldom_, **place) == "8 1\n"
    assert run(tmp_path, count.format("rare"), seldom_, **place) == "8 1\n"


@needs_compiler
def test_the_log_tells_how_far_compiling_is(caplog, monkeypatch):
    monkeypatch.setattr(code_cache, "folder", lambda: None)

    @compiled
    def only(number):
        return number + 7

    with caplog.at_level("INFO", logger="craftsim.compiled.progress"):
        assert only(1) == 8
    (done, total), *_, last = [record.args for record in caplog.records]
    assert last == (total, total) == (done + 1, done + 1)


ALL = f"""
import importlib, pkgutil, runpy, craftsim
from craftsim.compiled.jit import _Compiled
runpy.run_path({str(Path(__file__).parents[2] / "scripts" / "precompile.py")!r}, run_name="__main__")
for room in ("discrete", "designs", "planning", "models", "skills", "checking", "envs"):
    for found in pkgutil.walk_packages([f"{{craftsim.__path__[0]}}/{{room}}"], f"craftsim.{{room}}."):
        for one in vars(importlib.import_module(found.name)).values():
            if isinstance(one, _Compiled) and one.__module__ == found.name:
                print(room, one.__name__, len(one.signatures))
"""


@needs_compiler
@pytest.mark.slow
def test_a_function_has_one_signature_and_there_are_few_of_them(tmp_path):
    # With an empty cache: what has no wrapper is not read from it, for it is a part of what has one.
    done = subprocess.run(
        [sys.executable, "-c", ALL],
        env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    functions = [line.split() for line in done.stdout.splitlines()]
    assert [one for one in functions if int(one[2]) > 1] == []
    assert len(functions) <= 145


@pytest.mark.parametrize("rule_set", ["published", "physical"])
def test_calls_neither_keep_nor_lose_the_arrays_of_a_world(rule_set, scene, car):
    rules = Rules(rule_set)
    grid = scene([(Kind.BLOCK, (3, 3, 1))], [car(3, 3)])
    arrays = (grid.cells, grid.cars)
    counts = [sys.getrefcount(array) for array in arrays]
    for _ in range(100):
        rules.mask(grid)
        rules.tick(grid, [(0, Action.LIFT)])
    assert [sys.getrefcount(array) for array in arrays] == counts
    gone = weakref.ref(grid.cells)
    del grid, arrays
    assert gone() is None


_RNG = np.random.default_rng(0)
ANGLES = [
    *_RNG.normal(scale=10.0, size=2000),
    *_RNG.normal(scale=1e5, size=2000),
    *(
        math.nextafter(k * math.pi, towards)
        for k in range(-40, 41)
        for towards in (-9e9, k * math.pi, 9e9)
    ),
    *(0.0, -0.0, 5e-324, 1e300, -1e300),
]


def test_an_angle_is_wrapped_as_remainder_does():
    for angle in map(float, ANGLES):
        wrapped, expected = wrap(angle), math.remainder(angle, math.tau)
        assert wrapped == expected, angle
        assert math.copysign(1.0, wrapped) == math.copysign(1.0, expected), angle


def test_what_is_not_finite_wraps_to_nan():
    for angle in (math.inf, -math.inf, math.nan):
        assert math.isnan(wrap(angle))
