"""Parts and worlds as they are composed: shapes, inertias, what is only seen, random control, and URDF."""

from dataclasses import replace
from importlib.resources import as_file, files
from pathlib import Path
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np
import pytest
import trimesh
from discrete.drawn import draw

from craftsim.cli import main
from craftsim.discrete.files.blueprint import read_blueprint
from craftsim.discrete.grid import Grid, Kind
from craftsim.errors import InputError
from craftsim.mjcf.block import TABLES
from craftsim.mjcf.building import TOUCHES
from craftsim.mjcf.drives import Drive
from craftsim.mjcf.machines import NOMINAL, Machines
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.models.composition import compile_spec, machine_spec, world_spec
from craftsim.models.config import SimulationConfig
from craftsim.models.exporting import LACKS, write_urdf
from craftsim.models.floor import FLAT, Floor
from craftsim.models.world import PhysicsWorld

GOALS = ((0, 0, 1), (1, 1, 2))
ORDERED = {
    "body": "body",
    "jnt": "joint",
    "actuator": "actuator",
    "dof": None,
    "pair": None,
    "tree": None,
}
"""What both worlds have in the same order, by the prefix of its arrays."""

NOT_PHYSICS = (
    "adr",
    "geomnum",
    "bvhnum",
    "user",
    "plugin",
    "pair_geom1",
    "pair_geom2",
    "signature",
    "trnid",
)


def _grid() -> Grid:
    return draw(
        (4, 4, 2),
        [
            *((Kind.WALL, (0, 0, 1), 0), (Kind.BLOCK, (0, 1, 1), 0), (Kind.FLAG, (1, 1, 1), 0)),
            *((Kind.BODY, (0, 2, 1), 0), (Kind.FSLOPE, (0, 3, 1), 0)),
        ],
        [(3, 0, 1, 0, 0, 0, 0), (3, 1, 1, 2, 0, 0, 0)],
    )


def _machines(drive: Drive) -> Machines:
    return replace(
        NOMINAL, cars=(SmartcarParameters(), SmartcarParameters(chassis_mass_kg=1.4)), drive=drive
    )


def test_what_is_only_seen_changes_no_number():
    """But how large MuJoCo takes bodies to be (``dof_length``), which decides when what hardly turns may sleep."""
    for drive in ("rollers", "wheels"):
        for floor in (FLAT, Floor(lippage_m=0.001)):
            config = replace(SimulationConfig(), sleep=False)
            world = _grid(), config, _machines(drive), GOALS, floor
            bare, seen = (
                compile_spec(world_spec(*world, visual=visual)) for visual in (False, True)
            )
            assert (bare.ncam, bare.nlight, bare.ntex) == (0, 0, 0)
            assert bare.ngeom < seen.ngeom
            geoms = [seen.geom(bare.geom(i).name).id for i in range(bare.ngeom)]
            assert geoms == np.flatnonzero(seen.geom_contype | seen.geom_conaffinity).tolist(), (
                "none is only seen, in order"
            )
            for name in dir(bare):
                kind = name.split("_")[0]
                if (
                    kind not in ("geom", *ORDERED)
                    or "_" not in name
                    or name.endswith(NOT_PHYSICS)
                    or name in ("geom_dataid", "geom_matid", "dof_length")
                ):
                    continue
                one, other = (np.asarray(getattr(model, name)) for model in (bare, seen))
                assert np.array_equal(one, other[geoms] if kind == "geom" else other), name
            assert np.array_equal(bare.qpos0, seen.qpos0)
            assert bare.stat.meaninertia == seen.stat.meaninertia
            ends = []
            for model in (bare, seen):
                data = mujoco.MjData(model)
                for step in range(150):
                    data.ctrl[:] = np.sin(step / 20 + np.arange(model.nu))
                    mujoco.mj_step(model, data)
                ends.append(np.concatenate([data.qpos, data.qvel, data.qacc_warmstart]))
            assert np.array_equal(*ends)


