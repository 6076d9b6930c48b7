"""MJCF and meshes follow the parameters, nominal or from a file, and every figure says where it comes from."""

import math
import re
from collections.abc import Callable
from dataclasses import fields, replace
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

import mujoco
import numpy as np
import pytest

from craftsim.discrete.files.blueprint import read_blueprint
from craftsim.errors import InputError
from craftsim.mjcf.drives import DRIVES
from craftsim.mjcf.machines import NOMINAL, Machines, load_machines
from craftsim.mjcf.parameters import (
    BlockParameters,
    ContactParameters,
    SlopeParameters,
    SmartcarParameters,
)
from craftsim.mjcf.template import machines_text, unit_of
from craftsim.models.composition import MACHINES, machine_spec, world_spec
from craftsim.models.config import SimulationConfig
from craftsim.models.exporting import machine_texts, mjcf_text

SMARTCAR, BLOCK, SLOPE = NOMINAL.cars[0], NOMINAL.block, NOMINAL.slope

OTHER = Machines(
    cars=(
        SmartcarParameters(
            *(0.0492, 0.040, 0.062, 0.085, 2.6, 10),
            roller_mass_kg=0.04,
            roller_friction=0.7,
            chassis_length_m=0.215,
            chassis_width_m=0.16,
            chassis_bottom_m=-0.039,
            chassis_top_m=0.048,
            chassis_chamfer_m=0.027,
            chassis_mass_kg=1.4,
            chassis_com_m=-0.02,
            board_top_m=0.0528,
            board_mass_kg=0.15,
            board_travel_m=0.044,
            board_speed_m_s=0.06,
            board_force_n=90.0,
            wheel_torque_nm=3.0,
            wheel_speed_rad_s=22.0,
            wheel_gain_nms_rad=4.5,
            gear_friction_nm=0.5,
            camera_proud_m=0.004,
            camera_z_m=0.02,
            camera_pitch_rad=0.3,
            camera_fovy_rad=0.9,
        ),
    ),
    block=BlockParameters(deck_mass_kg=0.8, leg_mass_kg=0.002, friction=0.5, foot_friction=0.9),
    slope=SlopeParameters(
        base_mass_kg=1.3,
        flap_mass_kg=0.2,
        hinge_speed_rad_s=1.0,
        hinge_torque_nm=12.0,
        hinge_friction_nm=0.03,
    ),
)
"""Machines whose figures differ from the nominal ones."""

Figures = dict[str, Callable[[mujoco.MjModel], float]]


def axle(model: mujoco.MjModel) -> float:
    return float(model.body("wheel_fl").pos[2])


def corners(model: mujoco.MjModel, geom: str) -> np.ndarray:
    """Return the corner points (n, 3) of a box or a mesh geom in the frame of its body."""
    g = model.geom(geom)
    if g.type[0] == mujoco.mjtGeom.mjGEOM_BOX:
        local = np.array(np.meshgrid(*[(-s, s) for s in g.size])).reshape(3, -1).T
    else:
        mesh = model.mesh(g.dataid[0])
        start, count = mesh.vertadr[0], mesh.vertnum[0]
        local = model.mesh_vert[start : start + count].astype(float)
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, g.quat)
    return local @ turn.reshape(3, 3).T + g.pos


def extent(model: mujoco.MjModel, axis: int, *geoms: str) -> float:
    points = np.concatenate([corners(model, geom) for geom in geoms])
    return float(np.ptp(points[:, axis]))


def level(
    model: mujoco.MjModel, geom: str, pick: Callable[..., np.floating], axis: int = 2
) -> float:
    return float(pick(corners(model, geom)[:, axis]))


def side_at(model: mujoco.MjModel, geom: str, height: float) -> float:
    points = corners(model, geom)
    return float(np.ptp(points[np.isclose(points[:, 2], height, atol=1e-6)][:, 0]))


def descendants(model: mujoco.MjModel, body: str) -> list[int]:
    top = model.body(body).id
    found = []
    for b in range(1, model.nbody):
        up = b
        while up not in (0, top):
            up = int(model.body_parentid[up])
        if up == top:
            found.append(b)
    return found


