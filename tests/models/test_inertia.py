"""Inertias follow from geometry at the published masses: MuJoCo's against those that trimesh computes."""

import mujoco
import numpy as np
import pytest
import trimesh

from craftsim.mjcf.parameters import NOMINAL

BLOCK, SLOPE, SMARTCAR = NOMINAL.block, NOMINAL.slope, NOMINAL.cars[0]


def solid_of(model: mujoco.MjModel, geom: str) -> trimesh.Trimesh:
    """Return a geom as a trimesh solid in the frame of its body."""
    g = model.geom(geom)
    match g.type[0]:
        case mujoco.mjtGeom.mjGEOM_BOX:
            solid = trimesh.creation.box(2 * g.size)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            solid = trimesh.creation.cylinder(g.size[0], 2 * g.size[1], sections=256)
        case _:
            mesh = model.mesh(g.dataid[0])
            start = mesh.vertadr[0]
            solid = trimesh.convex.convex_hull(model.mesh_vert[start : start + mesh.vertnum[0]])
    turn, place = np.empty(9), np.eye(4)
    mujoco.mju_quat2Mat(turn, g.quat)
    place[:3, :3], place[:3, 3] = turn.reshape(3, 3), g.pos
    return solid.apply_transform(place)


def of_solids(solids: list[tuple[trimesh.Trimesh, float]]) -> tuple[float, np.ndarray, np.ndarray]:
    """Return mass, centre of mass and inertia about it, of solids with their masses."""
    masses, centres = np.array([m for _, m in solids]), np.array([s.center_mass for s, _ in solids])
    centre = masses @ centres / masses.sum()
    inertia = np.zeros((3, 3))
    for (solid, mass), own in zip(solids, centres, strict=True):
        r = own - centre
        inertia += solid.moment_inertia * mass / solid.volume + mass * (r @ r * np.eye(3) - np.outer(r, r))
    return float(masses.sum()), centre, inertia


def of_bodies(model: mujoco.MjModel, bodies: list[int]) -> tuple[float, np.ndarray, np.ndarray]:
    """Return mass, centre of mass and inertia about it in the world frame, of bodies that move as one."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    masses, centres = model.body_mass[bodies], data.xipos[bodies]
    centre = masses @ centres / masses.sum()
    inertia = np.zeros((3, 3))
    for body, mass, own in zip(bodies, masses, centres, strict=True):
        turn, r = data.ximat[body].reshape(3, 3), own - centre
        inertia += turn @ np.diag(model.body_inertia[body]) @ turn.T
        inertia += mass * (r @ r * np.eye(3) - np.outer(r, r))
    return float(masses.sum()), centre, inertia


def uniform(model: mujoco.MjModel, geoms: list[str], mass: float) -> list[tuple[trimesh.Trimesh, float]]:
    solids = [solid_of(model, geom) for geom in geoms]
    volume = sum(s.volume for s in solids)
    return [(s, mass * s.volume / volume) for s in solids]


def assert_same(found: np.ndarray, expected: np.ndarray, band: float) -> None:
    """Compare inertia tensors: every entry to a fraction of the greatest."""
    assert np.abs(found - expected).max() < band * np.abs(expected).max()


def colliding(model: mujoco.MjModel, body: str) -> list[str]:
    ids = np.flatnonzero((model.geom_bodyid == model.body(body).id) & (model.geom_contype > 0))
    return [model.geom(g).name for g in ids]


def test_the_chassis_has_the_inertia_of_its_solid_hull(open_part):
    """The hull's own tensor at 1.0 kg, moved to the published centre of mass. Band: 0.5 %."""
    model = open_part("smartcar")
    mass, centre, inertia = of_bodies(model, [model.body("smartcar").id])
    _, _, expected = of_solids([(solid_of(model, "hull"), SMARTCAR.chassis_mass_kg)])
    assert mass == SMARTCAR.chassis_mass_kg
    assert centre == pytest.approx([0, 0, SMARTCAR.wheel_radius_m + SMARTCAR.chassis_com_m])
    assert_same(inertia, expected, 0.005)


def test_hub_and_rollers_make_a_solid_cylinder(open_part):
    """2.3 kg, radius 0.0496, width 0.043 (published), all solid. Band: 0.5 % and 10 micrometres."""
    for wheel in ("fl", "fr", "rl", "rr"):
        model = open_part("smartcar")
        names = [f"wheel_{wheel}"] + [f"roller_{wheel}{i:02}" for i in range(SMARTCAR.rollers_per_wheel)]
        mass, centre, inertia = of_bodies(model, [model.body(n).id for n in names])
        solid = trimesh.creation.cylinder(SMARTCAR.wheel_radius_m, SMARTCAR.wheel_width_m, sections=256)
        solid.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
        _, _, expected = of_solids([(solid, SMARTCAR.wheel_mass_kg)])
        assert mass == pytest.approx(SMARTCAR.wheel_mass_kg)
        assert np.abs(centre - model.body(f"wheel_{wheel}").pos).max() < 1e-5
        assert_same(inertia, expected, 0.005)


def test_a_table_has_the_inertia_of_its_deck_and_legs(open_part):
    """0.5 kg of deck and frame, randomization by volume, on four legs of 0.001 kg (published). Band: 0.1 %."""
    for part in ("block", "flag"):
        model = open_part(part)
        geoms = colliding(model, part)
        legs = [g for g in geoms if g.startswith("leg")]
        solids = uniform(model, [g for g in geoms if not g.startswith(("leg", "foot"))], BLOCK.deck_mass_kg)
        solids += [(solid_of(model, leg), BLOCK.leg_mass_kg) for leg in legs]
        mass, centre, inertia = of_solids(solids)
        found_mass, found_centre, found = of_bodies(model, [model.body(part).id])
        assert len(legs) == 4
        assert found_mass == pytest.approx(mass, abs=1e-5)
        assert np.abs(found_centre - centre).max() < 1e-5
        assert_same(found, inertia, 0.001)


def test_the_slopes_bodies_are_uniform_solids(open_part):
    """Base 1.0 kg, flap 0.1 kg (published), randomization by volume over convex solids. Band: 0.2 %."""
    for body, mass_kg in (("slope", SLOPE.base_mass_kg), ("flap", SLOPE.flap_mass_kg)):
        model = open_part("slope")
        mass, centre, inertia = of_solids(uniform(model, colliding(model, body), mass_kg))
        found_mass, found_centre, found = of_bodies(model, [model.body(body).id])
        origin = model.body("flap").pos if body == "flap" else np.zeros(3)
        assert found_mass == pytest.approx(mass, abs=1e-5)
        assert np.abs(found_centre - origin - centre).max() < 1e-4
        assert_same(found, inertia, 0.002)


def test_the_whole_car_is_balanced_and_low(open_part):
    """10.3 kg; the centre of mass lies in the middle, just below the axles: chassis low, board high.

    (1.0 (-0.025) + 0.1 (0.053 - 0.0015) + 9.2 x 0) / 10.3 = -1.93 mm from the axle line. Band: 0.05 mm.
    """
    model = open_part("smartcar")
    mass, centre, _ = of_bodies(model, list(range(1, model.nbody)))
    board = SMARTCAR.board_top_m - SMARTCAR.board_thickness_m / 2
    moment = SMARTCAR.chassis_mass_kg * SMARTCAR.chassis_com_m + SMARTCAR.board_mass_kg * board
    assert mass == pytest.approx(SMARTCAR.mass_kg, abs=1e-6)
    height = SMARTCAR.wheel_radius_m + moment / SMARTCAR.mass_kg
    assert np.abs(centre - [0, 0, height]).max() < 5e-5
