"""Physics that is drawn, and machines that are made a little off: as declared, in place, and taken back exactly."""

import math
from dataclasses import fields, replace
from itertools import product

import mujoco
import numpy as np
import pytest
from discrete.drawn import draw
from scipy.stats import kstest, uniform

from craftsim.discrete.grid import Grid, Kind
from craftsim.errors import InputError
from craftsim.mjcf.car import ACROSS
from craftsim.mjcf.drives import DRIVES, Drive
from craftsim.mjcf.machines import NOMINAL
from craftsim.models import randomization
from craftsim.models.config import SimulationConfig
from craftsim.models.effects import Drivetrain
from craftsim.models.floor import Floor
from craftsim.models.randomization import (
    NONE,
    DomainRandomization,
    Making,
    _vary_bodies,
    by_name,
    randomize,
)
from craftsim.models.sensing import SensorNoise
from craftsim.models.world import PhysicsWorld

RANDOMIZED = DomainRandomization()


def _grid() -> Grid:
    """Return two cars, one of them loaded, with a block, a flag and a slope."""
    grid = Grid.empty((4, 3, 2), 2)
    grid.cars[:, :5] = [(0, 0, 1, 0, Kind.AIR), (3, 0, 1, 1, Kind.BLOCK)]
    grid.kind[0, 2, 1], grid.kind[3, 2, 1] = Kind.BLOCK, Kind.FLAG
    grid.kind[1, 1, 1], grid.kind[2, 1, 1] = Kind.FSLOPE, Kind.GEAR
    grid.derive_marks()
    return grid


def _figures(model) -> dict[str, np.ndarray]:
    """Return copies of every array of a model and of its options."""
    arrays = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    arrays |= {
        f"opt.{name}": getattr(model.opt, name)
        for name in dir(model.opt)
        if not name.startswith("_")
    }
    return {
        name: np.array(a) for name, a in arrays.items() if isinstance(a, np.ndarray | int | float)
    }


@pytest.fixture
def varied() -> PhysicsWorld:
    return PhysicsWorld(_grid())


def _ratios(varied: PhysicsWorld, *names: str) -> list[np.ndarray]:
    """Return for each name (8, ...): the figures drawn from so many seeds over the nominal ones that are not 0."""
    nominal = [getattr(varied.model, name).copy() for name in names]
    drawn = []
    for seed in range(8):
        randomize(varied, RANDOMIZED, np.random.default_rng(seed))
        drawn.append([getattr(varied.baseline, name).copy() for name in names])
    return [
        np.array(values)[:, one != 0] / one[one != 0]
        for values, one in zip(zip(*drawn, strict=True), nominal, strict=True)
    ]


def test_every_kind_of_figure_stays_within_its_range_and_uses_it(varied):
    widths = {
        "geom_friction": RANDOMIZED.friction,
        "body_mass": RANDOMIZED.mass,
        "body_inertia": RANDOMIZED.mass,
        "actuator_forcerange": RANDOMIZED.motor,
        "actuator_gainprm": RANDOMIZED.motor,
        "actuator_biasprm": RANDOMIZED.motor,
        "dof_frictionloss": RANDOMIZED.joint_friction,
        "dof_damping": RANDOMIZED.joint_friction,
    }
    for (name, width), ratios in zip(widths.items(), _ratios(varied, *widths), strict=True):
        off = ratios - 1
        assert abs(off).max() <= width + 1e-12, name
        assert off.max() > 0.6 * width, name
        assert off.min() < -0.6 * width, name


def test_one_material_of_one_machine_has_one_friction_and_others_have_their_own(varied):
    model, nominal = varied.model, varied.model.geom_friction.copy()
    surfaces = np.column_stack([model.body_rootid[model.geom_bodyid], nominal[:, 0]])
    materials, material = np.unique(surfaces, axis=0, return_inverse=True)
    randomize(varied, RANDOMIZED, np.random.default_rng(4))
    factor = np.round(model.geom_friction[:, 0] / nominal[:, 0], 12)
    drawn = [set(factor[material.reshape(-1) == i]) for i in range(len(materials))]
    assert all(len(values) == 1 for values in drawn)
    assert len(set().union(*drawn)) == len(materials) > 5
    np.testing.assert_array_equal(
        model.geom_friction[:, 1:], nominal[:, 1:], "only sliding friction is drawn"
    )