def spin_inertia(model: mujoco.MjModel, wheel: str) -> float:
    """Return the inertia about the axle with the rollers locked: the joint's entry in the mass matrix."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, matrix)
    dof = model.joint(wheel).dofadr[0]
    return float(matrix[dof, dof] - model.dof_armature[dof])


def looking_up(model: mujoco.MjModel, camera: str) -> float:
    """Return the angle by which a camera, which looks along its own -z, looks over the horizon, and forward."""
    forward = np.empty(3)
    mujoco.mju_rotVecQuat(forward, np.array([0.0, 0.0, -1.0]), model.camera(camera).quat)
    assert forward[0] > 0
    assert abs(forward[1]) < 1e-9
    return math.asin(forward[2])


# What is written into a model as it is, such as a mass or a limit, is only tested to have an effect.
SMARTCAR_FIGURES: Figures = {
    "wheel_width_m": lambda m: 2 * m.geom("guard_fl").size[1],
    "wheel_mass_kg": lambda m: m.body("wheel_fl").subtreemass[0],
    "wheel_spin_inertia_kgm2": lambda m: spin_inertia(m, "wheel_fl"),
    "rollers_per_wheel": lambda m: len(descendants(m, "wheel_fl")) - 1,
    "chassis_length_m": lambda m: extent(m, 0, "hull"),
    "chassis_width_m": lambda m: extent(m, 1, "hull"),
    "chassis_bottom_m": lambda m: level(m, "hull", np.min) - axle(m),
    "chassis_top_m": lambda m: level(m, "hull", np.max) - axle(m),
    "chassis_chamfer_m": lambda m: (
        (extent(m, 0, "hull") - side_at(m, "hull", level(m, "hull", np.min))) / 2
    ),
    "chassis_com_m": lambda m: m.body("smartcar").ipos[2] - axle(m),
    "board_top_m": lambda m: m.body("board").pos[2] + level(m, "plate", np.max) - axle(m),
    "board_thickness_m": lambda m: extent(m, 2, "plate"),
    "board_travel_m": lambda m: np.ptp(m.joint("board").range),
    "boss_side_m": lambda m: side_at(m, "boss", 0.0),
    "boss_top_side_m": lambda m: side_at(m, "boss", SMARTCAR.boss_height_m),
    "boss_height_m": lambda m: level(m, "boss", np.max) - level(m, "plate", np.max),
    "camera_proud_m": lambda m: m.camera("front").pos[0] - level(m, "hull", np.max, axis=0),
    "camera_z_m": lambda m: m.camera("front").pos[2] - axle(m),
    "camera_pitch_rad": lambda m: looking_up(m, "front"),
    "camera_fovy_rad": lambda m: math.radians(m.camera("front").fovy[0]),
}

BLOCK_FIGURES: Figures = {
    "side_m": lambda m: extent(m, 0, "deck", "leg_fl", "leg_rl"),
    "height_m": lambda m: (
        level(m, "deck", np.max) - (m.geom("foot_fl").pos[2] - m.geom("foot_fl").size[0])
    ),
    "underside_m": lambda m: level(m, "frame_front", np.min),
    "mass_kg": lambda m: m.body(m.geom("deck").bodyid[0]).mass[0],
    "pocket_side_m": lambda m: 2 * level(m, "frame_front", np.min, axis=0),
    "pocket_depth_m": lambda m: level(m, "deck", np.min) - level(m, "frame_front", np.min),
}


def incline(points: np.ndarray) -> float:
    """Return the angle by which the upper edges of a wedge fall towards x."""
    high, low = (
        points[np.isclose(points[:, 0], x, atol=1e-6)]
        for x in (points[:, 0].min(), points[:, 0].max())
    )
    return math.atan2(high[:, 2].max() - low[:, 2].max(), low[0, 0] - high[0, 0])


def skin(model: mujoco.MjModel) -> float:
    points = corners(model, "incline")
    edge = points[np.isclose(points[:, 0], points[:, 0].min(), atol=1e-6)][:, 2]
    return float(np.ptp(edge) * math.cos(SLOPE.incline_rad))


SLOPE_FIGURES: Figures = {
    "side_m": lambda m: extent(m, 1, "wall_left", "wall_right"),
    "height_m": lambda m: m.body("flap").pos[2] - level(m, "flap", np.min),
    "incline_rad": lambda m: incline(corners(m, "incline")),
    "skin_m": skin,
    "underside_m": lambda m: level(m, "pad_left", np.min),
    "boss_play_m": lambda m: level(m, "pad_left", np.min, axis=1) - SMARTCAR.boss_side_m / 2,
    "hinge_range_rad": lambda m: m.joint("hinge").range[1],
}

TABLES = {
    "smartcar": SMARTCAR_FIGURES,
    "block": BLOCK_FIGURES,
    "flag": BLOCK_FIGURES,
    "slope": SLOPE_FIGURES,
}


def figures_of(part: str, machines: Machines):
    return {"smartcar": machines.cars[0], "slope": machines.slope}.get(part, machines.block)


def test_the_compiled_part_has_the_figures_that_it_is_made_from():
    """Band: 1e-5 of the figure (what follows is written with six digits), 0.1 % for the wheel's inertia."""
    for part in TABLES:
        for machines in (replace(NOMINAL, drive="rollers"), replace(OTHER, drive="rollers")):
            model, parameters = machine_spec(part, machines).compile(), figures_of(part, machines)
            for name, measure in TABLES[part].items():
                band = 1e-3 if "inertia" in name else 1e-5
                assert measure(model) == pytest.approx(
                    getattr(parameters, name), rel=band, abs=2e-6
                ), name