def test_equal_machines_share_their_meshes():
    grid = Grid.empty((4, 4, 1), 1)
    grid.kind[1:, 1:, 1] = Kind.BLOCK
    model = world_spec(grid, SimulationConfig()).compile()
    assert sum("block" in model.mesh(i).name for i in range(model.nmesh)) == 2


def test_worlds_of_one_grid_share_nothing():
    grid = Grid.empty((4, 3, 1), 1)
    first, second = PhysicsWorld(grid, reset=False), PhysicsWorld(grid, reset=False)
    first.model.geom_friction[:] = 0.25
    grid.cars[0, 0] = 3
    assert second.model.geom_friction.max() > 0.5
    assert first.seen_model().qpos0[0] == second.model.qpos0[0] < 1


def test_a_kind_without_a_machine_is_refused(monkeypatch):
    monkeypatch.delitem(TABLES, Kind.FLAG)
    with pytest.raises(InputError, match=r"FLAG in \(1, 1, 1\) has no machine"):
        PhysicsWorld(_grid())


SMARTCAR = NOMINAL.cars[0]
PARTS = ("ground", "block", "flag", "wall", "slope", "smartcar")


def control_randomly(model: mujoco.MjModel, data: mujoco.MjData, seed: int, warned) -> None:
    """Run 1 s; every 20 ms each motor gets a new command from its whole range."""
    rng = np.random.default_rng(seed)
    low, high = model.actuator_ctrlrange.T
    for _ in range(50):
        data.ctrl[:] = rng.uniform(low, high)
        mujoco.mj_step(model, data, round(0.02 / model.opt.timestep))
    assert {name: n for name, n in warned(data).items() if n} == {}
    for array in (data.qpos, data.qvel, data.qacc):
        assert np.isfinite(array).all()
    assert np.abs(data.qvel).max(initial=0) < 1e3


def test_each_part_opens_alone_rests_where_it_is_drawn_and_survives_random_control(
    open_part, warned
):
    """No part starts in the air or in the floor: within 1 s of rest nothing moves by more than 0.1 mm."""
    for seed, name in enumerate(PARTS):
        model = open_part(name)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        start = data.xpos.copy()
        mujoco.mj_step(model, data, 250)
        assert np.abs(data.xpos - start).max() < 1e-4
        control_randomly(model, data, seed, warned)


def test_the_demo_scene_survives_random_control(warned):
    with as_file(files("craftsim.data")) as data:
        drawing = read_blueprint(data / "blueprints" / "simple_two_story.yaml")
    physics = PhysicsWorld(drawing.grid(np.random.default_rng(0)), goals=[(2, 3, 1)])
    control_randomly(physics.model, physics.data, 0, warned)


def test_ten_rollers_a_wheel_in_x_arrangement_turn_freely_and_alone_carry_the_car(open_part):
    """Seen from above the upper rollers point at the car's centre; those on the ground lie across that line.

    On the floor a resting car touches the ground with one roller of each wheel or two, and with nothing else.
    """
    model = open_part("smartcar")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for wheel in ("fl", "fr", "rl", "rr"):
        names = [f"roller_{wheel}{i:02}" for i in range(10)]
        angles = np.sort(
            [np.arctan2(p[0], p[2]) % (2 * np.pi) for p in (model.body(n).pos for n in names)]
        )
        assert np.diff(angles) == pytest.approx(2 * np.pi / 10, abs=1e-6)
        rollers = [data.joint(name) for name in names]
        corner = np.sign(model.body(f"wheel_{wheel}").pos[:2]) / np.sqrt(2)
        bottom, *_, top = sorted(rollers, key=lambda roller: roller.xanchor[2])
        assert abs(top.xaxis[:2] @ corner) == pytest.approx(1, abs=1e-6)
        assert bottom.xaxis[:2] @ corner == pytest.approx(0, abs=1e-6)
        assert bottom.xanchor[2] == pytest.approx(SMARTCAR.roller_radius_m, abs=1e-9)
        for joint in map(model.joint, names):
            assert not joint.limited[0]
            assert model.dof_frictionloss[joint.dofadr[0]] == SMARTCAR.roller_bearing_friction_nm
            assert joint.id not in model.actuator_trnid[:, 0]
    mujoco.mj_step(model, data, 100)
    touching = {model.geom(g).name for g in data.contact.geom.flat} - {"ground"}
    assert {name[:9] for name in touching} == {f"roller_{w}" for w in ("fl", "fr", "rl", "rr")}


