"""Actions of a user's own are registered from one file, and everything knows them."""

import importlib
import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import forked
import numpy as np
import pytest
from registered import forget

import craftsim
from craftsim import Action, Grid, Kind
from craftsim.checking.recipe import Recipe, Step, perform_step, run_up
from craftsim.discrete.actions import ACTIONS, as_registered
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.schedule import make_schedule, nominal_durations
from craftsim.envs.text import TextConstruction
from craftsim.errors import InputError
from craftsim.rendering.plots.gantt import draw_gantt
from craftsim.tasks.episodes import Episodes

ROOT = Path(__file__).parents[1]


@pytest.fixture
def push():
    """Register PUSH of tests/push.py."""
    sys.modules.pop("push", None)
    yield importlib.import_module("push").PUSH
    forget()


@pytest.fixture
def free_names():
    """Forget what the test registers."""
    yield
    forget()


def _before_a_block(n_cars=1):
    grid = Grid.empty((6, 3, 2), n_cars)
    grid.cars[0, :4] = 1, 1, 1, 0
    for car in range(1, n_cars):
        grid.cars[car, :4] = car - 1, 0, 1, 0
    grid.kind[2, 1, 1] = Kind.BLOCK
    grid.derive_marks()
    return grid


def test_a_registered_action_has_a_number_a_name_and_a_row(push):
    assert (int(push), push.name, repr(push)) == (15, "PUSH", "<Action.PUSH: 15>")
    assert Action["PUSH"] is Action(15) is push
    assert list(ACTIONS)[-1] is push
    assert [int(action) for action in Action] == list(range(15))
    assert nominal_durations()[push].tolist() == [4.1] * 4
    assert pickle.loads(pickle.dumps(push)) is push
    assert as_registered(["PUSH"]) == (push,)


def test_rules_judge_explain_and_carry_out_a_registered_action(push):
    rules, grid = craftsim.Rules("physical"), _before_a_block()
    assert rules.legal(grid, 0, push)
    assert rules.explain(grid, 0, push).legal
    after = rules.apply(grid, 0, push)
    assert after.cars[0, :3].tolist() == [2, 1, 1]
    assert after.kind[3, 1, 1] == Kind.BLOCK
    assert after.kind[2, 1, 1] == Kind.AIR
    assert grid.kind[2, 1, 1] == Kind.BLOCK
    twice, applied = rules.tick(grid, [(0, push), (0, Action.MOVE_LEFT)])
    assert applied.tolist() == [True, True]
    assert twice.cars[0, 0] == 1
    empty = Grid.empty((3, 1, 1), 1)
    assert str(rules.explain(empty, 0, push)) == "PUSH is forbidden: there is nothing to push"
    assert rules.apply(empty, 0, push).same_visible(empty)
    assert not craftsim.Rules("published").legal(grid, 0, push)
    assert not rules.legal(grid, 0, 16)


def test_masks_have_a_column_for_those_that_are_named_alone(push):
    grid = _before_a_block()
    assert craftsim.Rules("physical").mask(grid).shape == (1, 15)
    rules = craftsim.Rules("physical", actions=["PUSH"])
    assert rules.mask(grid)[0, 15]
    assert rules.reachable(grid)[0, 15]
    assert rules.actions[-1] is push
    assert not rules.mask(Grid.empty((3, 1, 1), 1))[0, 15]


def test_a_schedule_waits_for_who_is_where_a_block_is_pushed_and_is_drawn(push, tmp_path):
    grid = _before_a_block(3)
    grid.cars[1, :2], grid.cars[2, :2] = (3, 1), (5, 0)
    grid.derive_marks()
    ticks = [[(1, Action.MOVE_FORWARD)], [(0, push)], [(2, Action.MOVE_FORWARD)]]
    schedule = make_schedule(grid, ticks, craftsim.Rules("physical"))
    assert [step.waits_for for step in schedule.steps] == [frozenset(), {0}, frozenset()]
    assert schedule.makespan() > 4.1
    assert draw_gantt(tmp_path / "chart.png", schedule, "pushing").stat().st_size > 0


