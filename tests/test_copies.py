"""A copy of a world, of what moves it, or of an environment is one of its own, and goes on bit for bit."""

import ast
import copy
import gc
import importlib
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cloudpickle
import gymnasium
import numpy as np
import pytest
from copied import WAYS, arrays_of, by_pickle, in_common, numbers_of, shared_memory

import craftsim
import craftsim.envs
from craftsim import Action, Executor, Kind, PhysicsWorld
from craftsim.checking.contacts import Drift
from craftsim.checking.recipe import begin
from craftsim.checking.setup import Seed, set_up, setup_of
from craftsim.envs.central import CentralConstruction
from craftsim.envs.text import TextConstruction, answer_text
from craftsim.models.measuring import Motors
from craftsim.skills.fleet import Disturbance, DisturbedFleet
from craftsim.workers.copying import Copyable, NotCopyable, OfOneProcess

TASK = "simple_two_story"
PERIODS = 50
WORLDS = {
    "rollers": {},
    "wheels": {"drive": "wheels"},
    "strong": {"randomize": "strong", "drive": "wheels"},
    "uneven": {"randomize": "workshop_floor"},
    "uneven floor": {"randomize": "workshop_floor", "drive": "wheels"},
}
FORMS = {
    "parallel": craftsim.parallel_env,
    "turns": craftsim.env,
    "asynchronous": lambda *task, **options: craftsim.parallel_env(
        *task, execution="asynchronous", **options
    ),
    "asynchronous turns": lambda *task, **options: craftsim.env(
        *task, execution="asynchronous", **options
    ),
    "central": lambda task, backend, **options: CentralConstruction(
        task, backend=backend, **options
    ),
    "text": lambda task, backend, **options: TextConstruction(task, backend=backend, **options),
    "gymnasium": lambda task, backend, **options: gymnasium.make(
        "craftsim/SimpleTwoStory-v0", backend=backend, **options
    ),
}


def _judge(name):
    grid = craftsim.read_blueprint(TASK).grid(np.random.default_rng(0))
    return set_up(grid, setup_of(**WORLDS[name]), Seed((3,)))


def _drive(world: PhysicsWorld, periods: int) -> None:
    for number in range(periods):
        for car in range(len(world.cars)):
            world.drive(car, [3 + car, 5, 5, 3 - car] if number % 20 < 15 else [0, 0, 0, 0])
        world.advance()


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", WORLDS)
def test_a_world(name, way):
    world = _judge(name).physics
    _drive(world, 7)
    before = numbers_of(world.data)
    copied = way(world)
    assert numbers_of(copied.data) == before
    _drive(copied, PERIODS)
    assert numbers_of(world.data) == before
    _drive(world, PERIODS)
    assert numbers_of(copied.data) == numbers_of(world.data)
    assert copied.capped_steps == world.capped_steps
    # What is drawn or reset later is alike, too.
    for one in (world, copied):
        one.reset()
    assert numbers_of(copied.data) == numbers_of(world.data)


def test_a_sleeping_world_sleeps_in_its_copy_and_wakes_as_the_original_does():
    world = _judge("wheels").physics
    for _ in range(100):
        world.advance()
    assert (world.data.tree_asleep >= 0).all()
    for way in WAYS:
        copied, twin = way(world), way(world)
        assert numbers_of(copied.data) == numbers_of(world.data)
        _drive(copied, 5)
        _drive(twin, 5)
        assert numbers_of(copied.data) == numbers_of(twin.data)
    _drive(world, 5)
    assert numbers_of(copied.data) == numbers_of(world.data)


def test_a_saved_state_is_whole_in_another_place():
    world = _judge("strong").physics
    _drive(world, 7)
    state = world.save()
    _drive(world, PERIODS)
    for way in WAYS:
        other = _judge("strong").physics
        other.restore(way(state))
        _drive(other, PERIODS)
        assert numbers_of(other.data) == numbers_of(world.data)


def _go_on(judge, periods=PERIODS):
    for _ in range(periods):
        judge.executor.advance()
    executor = judge.executor
    return (
        numbers_of(judge.physics.data),
        executor.readings().tobytes(),
        executor.commands.tobytes(),
        sorted(executor.busy),
        judge.log.contacts,
        judge.log.hazards(),
        judge._drift.furthest.tobytes(),
        judge._drift.ways.tobytes(),
    )


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", WORLDS)
def test_skills_in_the_middle_of_actions(name, way):
    judge = _judge(name)
    for car, action in enumerate([Action.ROTATE_LEFT, Action.MOVE_LEFT]):
        judge.executor.begin(car, action)
    _go_on(judge, 20)
    assert judge.executor.busy
    before = numbers_of(judge.physics.data)
    copied = way(judge)
    assert copied.executor.physics is copied.physics is copied.log.physics
    assert copied.executor.fleet.sensors.physics is copied.physics is not judge.physics
    went_on = _go_on(copied)
    assert numbers_of(judge.physics.data) == before
    assert _go_on(judge) == went_on
    executor = way(judge.executor)
    for _ in range(PERIODS):
        judge.executor.advance()
        executor.advance()
    assert numbers_of(executor.physics.data) == numbers_of(judge.physics.data)