def bumped(parameters, name: str):
    """Return the parameters with one figure off, whether or not it may be changed."""
    changed = replace(parameters)
    value = getattr(parameters, name)
    object.__setattr__(changed, name, value + 1 if isinstance(value, int) else value * 1.01)
    return changed


NOMINAL_OF = {drive: replace(NOMINAL, drive=drive) for drive in ("wheels", "rollers")}


def with_parameters(parameters, drive) -> Machines:
    machines = replace(NOMINAL, drive=drive)
    kinds = {SmartcarParameters: "cars", BlockParameters: "block", SlopeParameters: "slope"}
    name = kinds.get(type(parameters), "contact")
    object.__setattr__(machines, name, (parameters,) if name == "cars" else parameters)
    return machines


READ_BY_SENSORS = {"docking_range_m", "line_reach_m"}
KINDS = (SmartcarParameters, BlockParameters, SlopeParameters, ContactParameters)


def test_a_figure_that_is_edited_changes_the_model():
    parts = {SmartcarParameters: "smartcar", BlockParameters: "block", SlopeParameters: "slope"}
    for kind in KINDS:
        first = parts.get(kind, "ground")
        for name in (field.name for field in fields(kind) if field.name not in READ_BY_SENSORS):
            edited = {drive: with_parameters(bumped(kind(), name), drive) for drive in NOMINAL_OF}
            assert any(
                _made(part, edited[drive], visual) != _made(part, nominal, visual)
                for drive, nominal in NOMINAL_OF.items()
                for visual in (False, True)
                for part in (first, *MACHINES)
            ), (kind, name)


@lru_cache(maxsize=len(MACHINES))
def _made(part: str, machines: Machines, visual: bool) -> str:
    return mjcf_text(machine_spec(part, machines, visual=visual))


def test_the_files_are_what_the_builders_make_and_no_others():
    found = {path.name: path.read_text(encoding="utf-8") for path in _folder().glob("*.xml")}
    assert found == {f"{name}.xml": text for name, text in machine_texts().items()}, (
        "run python -m craftsim.models.exporting"
    )