@pytest.mark.parametrize("depth", [None, 4])
def test_a_batch_with_registered_actions_is_as_its_worlds_one_by_one(push, depth):
    rng = np.random.default_rng(1)
    task = craftsim.make_task("block")
    episodes = Episodes(task, np.random.default_rng(0), 12, "physical", depth, actions=["PUSH"])
    rules = craftsim.Rules("physical", actions=["PUSH"])
    pushes = 0
    for _ in range(25):
        masks = episodes.offered()
        chosen = np.where(
            masks[..., 15] & (rng.random(masks.shape[:2]) < 0.5),
            15,
            (rng.random(masks.shape) * masks).argmax(-1),
        )
        before = [episodes.grid(i) for i in range(len(episodes))]
        queued = episodes.queue[:, :, 0] >= 0
        steps = episodes.step(chosen)
        for i, grid in enumerate(before):
            if depth is None:
                assert np.array_equal(rules.mask(grid), masks[i])
                joint = [(int(car), int(chosen[i, car])) for car in steps.order[i]]
                after, applied = rules.tick(grid, joint)
                assert after.same_visible(episodes.grids[i])
                assert after.same_marks(episodes.grids[i])
                assert np.array_equal(applied, steps.applied[i][steps.order[i]])
        pushes += int(((chosen == 15) & steps.applied & ~queued).sum())
    assert pushes > 0


@pytest.mark.parametrize("backend", ["grid", "physics"])
def test_environments_offer_what_they_are_asked_for(push, backend):
    env = craftsim.parallel_env("block", backend, actions=("PUSH",))
    assert env.action_space("car_0").n == 16
    observations, _ = env.reset(seed=0, options={"grid": _as_start(env)})
    assert observations["car_0"]["action_mask"].tolist()[15] == 1
    _, _, _, _, infos = env.step({agent: 15 if agent == "car_0" else 10 for agent in env.agents})
    assert not infos["car_0"]["illegal"]
    assert infos["car_0"]["duration_s"] == pytest.approx(4.1, abs=0.1)
    assert env.grid.cars[0, :2].tolist() == [2, 1]
    plain = craftsim.parallel_env("block", backend)
    assert plain.action_space("car_0").n == 15


def _as_start(env):
    task = env.core.task
    grid = Grid.empty(task.starts[0].size, task.layout.n_cars)
    for car in range(grid.n_cars):
        grid.cars[car, :4] = 1, 1 + 2 * car, 1, 0
    grid.kind[2, 1, 1] = Kind.BLOCK
    grid.derive_marks()
    return grid


def test_text_and_batches_know_registered_actions(push):
    text = TextConstruction("block", backend="grid", actions=("PUSH",))
    text.reset(seed=0, options={"grid": _as_start(text)})
    said = text.step("car_0: push")[0]
    assert "car_0: PUSH: as predicted" in said or "push" in said
    envs = craftsim.vector_env("block", 2, actions=("PUSH",))
    observations, _ = envs.reset(seed=0)
    assert observations["action_mask"].shape[-1] == 16
    assert envs.single_action_space.nvec.tolist()[0] == 16


def test_worker_processes_import_what_registers(push, monkeypatch):
    # Given by its name or by itself, it is the same there.
    for one in ("PUSH", push):
        envs = craftsim.vector_env("block", 2, "physics", workers=1, actions=(one,))
        try:
            observations, _ = envs.reset(seed=0)
            assert observations["action_mask"].shape[-1] == 16
        finally:
            envs.close()