@pytest.mark.parametrize("way", WAYS)
def test_a_judge_in_the_middle_of_actions(way):
    judge = _judge("uneven floor")
    for car, action in enumerate([Action.ROTATE_LEFT, Action.MOVE_LEFT]):
        begin(judge, car, action, 0)
    assert judge.next(judge.physics.time_s + 0.5) == ()
    copied = way(judge)
    attempts = []
    for one in (copied, judge):
        attempts.append([])
        while one.running:
            attempts[-1] += one.next()
    assert attempts[0] == attempts[1]
    assert len(attempts[0]) == 2
    assert numbers_of(copied.physics.data) == numbers_of(judge.physics.data)
    assert [judge.perform(0, Action.ROTATE_RIGHT)] == [copied.perform(0, Action.ROTATE_RIGHT)]


@pytest.mark.parametrize("kind", ["shove", "dead-car"])
@pytest.mark.parametrize("way", WAYS)
def test_a_disturbance_that_goes_on(way, kind):
    grid = craftsim.Grid.empty((6, 3, 1), n_cars=1)
    grid.kind[4, 1, 1] = Kind.BLOCK
    setup = replace(setup_of(drive="wheels"), disturbance=Disturbance(kind, 0.3))
    judge = set_up(grid, setup, Seed((3,)))
    judge.executor.begin(0, Action.ROTATE_LEFT)
    for _ in range(25):
        judge.executor.advance()
    assert judge.executor.fleet.happened
    copied = way(judge)
    assert isinstance(copied.executor.fleet, DisturbedFleet)
    assert _go_on(copied) == _go_on(judge)


def test_what_is_shared_stays_shared_and_nothing_else_is():
    world = _judge("strong").physics
    motors, executor = Motors(world), Executor(world)
    both = {"motors": motors, "executor": executor}
    for way in (copy.deepcopy, by_pickle):
        copied = way(both)
        assert copied["motors"]._physics is copied["executor"].physics is not world
        assert np.shares_memory(copied["motors"]._ctrl, copied["executor"].physics.data.ctrl)


@pytest.mark.parametrize("name", WORLDS)
def test_arrays_of_a_copy_lie_as_those_of_the_original_and_elsewhere(name):
    """Nothing in a copy of a judge, whatever it is called, lies in the original's memory."""
    judge = _judge(name)
    judge.executor.begin(0, Action.ROTATE_LEFT)
    _go_on(judge, 5)
    for way in WAYS:
        copied = way(judge)
        _go_on(copied, 1)
        original = copy.deepcopy(judge)
        _go_on(original, 1)
        arrays, others = arrays_of(original), arrays_of(copied)
        assert sorted(arrays) == sorted(others)
        assert len(arrays) > 100
        assert shared_memory(others) == shared_memory(arrays)
        assert in_common(others, arrays_of(judge)) == set()
        assert in_common(others, arrays) == set()


def test_views_that_are_copied_as_arrays_would_be_found(monkeypatch):
    judge = _judge("wheels")
    monkeypatch.setattr(Drift, "_bound", ())
    monkeypatch.setattr(Drift, "_bind", lambda drift: None)
    copied = copy.deepcopy(judge)
    assert shared_memory(arrays_of(copied)) != shared_memory(arrays_of(judge))


def _make(form, backend, **options):
    if backend == "physics":
        options = {"noise": "mild", "check_contacts": True} | options
    return FORMS[form](TASK, backend, **options)


def _core(env):
    return env.unwrapped.core if hasattr(env.unwrapped, "core") else env.env.env.env.core


def _plain(value):
    """Return something to compare that is equal bit for bit."""
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return value.tobytes() if isinstance(value, np.ndarray) else repr(value)