def test_mass_and_inertia_of_all_parts_of_a_machine_scale_alike(varied):
    model = varied.model
    mass, inertia, whole = (
        model.body_mass.copy(),
        model.body_inertia.copy(),
        model.body_subtreemass.copy(),
    )
    randomize(varied, RANDOMIZED, np.random.default_rng(1))
    heavy = mass > 0
    factor = model.body_mass[heavy] / mass[heavy]
    np.testing.assert_allclose(
        model.body_inertia[heavy], inertia[heavy] * factor[:, None], rtol=1e-12
    )
    roots = model.body_rootid[heavy]
    for root in set(roots.tolist()):
        np.testing.assert_allclose(factor[roots == root], factor[roots == root][0], rtol=1e-12)
    assert len({round(float(f), 9) for f in factor}) == len(set(roots.tolist())) == 6
    # What MuJoCo derives from masses follows.
    machines = [b for b in range(1, model.nbody) if model.body_rootid[b] == b and whole[b] > 0]
    for body in machines:
        own = model.body_rootid == body
        assert model.body_subtreemass[body] == pytest.approx(model.body_mass[own].sum(), rel=1e-12)
    assert model.body_subtreemass[0] == pytest.approx(model.body_mass.sum(), rel=1e-12)
    assert model.body_subtreemass[0] != pytest.approx(whole[0], rel=1e-4)


def test_a_draw_of_zero_width_is_nominal_restoring_is_exact_and_draws_do_not_add_up(varied):
    model, before, state = varied.model, _figures(varied.model), varied.data.qpos.copy()
    randomize(varied, NONE, np.random.default_rng(0))
    for name, value in _figures(model).items():
        np.testing.assert_allclose(value, before[name], rtol=1e-12, atol=1e-15, err_msg=name)
    once = None
    for seed in (3, 8, 3):
        randomize(varied, RANDOMIZED, np.random.default_rng(seed))
        once = once or _figures(model)
        for body in (
            *(car.base for car in varied.cars),
            *varied.tables,
            *(s.base for s in varied.slopes),
        ):
            at = slice(body.qpos, body.qpos + 3)
            assert np.linalg.norm(varied.data.qpos[at] - state[at]) < 1e-3, (
                "it stands where it stood"
            )
    changed = {
        name for name, value in _figures(model).items() if not np.array_equal(value, before[name])
    }
    assert {
        "body_mass",
        "geom_friction",
        "opt.gravity",
        "dof_damping",
        "body_subtreemass",
    } <= changed
    for name, value in _figures(model).items():
        np.testing.assert_array_equal(value, once[name], err_msg=name)
    varied.reset_compiled()
    for name, value in _figures(model).items():
        np.testing.assert_array_equal(value, before[name], err_msg=name)
    np.testing.assert_array_equal(varied.data.qpos, state)


def test_a_width_that_cannot_be_is_refused_by_its_name():
    for kind in (DomainRandomization, Making, Drivetrain, Floor, SensorNoise):
        for name, value in product(
            (f.name for f in fields(kind)), (-1e-9, 1.0, math.nan, math.inf)
        ):
            with pytest.raises(
                InputError, match=f"{kind.__name__}.{name}: (must be|.* is out of range)"
            ):
                kind(**{name: value})


def _drawn(grid: Grid, drive: Drive = "rollers", seed: int = 5) -> dict[str, np.ndarray]:
    """Return factors by machine: of mass, of friction by coefficient, of motors and joints by their names."""
    physics = PhysicsWorld(
        grid, SimulationConfig(settle_s=0), machines=replace(NOMINAL, drive=drive)
    )
    model, nominal = physics.model, physics.compiled
    randomize(physics, RANDOMIZED, np.random.default_rng(seed))
    drawn = {}
    for name, geom in ((model.geom(i).name, i) for i in range(model.ngeom)):
        machine, coefficient = name.partition("/")[0], nominal.geom_friction[geom, 0]
        drawn[f"{machine} {coefficient}"] = physics.baseline.geom_friction[geom, 0] / coefficient
    for name, body in ((model.body(i).name, i) for i in range(model.nbody)):
        if nominal.body_mass[body] > 0:
            drawn[f"{name.partition('/')[0]} mass"] = (
                physics.baseline.body_mass[body] / nominal.body_mass[body]
            )
    for name, motor in ((model.actuator(i).name, i) for i in range(model.nu)):
        drawn[name] = (
            physics.baseline.actuator_gainprm[motor, 0] / nominal.actuator_gainprm[motor, 0]
        )
    for name, dof in ((model.joint(model.dof_jntid[i]).name, i) for i in range(model.nv)):
        if nominal.dof_frictionloss[dof]:
            drawn[f"{name} rubs"] = (
                physics.baseline.dof_frictionloss[dof] / nominal.dof_frictionloss[dof]
            )
    return {name: float(factor) for name, factor in drawn.items()} | {
        "g": physics.baseline.gravity[0]
    }