def test_a_plan_with_a_registered_action_is_validated_audited_and_replayed(
    push, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    craftsim.write_blueprint(_before_a_block(), "world.yaml")
    Path("mine.plan").write_text(
        "0 0 PUSH\n1 0 MOVE_LEFT\n2 0 MOVE_RIGHT\n3 0 PUSH\n", encoding="utf-8"
    )
    fast = {"randomize": "none", "drive": "wheels"}
    result = craftsim.validate("world.yaml", plan="mine.plan", trials=1, order="ticks", **fast)
    assert result.agrees, [(a.action, a.reason) for a in result.attempts]
    assert [a.action for a in result.attempts].count("PUSH") == 2
    # In a process of its own: a command line offers the actions that were registered before it was loaded.
    shutil.copy(Path(__file__).parent / "push.py", "push.py")
    words = "--plugins push audit --rules physical --actions PUSH --only legal --trials 1 --workers 2 --out audit"
    options = (word for name, value in fast.items() for word in (f"--{name}", value))
    done = forked.run("craftsim", *words.split(), *options)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 of " in done.stdout
    for plugin, said in (
        ([], "unknown action 'PUSH'"),
        (["--plugins", "nowhere"], "'nowhere' cannot be imported"),
    ):
        done = forked.run("craftsim", *plugin, "validate", "world.yaml", "--plan", "mine.plan")
        assert (done.returncode, said in done.stderr) == (2, True), done.stderr
    recipe = Recipe(blueprint_text(_before_a_block()), (Step.single(0, 0, push),))
    assert recipe.steps[0].acts[0].action == "PUSH"
    first, again = (perform_step(run_up(recipe), recipe.steps[-1]) for _ in range(2))
    assert first == again
    assert first[0].agrees


def _legal(grid, car):
    return None


def _effect(grid, car):
    """Change nothing."""


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "LIFT"}, "there is an action 'LIFT' already"),
        ({"name": "MOVE"}, "there is an action 'MOVE' already"),
        ({"name": "push it"}, "made of capitals"),
        (
            {"legal": lambda grid: None},
            "legal is called as legal\\(grid, car\\), but yours takes \\(grid\\)",
        ),
        ({"effect": None}, "effect must be a function"),
        ({"duration_s": 0.0}, "duration_s is 0.0; allowed: seconds, more than 0"),
        ({"duration_s": "1 s"}, "duration_s is '1 s'"),
        (
            {"footprint": lambda grid, car: ()},
            "footprint is called as footprint\\(before, after, car\\)",
        ),
        ({"skill": lambda: None}, "skill is called as skill\\(setup, now, task\\)"),
    ],
)
def test_a_wrong_registration_says_what_is_wrong(arguments, message, free_names):
    given = {"name": "NOD", "legal": _legal, "effect": _effect, "duration_s": 1.0} | arguments
    with pytest.raises(InputError, match=message):
        craftsim.register_action(**given)
    assert len(ACTIONS) == 15


def test_what_functions_return_is_checked(free_names):
    def out_of_the_map(grid, car):
        grid.cars[car, 0] = 99

    grid, rules = Grid.empty((3, 1, 1), 1), craftsim.Rules("physical")
    lost = craftsim.register_action("GET_LOST", _legal, out_of_the_map, duration_s=1.0)
    with pytest.raises(
        InputError,
        match=r"GET_LOST: after effect\(grid, 0\) car 0 is at \(99, 0, 1\), outside the map",
    ):
        rules.apply(grid, 0, lost)
    odd = craftsim.register_action("ODD", lambda grid, car: False, _effect, duration_s=1.0)
    with pytest.raises(InputError, match=r"ODD: legal\(grid, car\) returned False"):
        rules.legal(grid, 0, odd)
    new = craftsim.register_action("RENEW", _legal, lambda grid, car: grid.copy(), duration_s=1.0)
    with pytest.raises(InputError, match="RENEW: effect"):
        rules.apply(grid, 0, new)
    nod = craftsim.register_action("NOD", _legal, _effect, duration_s=1.0)
    with pytest.raises(InputError, match="there is an action 'NOD' already"):
        craftsim.register_action("NOD", _legal, _effect, duration_s=1.0)
    with pytest.raises(InputError, match="'RENEW' was registered without a skill"):
        craftsim.parallel_env("strip", "physics", actions=("RENEW",))
    with pytest.raises(InputError, match="no skill performs NOD"):
        craftsim.perform(craftsim.PhysicsWorld(grid), 0, nod)
    with pytest.raises(
        InputError, match="no registered action 'LIFT'; there are GET_LOST, ODD, RENEW, NOD"
    ):
        craftsim.parallel_env("strip", "grid", actions=("LIFT",))