@pytest.mark.parametrize("drive", DRIVES)
def test_an_exported_world_moves_alike_without_attributes_of_newer_releases(drive):
    """MuJoCo 3.12 to 3.16 refuse ``input`` of these motors."""
    grid = read_blueprint("strip").grid(np.random.default_rng(0))
    spec = world_spec(grid, SimulationConfig(), replace(NOMINAL, drive=drive))
    text = mjcf_text(spec)
    assert " input=" not in text
    ends = []
    for one in (text, spec.to_xml()):
        model = mujoco.MjModel.from_xml_string(one)
        data = mujoco.MjData(model)
        data.ctrl[:] = 0.7 * model.actuator_ctrlrange[:, 1]
        mujoco.mj_step(model, data, 100)
        ends.append(data.qpos.tobytes())
    assert ends[0] == ends[1]


def _folder() -> Path:
    return Path(str(files("craftsim.mjcf")))


def test_the_digest_tells_figures_apart():
    assert Machines().digest == NOMINAL.digest != OTHER.digest
    whole, same = (Machines(cars=(SmartcarParameters(wheel_torque_nm=t),)) for t in (3, 3.0))
    assert (whole, whole.digest) == (same, same.digest)


CAR = SmartcarParameters

REFUSED = (
    (CAR, {"wheel_mass_kg": -1.0}, "wheel_mass_kg: -1.0 is out of range, allowed: above 0"),
    (CAR, {"wheel_torque_nm": math.nan}, "wheel_torque_nm: must be a finite number above 0"),
    (CAR, {"wheel_torque_nm": 0.4}, "must be above gear_friction_nm, 0.45"),
    (CAR, {"boss_side_m": 0.1}, "boss_side_m: cannot be changed from 0.11: the pockets"),
    (CAR, {"wheel_radius_m": 0.043}, "ground on the crest of a slope"),
    (CAR, {"chassis_chamfer_m": 0.002, "chassis_length_m": 0.25}, "nose would run into"),
    (CAR, {"board_top_m": 0.05}, "at least 0.0530 keeps the plate above chassis and wheels"),
    (CAR, {"roller_mass_kg": 0.2}, "wheel_mass_kg must be above 4"),
    (
        SlopeParameters,
        {"hinge_speed_rad_s": 50.0},
        "50.0 is out of range, allowed: above 0 and at most 3",
    ),
)

REFUSED_TOGETHER = (
    ({"board_travel_m": 0.02}, "from 0.0309 to 0.0509 lifts"),
    ({"board_top_m": 0.0535}, "at most 0.1027 drives under a slope"),
    ({"wheel_y_m": 0.11}, "passes between a block's legs"),
)
"""Of cars that can be by themselves, and not with blocks and slopes."""


def test_a_figure_that_cannot_work_is_refused_by_name():
    for kind, figures, message in REFUSED:
        with pytest.raises(InputError, match=message):
            kind(**figures)
    for figures, message in REFUSED_TOGETHER:
        car = CAR(**figures)
        with pytest.raises(InputError, match=message):
            Machines(cars=(car,))
    with pytest.raises(InputError, match="cars: has 0 entries, allowed: at least 1"):
        Machines(cars=())


def test_every_figure_has_provenance():
    for kind in KINDS:
        for parameter in fields(kind):
            name, origin = parameter.name, parameter.metadata["origin"]
            assert origin in ("published", "derived", "assumed"), name
            if origin != "published":
                assert parameter.metadata["note"], f"{name} is {origin}, from what?"


def test_the_flap_continues_the_incline_and_folds_to_a_level_top(open_part):
    """Base and flap share one plane through the hinge border, and flap bottom and hinge are half a level apart."""
    model = open_part("slope")
    base, flap = corners(model, "incline"), corners(model, "flap") + model.body("flap").pos
    assert incline(flap) == pytest.approx(SLOPE.incline_rad, abs=1e-5)
    tops = [points[points[:, 2] >= np.median(points[:, 2])] for points in (base, flap)]
    for points in tops:
        edge = points[np.argmax(points[:, 2])]
        over_hinge = edge[2] - math.tan(SLOPE.incline_rad) * (SLOPE.hinge_x_m - edge[0])
        assert over_hinge == pytest.approx(SLOPE.hinge_z_m, abs=2e-6)
    assert 2 * SLOPE.hinge_z_m == pytest.approx(SLOPE.height_m)


