"""What sleeps far from everything that moves is left out of the search for contacts, and no number changes by it."""

import copy
from contextlib import closing

import mujoco
import numpy as np
import pytest

import craftsim
from craftsim.cli.bench import pick
from craftsim.discrete.grid import Grid, Kind
from craftsim.models import stepping
from craftsim.models.distant import Distant, leave_out, put_back
from craftsim.models.parts import Joint
from craftsim.models.world import PhysicsWorld

LENGTH = 20


def depot() -> Grid:
    """Return cars at one end of a long area, others in their way, and rows, towers and slopes of which most are far."""
    grid = Grid.empty((LENGTH, 6, 3), 5)
    grid.cars[:, :4] = (0, 0, 1, 0), (0, 2, 1, 0), (2, 0, 1, 1), (0, 5, 1, 0), (4, 5, 1, 1)
    for x in range(2, LENGTH, 2):
        if x > 2:
            grid.kind[x, 0, 1] = Kind.BLOCK
        grid.kind[x, 2, 1] = Kind.BLOCK
        grid.kind[x, 2, 2] = Kind.BLOCK
    for x in range(3, LENGTH, 4):
        grid.kind[x, 4, 1] = Kind.FSLOPE
    grid.derive_marks()
    return grid


def states(physics: PhysicsWorld, periods: int) -> bytes:
    """Drive two cars ahead, into what stands in their way, and return all states."""
    seen = []
    physics.drive(0, [9.0] * 4)
    physics.drive(1, [9.0] * 4)
    physics.move_board(1, 0.05)
    for period in range(periods):
        if period == periods // 2:
            physics.drive(0, [0.0] * 4)
        physics.advance()
        for array in (physics.data.qpos, physics.data.qvel, physics.data.tree_asleep):
            seen.append(array.tobytes())
    return b"".join(seen)


def without(monkeypatch) -> None:
    """Have all bodies take part in the search."""
    monkeypatch.setattr(Distant, "is_on", False)


def test_cars_that_run_into_rows_and_towers_do_so_bit_for_bit(monkeypatch):
    seen = states(PhysicsWorld(depot()), 150)
    without(monkeypatch)
    assert seen == states(PhysicsWorld(depot()), 150)


def test_a_long_run_judges_again_what_can_be_reached(monkeypatch):
    """Within one run of steps a car drives to one that was out of reach, and pushes it."""

    def run() -> bytes:
        physics = PhysicsWorld(depot())
        physics.drive(3, [9.0] * 4)
        physics.advance()
        start = physics.data.qpos.copy()
        physics.run(900)
        pushed = physics.cars[4].base.qpos
        assert abs(physics.data.qpos[pushed] - start[pushed]) > 0.05
        return physics.data.qpos.tobytes()

    seen = run()
    without(monkeypatch)
    assert seen == run()


def test_what_can_be_reached_matters(monkeypatch):
    """A planted fault: machines without an extent are missed by what runs into them."""
    seen = states(PhysicsWorld(depot()), 150)
    physics = PhysicsWorld(depot())
    physics._stepping.distant.watched[0]["radius_m"] = 0.0
    assert seen != states(physics, 150)


@pytest.mark.parametrize("randomization", [None, "strong"])
@pytest.mark.parametrize("task", ["strip", "complex_two_story"])
def test_random_play_is_the_same_bit_for_bit(task, randomization, monkeypatch):
    def play() -> list[tuple[bytes, int]]:
        rng = np.random.default_rng(7)
        seen = []
        with closing(craftsim.parallel_env(task, "physics", randomization=randomization)) as env:
            observations, _ = env.reset(seed=7)
            for _ in range(12):
                masks = np.stack([each["action_mask"] for each in observations.values()])
                actions = dict(zip(env.agents, pick(rng, masks).tolist(), strict=True))
                observations = env.step(actions)[0]
                physics = env.core.backend.judge.physics
                seen.append((physics.data.qpos.tobytes(), physics.data.ncon))
        return seen

    seen = play()
    without(monkeypatch)
    assert seen == play()


def test_what_is_moved_or_pushed_from_outside_meets_what_sleeps(monkeypatch):
    """A sleeping block is raised over another one by hand, and a second one pushed against its neighbour."""

    def fall() -> bytes:
        physics = PhysicsWorld(depot())
        physics.advance()
        block = physics.blocks[-1]
        tower = physics.blocks[-4]
        assert physics.data.tree_asleep[block.tree] >= 0
        position, _ = physics.free_body_state(tower)
        position[2] += 0.5
        physics.data.qpos[block.qpos : block.qpos + 3] = position
        physics.data.xfrc_applied[physics.blocks[5].body, 1] = 60.0
        seen = []
        for _ in range(60):
            physics.advance()
            seen.append(physics.data.qpos.tobytes())
        return b"".join(seen)

    seen = fall()
    without(monkeypatch)
    assert seen == fall()


def lone_block(physics: PhysicsWorld) -> Joint:
    """Return the last block of the row without towers, which only the ground touches."""
    in_row = [block for block in physics.blocks if physics.data.qpos[block.qpos + 1] < 0.2]
    return in_row[-1]