def test_both_drives_draw_the_same_from_one_seed():
    rollers, wheels = _drawn(_grid(), "rollers"), _drawn(_grid(), "wheels")
    alone = {name for name in rollers if "/roller_" in name}
    assert len(alone) == 80
    assert {name: rollers[name] for name in rollers.keys() - alone} == pytest.approx(
        wheels, rel=1e-12
    )
    assert len(wheels) == 12 + 6 + 11 + 11 + 1


def test_another_machine_changes_nothing_of_what_is_drawn_of_the_others():
    fewer = _grid()
    fewer.kind[3, 2, 1] = fewer.kind[1, 1, 1] = fewer.kind[2, 1, 1] = Kind.AIR
    fewer.derive_marks()
    some, every = _drawn(fewer), _drawn(_grid())
    assert {name.split("0")[0] for name in every.keys() - some.keys()} == {"flag", "slope"}
    assert every.items() >= some.items()


def test_what_is_drawn_has_the_declared_distributions():
    """Kolmogorov and Smirnov's test of 400 seeds each: right ones would fail for one choice of seeds in 100."""
    physics = PhysicsWorld(Grid.empty((2, 1, 1), 1), SimulationConfig(settle_s=0))
    car, board = physics.cars[0].base, physics.cars[0].board
    tyre, gear = physics.model.geom("car0/tyre_fl").id, physics.cars[0].wheel_dofs[0]
    figures = (
        ("body_mass", car.body, RANDOMIZED.mass),
        ("geom_friction", (tyre, 0), RANDOMIZED.friction),
        ("geom_user", (tyre, ACROSS), RANDOMIZED.joint_friction),
        ("geom_friction", (physics.model.geom("ground").id, 0), RANDOMIZED.friction),
        ("actuator_gainprm", (board.actuator, 0), RANDOMIZED.motor),
        ("dof_frictionloss", board.dof, RANDOMIZED.joint_friction),
        ("dof_frictionloss", gear, RANDOMIZED.joint_friction),
    )
    rows = []
    for seed in range(400):
        randomize(physics, RANDOMIZED, np.random.default_rng(seed))
        off = [
            (getattr(physics.baseline, name)[at] / getattr(physics.compiled, name)[at] - 1) / width
            for name, at, width in figures
        ]
        length = np.linalg.norm(physics.baseline.gravity)
        assert length == pytest.approx(9.81, rel=1e-12)
        across = physics.baseline.gravity[:2] / length
        tilt = 2 * (math.asin(np.hypot(*across)) / RANDOMIZED.tilt_rad) ** 2 - 1
        rows.append([*off, tilt, math.atan2(across[1], across[0]) / math.pi])
    drawn = np.array(rows)
    for column in drawn.T:
        assert kstest(column, uniform(-1, 2).cdf).pvalue > 1e-3
    # What has names of its own is drawn by itself.
    assert np.abs(np.corrcoef(drawn.T) - np.eye(9)).max() < 0.2


CAR = NOMINAL.cars[0]
WHEELS, NOTHING = ("fl", "fr", "rl", "rr"), 1e-12


class Largest:
    """Draws the upper end of everything."""

    def uniform(self, low: float = 0.0, high: float = 1.0, size: object = None) -> object:
        return high if size is None else np.full(size, high)


@pytest.fixture
def largest(monkeypatch):
    """Let every figure be drawn at the upper end."""
    monkeypatch.setattr(randomization, "by_name", lambda rng: lambda machine, figure: Largest())


def _world(drive="wheels", objects=(), load=Kind.AIR) -> PhysicsWorld:
    grid = draw((5, 3, 2), objects, [(0, 1, 1, 0, load, 0, 0)])
    return PhysicsWorld(grid, machines=replace(NOMINAL, drive=drive), reset=False)