def _file(folder: Path, text: str) -> Path:
    path = folder / "own.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_overrides_the_figures_that_it_gives(tmp_path):
    text = """
    smartcar: {chassis_mass_kg: 1.1, wheel_torque_nm: 3}
    block: {deck_mass_kg: 0.6}
    slope: {hinge_speed_rad_s: 1.0}
    contact: {ground_friction: 0.5}
    gains: {drive: {max_speed: 0.5}}
    """
    machines = load_machines(str(_file(tmp_path, text)))
    assert machines.cars == (SmartcarParameters(chassis_mass_kg=1.1, wheel_torque_nm=3.0),)
    assert machines.block == BlockParameters(deck_mass_kg=0.6)
    assert machines.slope == SlopeParameters(hinge_speed_rad_s=1.0)
    assert machines.contact.ground_friction == 0.5
    assert load_machines(_file(tmp_path, text)).digest == machines.digest != NOMINAL.digest


def test_the_example_of_the_documentation_is_such_a_file(tmp_path):
    docs = Path(__file__).parents[2] / "docs" / "reference" / "parameters.md"
    (text,) = re.findall(r"```yaml\n(.*?)```", docs.read_text(encoding="utf-8"), re.DOTALL)
    machines = load_machines(_file(tmp_path, text))
    assert machines.car(1).chassis_mass_kg == 2.0
    assert machines.slope.hinge_speed_rad_s == 1.0


def test_single_cars_differ_from_the_others(tmp_path):
    text = "smartcar: {chassis_mass_kg: 1.1}\ncars: [{}, {wheel_torque_nm: 3.0, chassis_mass_kg: 1.2}]\n"
    machines = load_machines(_file(tmp_path, text))
    assert machines.car(0) == SmartcarParameters(chassis_mass_kg=1.1)
    assert machines.car(1) == SmartcarParameters(chassis_mass_kg=1.2, wheel_torque_nm=3.0)


def test_a_whole_mass_is_shared_by_the_parts_that_are_not_named(tmp_path):
    car = load_machines(_file(tmp_path, "smartcar: {mass_kg: 3.7}")).car(0)
    factor = 3.7 / SMARTCAR.mass_kg
    assert car.mass_kg == pytest.approx(3.7)
    for name in ("chassis_mass_kg", "wheel_mass_kg", "board_mass_kg", "roller_mass_kg"):
        assert getattr(car, name) == pytest.approx(factor * getattr(SMARTCAR, name)), name
    car = load_machines(_file(tmp_path, "smartcar: {mass_kg: 3.7, wheel_mass_kg: 0.65}")).car(0)
    assert (car.wheel_mass_kg, car.roller_mass_kg) == (0.65, SMARTCAR.roller_mass_kg)
    assert car.mass_kg == pytest.approx(3.7)
    assert car.chassis_mass_kg / car.board_mass_kg == pytest.approx(10.0)
    text = (
        "smartcar: {mass_kg: 5, wheel_mass_kg: 1}\ncars: [{}, {mass_kg: 10}, {chassis_mass_kg: 2}]"
    )
    first, second, third = load_machines(_file(tmp_path, text)).cars
    assert (first.mass_kg, second.mass_kg) == pytest.approx((5.0, 10.0))
    assert second.wheel_mass_kg == pytest.approx(2.0)
    assert (third.chassis_mass_kg, third.wheel_mass_kg) == (2.0, 1.0)
    text = "smartcar: {mass_kg: 10.3, wheel_mass_kg: 2.3}"
    assert load_machines(_file(tmp_path, text)).digest == NOMINAL.digest


def test_the_template_has_every_parameter_and_is_the_nominal_machines(tmp_path):
    text = machines_text()
    assert load_machines(_file(tmp_path, text)).digest == NOMINAL.digest
    for kind in KINDS:
        for parameter in fields(kind):
            (line,) = re.findall(
                rf"^  (?:# )?{parameter.name}: {parameter.default!r}  # .*", text, re.M
            )[:1]
            assert parameter.metadata["origin"] in line
            assert unit_of(parameter.name) in line
    # Lines of masses may be taken in: they are the parts of the whole.
    whole = re.sub(r"^  # (?=\w+_mass_kg)", "  ", text, flags=re.M)
    assert load_machines(_file(tmp_path, whole)).digest == NOMINAL.digest