def _play(form, env, n_actions, seed):
    """Play random actions that the masks offer; return all that came of it, and the state of the physics."""
    rng = np.random.default_rng(seed)
    history = []

    def chosen(mask):
        return int(rng.choice(np.flatnonzero(mask)))

    for _ in range(n_actions):
        if "turns" in form:
            observation, reward, *ends, info = env.last()
            history.append((_plain(observation), reward, ends, _plain(info)))
            if any(ends):
                break
            env.step(chosen(observation["action_mask"]))
            continue
        core = _core(env)
        masks = core.masks
        acts = [chosen(mask) for mask in masks]
        if form == "text":
            given = answer_text({f"car_{car}": act for car, act in enumerate(acts)})
        elif form in ("central", "gymnasium"):
            given = np.array(acts)
        else:
            given = {agent: acts[int(agent[4:])] for agent in env.agents}
        history.append(_plain(env.step(given)))
        if not core._runs:
            break
    core = _core(env)
    history.append(core.grid.cells.tobytes() + core.grid.cars.tobytes())
    if hasattr(core.backend, "judge"):
        history.append(numbers_of(core.backend.judge.physics.data))
        history.append(core.backend.judge.executor.readings().tobytes())
        history.append(core.backend.recipe)
    return history


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("backend", ["grid", "physics"])
@pytest.mark.parametrize("form", FORMS)
def test_an_environment(form, backend, way):
    env = _make(form, backend)
    env.reset(seed=5)
    _play(form, env, 3, seed=1)
    before = copy.deepcopy(env)
    if form == "gymnasium" and way is copy.copy:
        way = copy.deepcopy  # Gymnasium's own wrapper shares its environment with a shallow copy
    copied = way(env)
    played = _play(form, copied, 5, seed=2)
    # The original has not moved.
    assert _play(form, env, 0, seed=0) == _play(form, before, 0, seed=0)
    assert _play(form, env, 5, seed=2) == played
    # Generators went along: the next episodes are alike.
    for one in (env, copied):
        one.reset()
    assert _play(form, env, 2, seed=3) == _play(form, copied, 2, seed=3)
    if backend == "physics":
        worlds = [_core(one).backend.judge for one in (env, copied)]
        for judge in worlds:
            for _ in range(PERIODS):
                judge.executor.advance()
        assert numbers_of(worlds[0].physics.data) == numbers_of(worlds[1].physics.data)


@pytest.mark.parametrize("form", FORMS)
def test_an_environment_before_its_first_reset(form):
    env = _make(form, "physics")
    copied = by_pickle(env)
    for one in (env, copied):
        one.reset(seed=2)
    assert _play(form, env, 2, seed=1) == _play(form, copied, 2, seed=1)


@pytest.mark.parametrize(
    "options", [{"helper_depth": 10}, {"helper_depth": 10, "object_choice": True}]
)
@pytest.mark.parametrize("backend", ["grid", "physics"])
def test_queues_and_choices_of_the_action_helper(backend, options):
    if "object_choice" in options:
        options |= {"object_choice": craftsim.envs.actions.ObjectChoice()}
    env = _make("parallel", backend, **options)
    env.reset(seed=5)
    _play("parallel", env, 3, seed=1)
    copied = copy.deepcopy(env)
    assert _play("parallel", copied, 6, seed=2) == _play("parallel", env, 6, seed=2)


def test_a_batch_of_grid_worlds():
    for way in WAYS:
        envs = craftsim.vector_env(TASK, 4)
        envs.reset(seed=1)
        copied = way(envs)
        acts = np.full((4, envs.task.layout.n_cars), int(Action.MOVE_LEFT))
        came = [_plain(one.step(acts)) for one in (copied, envs, copied, envs)]
        assert came[0] == came[1] != came[2] == came[3]


def test_a_copy_outlives_the_original():
    env = _make("parallel", "physics")
    env.reset(seed=5)
    twin = copy.deepcopy(env)
    copied = copy.deepcopy(env)
    env.close()
    del env
    gc.collect()
    assert _play("parallel", copied, 4, seed=2) == _play("parallel", twin, 4, seed=2)


_ELSEWHERE = """
import pickle, sys
sys.path.insert(0, sys.argv[1])
import test_copies
from pathlib import Path
folder = Path(sys.argv[2])
came = {}
for file in sorted(folder.glob("*.env")):
    form = file.stem.partition(" by ")[0]
    came[file.stem] = test_copies._play(form, pickle.loads(file.read_bytes()), 3, seed=2)
for file in sorted(folder.glob("*.judge")):
    came[file.stem] = test_copies._go_on(pickle.loads(file.read_bytes()))
(folder / "came").write_bytes(pickle.dumps(came))
"""