def _made(world: PhysicsWorld, seed: int = 0, **making: float) -> PhysicsWorld:
    randomize(world, replace(NONE, making=Making(**making)), np.random.default_rng(seed))
    return world


def _driven(world: PhysicsWorld, wheels, periods: int) -> tuple[np.ndarray, float]:
    """Return the place and the heading of the car at the end."""
    world.drive(0, wheels)
    for _ in range(periods):
        world.advance()
    place, (w, _, _, z) = world.free_body_state(world.cars[0].base)
    return place, float(2 * np.arctan2(z, w))


def _wheels(world: PhysicsWorld) -> tuple[np.ndarray, np.ndarray]:
    """Return radii (4,) and places (4, 2) of the wheels, as their shapes in the model have them."""
    model = world.model
    bodies = model.dof_bodyid[world.cars[0].wheel_dofs]
    if world.machines.drive == "wheels":
        geoms = [model.geom(f"car0/tyre_{wheel}").id for wheel in WHEELS]
        return model.geom_size[geoms, 0], model.body_pos[bodies, :2]
    rollers = [
        np.linalg.norm(model.body_pos[model.body_parentid == body], axis=1).mean()
        for body in bodies
    ]
    return np.array(rollers) + CAR.roller_radius_m, model.body_pos[bodies, :2]


@pytest.mark.parametrize("drive", DRIVES)
def test_a_car_with_larger_wheels_stands_higher_and_gets_further(drive, largest):
    """All four larger by 1 mm, 2.0 % of their radius: 2.0 % further."""
    world, ways, heights = _world(drive), [], []
    for more in (NOTHING, 0.001):
        _made(world, wheel_radius_m=more)
        heights.append(world.free_body_state(world.cars[0].base)[0][2])
        begun = _driven(world, [8.0] * 4, 40)[0][0]
        ways.append(_driven(world, [8.0] * 4, 40)[0][0] - begun)
    assert ways[1] / ways[0] == pytest.approx(1 + 0.001 / CAR.wheel_radius_m, abs=0.003)
    assert heights[1] - heights[0] == pytest.approx(0.001, abs=1e-4)


@pytest.mark.parametrize("drive", DRIVES)
def test_unequal_wheels_turn_a_car(drive):
    world, headings = _world(drive), []
    for tolerance in (NOTHING, 0.0002):
        radii, _ = _wheels(_made(world, wheel_radius_m=tolerance))
        assert abs(radii - CAR.wheel_radius_m).max() <= tolerance
        assert len(np.unique(radii)) == 4
        headings.append(abs(_driven(world, [8.0] * 4, 100)[1]))
    assert headings[1] > max(0.002, 2 * headings[0])


@pytest.mark.parametrize("drive", DRIVES)
def test_a_car_with_a_longer_wheelbase_and_track_turns_less(drive):
    world, turned, levers = _world(drive), [], []
    for seed in range(3):
        _, places = _wheels(_made(world, seed, wheel_place_m=0.008))
        levers.append(np.abs(places).sum(axis=1).mean())
        turned.append(_driven(world, [-6.0, 6.0, -6.0, 6.0], 50)[1])
    assert np.ptp(levers) > 0.001
    assert (np.argsort(levers) == np.argsort(turned)[::-1]).all()
    np.testing.assert_allclose(
        np.array(turned) * levers, np.mean(turned) * np.mean(levers), rtol=0.01
    )


def test_a_board_that_is_too_high_carries_its_load_higher_and_a_higher_pocket_lower(largest):
    """By up to the 1 mm that a boss leaves below the deck."""
    world = _world(load=Kind.BLOCK)
    for name, more, sign in (("board_m", 0.002, 1), ("underside_m", 0.0008, -1)):
        both = (_made(world, **{name: size}) for size in (NOTHING, more))
        heights = [made.free_body_state(made.blocks[0])[0][2] for made in both]
        assert heights[1] - heights[0] == pytest.approx(sign * more, abs=5e-5)


def test_a_load_sits_off_its_car_by_as_much_as_its_pocket_is_off(largest):
    """Within the play of 0.1 mm to each side, and of board and boss alike."""
    for name, sign in (("pocket_m", -1), ("board_place_m", 1)):
        world = _made(_world(load=Kind.BLOCK), **{name: 0.003})
        place, _ = _driven(world, [0.0] * 4, 50)
        off = world.free_body_state(world.blocks[0])[0] - place
        assert off[:2] == pytest.approx(2 * [sign * 0.003], abs=0.3e-3)