def _assert_same(read: mujoco.MjModel, own: mujoco.MjModel) -> None:
    """Compare bodies, joints, masses, inertias and ranges; band: 1e-6 of SI units."""
    plain = [own.body(i).name.replace("/", "_") for i in range(1, own.nbody)]
    assert [read.body(i).name for i in range(1, read.nbody)] == plain
    assert read.jnt_type.tolist() == own.jnt_type.tolist()
    for name in (
        "body_mass",
        "body_pos",
        "jnt_range",
        "jnt_axis",
        "dof_damping",
        "dof_frictionloss",
    ):
        assert getattr(read, name) == pytest.approx(getattr(own, name), abs=1e-6), name
    ends = [mujoco.MjData(model) for model in (read, own)]
    for model, data in zip((read, own), ends, strict=True):
        mujoco.mj_forward(model, data)
    assert ends[0].xpos == pytest.approx(ends[1].xpos, abs=1e-6)
    assert ends[0].xmat == pytest.approx(ends[1].xmat, abs=1e-6)
    assert ends[0].xipos == pytest.approx(ends[1].xipos, abs=1e-6)
    # The principal axes may come in another order.
    one, other = (
        np.einsum(
            "bij,bj,bkj->bik",
            data.ximat.reshape(-1, 3, 3),
            model.body_inertia,
            data.ximat.reshape(-1, 3, 3),
        )
        for model, data in zip((read, own), ends, strict=True)
    )
    assert one == pytest.approx(other, abs=1e-6)


def _free(path: Path) -> mujoco.MjSpec:
    """Return what MuJoCo reads in a file: it fixes the root, which other simulators leave free, to the world."""
    spec = mujoco.MjSpec.from_file(str(path))
    root = spec.worldbody.first_body()
    if "world" not in {link.get("name") for link in Xml.parse(path).iter("link")}:
        root.add_freejoint()
    return spec


def test_mujoco_reads_the_same_machine(tmp_path):
    rollers = replace(NOMINAL, drive="rollers")
    names = ("smartcar", "slope", "block", "flag", "wall")
    guards = TOUCHES["guards"]["contype"]
    for machine, machines in [*((name, NOMINAL) for name in names), ("smartcar", rollers)]:
        written = write_urdf(tmp_path / "own.urdf", machine_spec(machine, machines))
        assert written[0] == tmp_path / "own.urdf"
        own = machine_spec(machine, machines).compile()
        read = _free(written[0]).compile()
        _assert_same(read, own)
        # Guards stand in for wheels between cars alone, which URDF cannot say.
        solid = ((own.geom_contype | own.geom_conaffinity) != 0) & (own.geom_contype != guards)
        assert read.ngeom == np.count_nonzero(solid & (own.geom_bodyid > 0))