def test_a_pickle_goes_on_in_another_process(tmp_path):
    expected = {}
    for form in FORMS:
        env = _make(form, "physics")
        env.reset(seed=5)
        _play(form, env, 2, seed=1)
        for module in (pickle, cloudpickle):
            (tmp_path / f"{form} by {module.__name__}.env").write_bytes(module.dumps(env))
            expected[f"{form} by {module.__name__}"] = None
        played = _play(form, env, 3, seed=2)
        expected |= {name: played for name in expected if name.partition(" by ")[0] == form}
    for name in WORLDS:
        judge = _judge(name)
        judge.executor.begin(0, Action.ROTATE_LEFT)
        _go_on(judge, 20)
        (tmp_path / f"{name}.judge").write_bytes(pickle.dumps(judge))
        expected[name] = _go_on(judge)
    command = [sys.executable, "-c", _ELSEWHERE, str(Path(__file__).parent), str(tmp_path)]
    subprocess.run(command, check=True, timeout=300)
    came = pickle.loads((tmp_path / "came").read_bytes())
    assert came.keys() == expected.keys()
    for name, history in expected.items():
        assert came[name] == history, name


@pytest.mark.parametrize("mode", ["rgb_array", "rgb_array_list"])
def test_a_copy_renders_with_a_renderer_of_its_own(rendering, mode):
    env = _make("parallel", "physics", render_mode=mode, render_size=(64, 48))
    env.reset(seed=5)
    env.render()
    for way in (copy.deepcopy, by_pickle):
        copied, twin = way(env), way(env)
        for one in (copied, twin):
            _play("parallel", one, 1, seed=2)
        twin.close()
        pictures = copied.render(), twin.render()
        assert _plain(pictures[0]) == _plain(pictures[1])
        assert copied.core.backend._pictures._renderer is not env.core.backend._pictures._renderer
        for one in (copied, twin):
            one.close()
    _play("parallel", env, 1, seed=2)
    assert _plain(env.render()) == _plain(pictures[0])
    env.close()


def test_images_of_a_copy_are_those_of_the_original(rendering):
    images = craftsim.envs.observations.Images(size=(32, 24))
    env = _make("parallel", "physics", images=images)
    env.reset(seed=5)
    copied = copy.deepcopy(env)
    assert _play("parallel", copied, 2, seed=2) == _play("parallel", env, 2, seed=2)
    for one in (env, copied):
        one.close()


def test_a_copy_records_trajectories_of_its_own(tmp_path):
    env = _make("parallel", "physics", record=tmp_path)
    env.reset(seed=5)
    _play("parallel", env, 1, seed=1)
    copied = by_pickle(env)
    _play("parallel", env, 1, seed=2)
    _play("parallel", copied, 1, seed=3)
    for one in (env, copied):
        one.close()
    files = sorted(tmp_path.glob("*.npz"))
    assert len(files) == 2
    assert len({craftsim.Trajectory.read(file).qpos.tobytes() for file in files}) == 2


def _kinds(kind):
    for one in kind.__subclasses__():
        yield one
        yield from _kinds(one)


_HANDLES = {
    "MjData",
    "Stepping",
    "make_renderer",
    "create_connection",
    "create_server",
    "Process",
    "Pipe",
    "ctypes",
}
"""Names in what a class keeps: of memory of MuJoCo's, renderers, connections and processes."""


def _keeps_handles(kind: ast.ClassDef) -> bool:
    """Return whether objects of a class keep any of that in attributes, as far as its code shows it."""
    for node in ast.walk(kind):
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            targets = [node.target]
        else:
            continue
        kept = [
            part.value
            for target in targets
            for part in ast.walk(target)
            if isinstance(part, ast.Attribute)
        ]
        names = {getattr(part, "id", getattr(part, "attr", "")) for part in ast.walk(node.value)}
        if names & _HANDLES and any(
            isinstance(owner, ast.Name) and owner.id == "self" for owner in kept
        ):
            return True
    return False


def test_what_holds_memory_processes_or_connections_is_copied_right_or_refuses():
    package = Path(craftsim.__file__).parent
    kinds = []
    for file in sorted(package.rglob("*.py")):
        nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        names = [
            node.name for node in nodes if isinstance(node, ast.ClassDef) and _keeps_handles(node)
        ]
        module = ".".join(["craftsim", *file.relative_to(package).with_suffix("").parts])
        kinds += [getattr(importlib.import_module(module), name) for name in names]
    assert PhysicsWorld in kinds
    assert [kind for kind in kinds if not issubclass(kind, Copyable | NotCopyable)] == []


@pytest.mark.parametrize(
    "kind", sorted({*_kinds(NotCopyable)} - {OfOneProcess}, key=lambda kind: kind.__name__)
)
def test_what_cannot_be_had_twice_says_so(kind):
    for way in WAYS:
        with pytest.raises(
            TypeError, match=rf"^{kind.__name__} objects cannot be copied or pickled; .+[^.]$"
        ):
            way(object.__new__(kind))