def asleep_again(physics: PhysicsWorld, place: np.ndarray) -> None:
    """Move a lone block by hand, let it fall asleep there, and put it back to a place by hand."""
    block = lone_block(physics)
    pose = slice(block.qpos, block.qpos + 7)
    physics.data.qpos[block.qpos + 2] += 0.005
    for _ in range(40):
        physics.advance()
    assert physics.data.tree_asleep[block.tree] >= 0
    physics.data.qpos[pose] = place


def put_back_and_copied(physics: PhysicsWorld) -> PhysicsWorld:
    block = lone_block(physics)
    asleep_again(physics, physics.model.qpos0[block.qpos : block.qpos + 7])
    return copy.deepcopy(physics)


def put_back_and_restored(physics: PhysicsWorld) -> PhysicsWorld:
    block = lone_block(physics)
    at_rest = physics.save()
    asleep_again(physics, at_rest.data.qpos[block.qpos : block.qpos + 7])
    put_back = physics.save()
    physics.restore(at_rest)
    physics.run(1)
    physics.restore(put_back)
    return physics


def of_other_figures(physics: PhysicsWorld) -> PhysicsWorld:
    """Return the world with all hinges a tenth of a millimetre higher, which wakes slopes."""
    baseline = physics.compiled.copy()
    for slope in physics.slopes:
        hinge = physics.model.joint(slope.hinge.name)
        baseline.body_pos[physics.model.jnt_bodyid[hinge.id], 2] += 1e-4
    physics.set_baseline(baseline)
    return physics


def pushed_by_nothing(physics: PhysicsWorld) -> PhysicsWorld:
    """Return the world with a force of minus zero, by which MuJoCo wakes what it acts on."""
    physics.data.xfrc_applied[lone_block(physics).body] = -0.0
    return physics


def turned_back(physics: PhysicsWorld) -> PhysicsWorld:
    physics.data.qvel[:] *= -1
    return physics


def kept_awake(physics: PhysicsWorld) -> PhysicsWorld:
    never = int(mujoco.mjtSleepPolicy.mjSLEEP_AUTO_NEVER)
    physics.model.tree_sleep_policy[lone_block(physics).tree] = never
    return physics


@pytest.mark.parametrize(
    "change",
    [
        put_back_and_copied,
        put_back_and_restored,
        of_other_figures,
        pushed_by_nothing,
        turned_back,
        kept_awake,
    ],
)
def test_whatever_wakes_a_machine_finds_its_contacts(change, monkeypatch):
    def awakened() -> list[tuple[bytes, int]]:
        physics = PhysicsWorld(depot())
        physics.advance()
        physics = change(physics)
        seen = []
        for _ in range(20):
            physics.run(1)
            seen.append((physics.data.qpos.tobytes(), physics.data.ncon))
        return seen

    seen = awakened()
    without(monkeypatch)
    assert seen == awakened()


def test_releases_of_mujoco_without_batches_leave_out_the_same(monkeypatch):
    monkeypatch.setattr(stepping, "_HAS_BATCHES", False)
    physics = PhysicsWorld(depot())
    seen = states(physics, 40)
    without(monkeypatch)
    assert seen == states(PhysicsWorld(depot()), 40)


def test_an_error_in_a_step_leaves_the_model_whole():
    physics = PhysicsWorld(depot())
    whole = physics.model.body_contype.copy()
    physics.data.qpos[physics.cars[0].base.qpos] = np.nan
    physics.advance()
    assert physics.diverged
    assert (physics.model.body_contype == whole).all()


def test_most_is_left_out_while_steps_run_and_nothing_between_them():
    physics = PhysicsWorld(depot())
    physics.drive(0, [9.0] * 4)
    for _ in range(3):
        physics.advance()
    model = physics.model
    whole = model.body_contype.copy()
    n_bodies = int((whole != 0).sum())
    watched = physics._stepping.distant.watched
    trees = watched[0]
    leave_out(watched)
    assert trees["takes_part"].sum() < len(trees) / 3
    assert trees["takes_part"][physics.cars[0].base.tree]
    assert int((model.body_contype != 0).sum()) < n_bodies / 2
    put_back(watched)
    assert (model.body_contype == whole).all()


def test_a_machine_lies_in_the_sphere_around_it():
    """In any state of its joints: flaps open and closed, boards up and down."""
    physics = PhysicsWorld(depot())
    model = physics.model
    data = physics.data
    radii = physics._stepping.distant.watched[0]["radius_m"]
    for share in (0.0, 0.5, 1.0):
        for joint in np.flatnonzero(model.jnt_limited):
            low, high = model.jnt_range[joint]
            data.qpos[model.jnt_qposadr[joint]] = low + share * (high - low)
        spare = physics.awake_copy()
        for geom in np.flatnonzero(model.body_treeid[model.geom_bodyid] >= 0):
            tree = model.body_treeid[model.geom_bodyid[geom]]
            root = model.tree_bodyadr[tree]
            far_m = np.linalg.norm(spare.geom_xpos[geom] - spare.xpos[root])
            assert far_m + model.geom_rbound[geom] <= radii[tree] + 1e-9
    assert (radii < 0.6).all()