def test_a_block_with_uneven_feet_leans():
    world, leans = _world(objects=[(Kind.BLOCK, (2, 1, 1))]), []
    for seed in range(4):
        _, (_, x, y, _) = _made(world, seed, foot_m=0.002).free_body_state(world.blocks[0])
        leans.append(2 * np.hypot(x, y))
        feet = [world.model.geom(f"block0/foot_{corner}").pos[2] for corner in WHEELS]
        assert abs(np.array(feet) - NOMINAL.block.foot_radius_m).max() <= 0.002
    # Two diagonal feet of 0.44 m, each off by up to 2 mm, lean it by up to 9 mrad.
    assert 1e-3 < max(leans) < 0.01


@pytest.mark.parametrize("drive", DRIVES)
def test_every_tolerance_changes_the_shapes_that_touch_and_is_taken_back(drive):
    """None of these shapes shares its frame with its body: MuJoCo would take the body's for it, whatever its place."""
    world = _world(drive, [(Kind.BLOCK, (2, 1, 1)), (Kind.FSLOPE, (3, 1, 1), 0)])
    world.reset_compiled()
    model, shapes = world.model, ("geom_pos", "geom_size", "body_pos")
    drawn = ["block0/foot_fl", "block0/frame_front", "block0/frame_left"]
    for name in drawn:
        assert model.geom_sameframe[model.geom(name).id] == int(
            mujoco.mjtSameFrame.mjSAMEFRAME_BODYROT
        )
    before = {
        n: getattr(model, n).copy() for n in (*shapes, "actuator_gear", "bvh_aabb", "geom_rbound")
    }
    for name in [field.name for field in fields(Making)]:
        _made(world, **{name: 0.001})
        assert any(not np.array_equal(getattr(model, n), before[n]) for n in shapes)
        world.reset_compiled()
        for n, array in before.items():
            np.testing.assert_array_equal(getattr(model, n), array, err_msg=n)


def test_a_geom_less_changes_nothing_of_what_is_drawn():
    """Friction and mass of what is left, of a car whose geom of another friction goes, and of the block after it."""

    def factors(names: tuple[str, ...]) -> dict[str, float]:
        spec = mujoco.MjSpec()
        for machine in ("car0/smartcar", "block0/block"):
            body = spec.worldbody.add_body(name=machine)
            body.add_freejoint(name=machine)
            for number, name in enumerate(names if machine.startswith("car") else ("foot", "leg")):
                geom = body.add_geom(name=f"{machine}/{name}", size=[0.1, 0, 0])
                geom.friction[0] = (0.4, 0.8, 0.3)[("foot", "leg", "guard").index(name)]
                geom.pos[0] = number
        model = spec.compile()
        before = model.geom_friction[:, 0].copy(), model.body_mass.copy()
        _vary_bodies(model, RANDOMIZED, by_name(np.random.default_rng(2)))
        rubs, weighs = model.geom_friction[:, 0] / before[0], model.body_mass[1:] / before[1][1:]
        found = {model.geom(i).name: float(rubs[i]) for i in range(model.ngeom)}
        return found | {model.body(i + 1).name: float(weighs[i]) for i in range(2)}

    every, less = factors(("guard", "foot", "leg")), factors(("foot", "leg"))
    assert every.pop("car0/smartcar/guard")
    assert less == pytest.approx(every, rel=1e-12)
    assert len({round(one, 9) for one in less.values()}) == 6


def _after_a_second(seed) -> np.ndarray:
    varied = PhysicsWorld(_grid())
    physics, model, data = varied, varied.model, varied.data
    randomize(varied, RANDOMIZED, np.random.default_rng(seed))
    assert physics.model is model
    assert physics.data is data
    physics.drive(0, [3.0, 3.0, 3.0, 3.0])
    physics.drive(1, [-2.0, 2.0, -2.0, 2.0])
    for _ in range(50):
        physics.advance()
    assert not data.warning.number[: mujoco.mjtWarning.mjNWARNING].any()
    return np.concatenate([data.qpos, data.qvel, data.act])


def test_equal_seeds_are_equal_bit_for_bit_after_a_second_and_other_seeds_are_not():
    first, again, other = (_after_a_second(seed) for seed in (7, 7, 8))
    np.testing.assert_array_equal(first, again)
    assert abs(first - other).max() > 1e-5