def test_a_template_of_other_machines_is_those(tmp_path):
    text = machines_text(OTHER)
    assert load_machines(_file(tmp_path, text)).digest == OTHER.digest
    assert "wheel_torque_nm: 3.0  # Nm; largest torque of a motor at its wheel; nominal 2.5" in text


def test_a_wrong_file_is_refused_by_file_line_and_figure(tmp_path):
    for text, message in (
        ("smartcat: {}", ":1: unknown key 'smartcat'; did you mean 'smartcar'?"),
        (
            "\nsmartcar: {wheel_mas_kg: 1}",
            ":2: unknown key 'wheel_mas_kg'; did you mean 'wheel_mass_kg'?",
        ),
        (
            "smartcar: {wheel_torque: 1}",
            ":1: unknown key 'wheel_torque'; did you mean 'wheel_torque_nm'?; allowed: mass_kg, ",
        ),
        ("smartcar: {mas_kg: 1}", ":1: unknown key 'mas_kg'; did you mean 'mass_kg'?"),
        ("cars: [{mass: 1}]", ":1: unknown key 'mass'; did you mean 'mass_kg'?"),
        (
            "smartcar: {wheel_mass_kg: -1}",
            ":1: key 'smartcar.wheel_mass_kg': -1 is out of range, allowed: above 0",
        ),
        (
            "smartcar: {mass_kg: 0}",
            ":1: key 'smartcar.mass_kg': 0 is out of range, allowed: above 0",
        ),
        (
            "smartcar: {mass_kg: heavy}",
            ":1: key 'smartcar.mass_kg': must be a number above 0, not 'heavy'",
        ),
        (
            "smartcar: {mass_kg: 9, wheel_mass_kg: 2.3}",
            ":1: key 'smartcar.mass_kg': is 9, of which wheel_mass_kg take 9.2: nothing is left",
        ),
        (
            "smartcar: {mass_kg: 9, wheel_mass_kg: 2, chassis_mass_kg: 1, board_mass_kg: 0.1}",
            ":1: key 'smartcar.mass_kg': is 9, but chassis_mass_kg, wheel_mass_kg, board_mass_kg make 9.1",
        ),
        (
            "block: {mass_kg: 1}",
            ":1: key 'block.mass_kg': is not given but follows from other parameters",
        ),
        (
            "smartcar: {boss_side_m: 0.1}",
            ":1: key 'smartcar.boss_side_m': cannot be changed from 0.11: the pockets",
        ),
        (
            "smartcar: {wheel_radius_m: 0.04}",
            ":1: key 'smartcar': wheel_radius_m is 0.04: the chassis would ground",
        ),
        (
            "cars: [{}, {board_travel_m: 0.02}]",
            ": Machines: board_travel_m is 0.02; from 0.0309 to 0.0509",
        ),
    ):
        path = _file(tmp_path, text)
        with pytest.raises(InputError) as caught:
            load_machines(path)
        assert str(caught.value).startswith(f"{path}{message}")


def test_all_mistakes_are_named_together(tmp_path):
    path = _file(
        tmp_path,
        "block: {side_m: 0.4}\nslope: {skin: 1, friction: -1}\ncars: [{}, {boss_height_m: 1}]\n",
    )
    with pytest.raises(InputError) as caught:
        load_machines(path)
    lines = [
        line.removeprefix(f"{path}:").partition(":")[0] for line in str(caught.value).splitlines()
    ]
    assert lines == ["1", "2", "2", "3"]


def test_masses_are_the_published_ones(open_part):
    """Chassis 1.0 + four wheels of 2.3 + board 0.1; deck 0.5 + four legs of 0.001; base 1.0 + flap 0.1."""
    for part, mass in (("smartcar", 10.3), ("block", 0.504), ("flag", 0.504), ("slope", 1.1)):
        assert open_part(part).body(part).subtreemass[0] == pytest.approx(mass, abs=1e-5)
        assert figures_of(part, NOMINAL).mass_kg == pytest.approx(mass)