def test_a_world_is_written_with_everything_where_it_stands(tmp_path):
    grid = draw(
        (4, 3, 2),
        [(Kind.WALL, (0, 0, 1), 0), (Kind.BODY, (1, 1, 1), 0)],
        [(3, 0, 1, 2), (3, 2, 1, 1)],
    )
    world = world_spec(grid, SimulationConfig())
    own = world.compile()
    *written, table = write_urdf(tmp_path / "own.urdf", world)
    files = [file for file in written if file.suffix == ".urdf"]
    rows = table.read_text(encoding="utf-8").splitlines()[1:]
    assert [row.split(",")[0] for row in rows] == [file.name for file in files]
    whole = mujoco.MjSpec()
    for row, file in zip(rows, files, strict=True):
        x, y, z, roll, pitch, yaw = map(float, row.split(",")[1:])
        machine = _free(file)
        root = machine.worldbody.first_body()
        root.pos = [x, y, z]
        mujoco.mju_euler2Quat(root.quat, np.array([roll, pitch, yaw]), "XYZ")
        whole.attach(machine, frame=whole.worldbody.add_frame(), prefix=f"{file.stem}/")
    read = whole.compile()
    assert read.nbody == own.nbody
    assert read.body_mass == pytest.approx(own.body_mass)
    ends = [mujoco.MjData(model) for model in (read, own)]
    for model, data in zip((read, own), ends, strict=True):
        mujoco.mj_forward(model, data)
    assert ends[0].xpos == pytest.approx(ends[1].xpos, abs=1e-6)
    assert ends[0].xmat == pytest.approx(ends[1].xmat, abs=1e-6)


def test_limits_are_those_of_the_motors_and_the_file_says_what_it_lacks(tmp_path):
    path, _ = write_urdf(tmp_path / "car.urdf", machine_spec("smartcar", NOMINAL))
    robot, car = Xml.parse(path).getroot(), NOMINAL.cars[0]
    limits = {joint.get("name"): joint.find("limit") for joint in robot.findall("joint")}
    board, wheel = (limits[name].attrib for name in ("board", "wheel_fl"))
    assert (float(board["effort"]), float(board["velocity"])) == (
        car.board_force_n,
        car.board_speed_m_s,
    )
    assert (float(wheel["effort"]), float(wheel["velocity"])) == (
        car.wheel_torque_nm,
        car.wheel_speed_rad_s,
    )
    assert LACKS in path.read_text(encoding="utf-8")
    assert all((tmp_path / mesh.get("filename")).is_file() for mesh in robot.iter("mesh"))


def test_show_writes_a_machine_or_a_world(tmp_path, capsys):
    files = ["--export", str(tmp_path / "own.xml"), str(tmp_path / "own.urdf")]
    for words, names in (
        (["slope"], {"slope", "flap"}),
        (["strip"], {"car0/smartcar", "car1/board"}),
    ):
        assert main(["show", *words, *files, "--drive", "wheels"]) == 0
        assert LACKS.split()[-1] in capsys.readouterr().out
        model = mujoco.MjModel.from_xml_path(str(tmp_path / "own.xml"))
        assert names <= {model.body(i).name for i in range(model.nbody)}
        n_bodies = 0
        for file in tmp_path.glob("*.urdf"):
            n_bodies += mujoco.MjModel.from_xml_path(str(file)).nbody - 1
            file.unlink()
        assert n_bodies == model.nbody - 1
    for words in ([], ["slope"]):
        assert main(["show", *words]) == 2


BLOCK, SLOPE = NOMINAL.block, NOMINAL.slope


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
        inertia += solid.moment_inertia * mass / solid.volume + mass * (
            r @ r * np.eye(3) - np.outer(r, r)
        )
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


def uniform(
    model: mujoco.MjModel, geoms: list[str], mass: float
) -> list[tuple[trimesh.Trimesh, float]]:
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
        names = [f"wheel_{wheel}"] + [
            f"roller_{wheel}{i:02}" for i in range(SMARTCAR.rollers_per_wheel)
        ]
        mass, centre, inertia = of_bodies(model, [model.body(n).id for n in names])
        solid = trimesh.creation.cylinder(
            SMARTCAR.wheel_radius_m, SMARTCAR.wheel_width_m, sections=256
        )
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
        solids = uniform(
            model, [g for g in geoms if not g.startswith(("leg", "foot"))], BLOCK.deck_mass_kg
        )
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