CRATE = {
    "craftsim/discrete/kinds.py": [
        ("    FOOT = 8\n", "    FOOT = 8\n    CRATE = 9\n"),
        (
            '\n}\n"""The table of kinds',
            '\n    Kind.CRATE: KindSpec("a crate", "CC", "green", (0.3, 0.6, 0.3), "crates", "c", True),'
            '\n}\n"""The table of kinds',
        ),
    ],
    "craftsim/discrete/files/blueprint.py": [
        ('    "wall": Kind.WALL,\n', '    "wall": Kind.WALL,\n    "crate": Kind.CRATE,\n'),
        (
            "    wall: tuple[_Place, ...] = ()\n",
            "    wall: tuple[_Place, ...] = ()\n    crate: tuple[_Place, ...] = ()\n",
        ),
        (
            'Literal["block", "flag", "fold_slope"]',
            'Literal["block", "flag", "fold_slope", "crate"]',
        ),
    ],
    "craftsim/discrete/kernel/rules.py": [
        (
            "\n\n\n@compiled\n",
            "\n\nfrom craftsim.discrete.kinds import Kind\nCRATE = int(Kind.CRATE)\n\n\n@compiled\n",
        ),
        ("BLOCK, FLAG", "BLOCK, CRATE, FLAG"),
    ],
    "craftsim/mjcf/block.py": [
        (
            "    Kind.WALL: Table(",
            '    Kind.CRATE: Table("A crate.", (0.3, 0.6, 0.3)),\n    Kind.WALL: Table(',
        )
    ],
}
"""The edits that a new kind takes: one that cars drive under and carry, and that bears nothing."""

CARRYING = """
import craftsim
from craftsim import Action
from craftsim.discrete.drawing import world_text
from craftsim.discrete.grid import check_grid

grid = craftsim.Grid.empty((5, 2, 2), 1)
grid.kind[1, 0, 1] = craftsim.Kind.CRATE
grid.derive_marks()
rules, physics = craftsim.Rules("physical"), craftsim.PhysicsWorld(grid)
for name in ("MOVE_RIGHT", "LIFT", "MOVE_RIGHT", "DROP"):
    said = rules.explain(grid, 0, Action[name])
    assert said.legal, said
    attempt = craftsim.perform(physics, 0, name)
    assert attempt.agrees, attempt
    grid = rules.apply(grid, 0, Action[name])
check_grid(grid)
craftsim.write_blueprint(grid, "out.yaml")
assert "crate:" in open("out.yaml").read()
assert craftsim.read_blueprint("out.yaml").n_cars == 1
assert "CC" in world_text(grid, None).plain
print([piece.kind.name for piece in grid.pieces()], physics.machine_names.names[3])
"""


def test_a_new_kind_takes_four_files(tmp_path):
    package = Path(craftsim.__file__).parent
    ignored = shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc", "policies", "meshes")
    shutil.copytree(package, tmp_path / "craftsim", ignore=ignored)
    for file, edits in CRATE.items():
        path = tmp_path / file
        text = path.read_text(encoding="utf-8")
        for old, new in edits:
            assert old in text
            text = text.replace(old, new, -1 if old == "BLOCK, FLAG" else 1)
        path.write_text(text, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", CARRYING],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path), "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "['CRATE'] crate 0\n"
