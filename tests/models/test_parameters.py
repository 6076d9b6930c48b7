"""The MJCF files hold the figures of the parameter dataclasses, and every figure says where it comes from."""

import math
from collections.abc import Callable
from dataclasses import fields

import mujoco
import numpy as np
import pytest

from craftsim.models.parameters import (
    BLOCK,
    SLOPE,
    SMARTCAR,
    BlockParameters,
    SlopeParameters,
    SmartcarParameters,
    provenance,
)

Figures = dict[str, Callable[[mujoco.MjModel], float]]
AXLE = SMARTCAR.wheel_radius_m


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


def level(model: mujoco.MjModel, geom: str, pick: Callable[..., np.floating], axis: int = 2) -> float:
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


SMARTCAR_FIGURES: Figures = {
    "wheel_radius_m": lambda m: m.geom("guard_fl").size[0],
    "wheel_width_m": lambda m: 2 * m.geom("guard_fl").size[1],
    "wheel_x_m": lambda m: m.body("wheel_fl").pos[0],
    "wheel_y_m": lambda m: m.body("wheel_fl").pos[1],
    "wheel_mass_kg": lambda m: m.body("wheel_fl").subtreemass[0],
    "wheel_spin_inertia_kgm2": lambda m: spin_inertia(m, "wheel_fl"),
    "rollers_per_wheel": lambda m: len(descendants(m, "wheel_fl")) - 1,
    "roller_radius_m": lambda m: m.geom("roller_fl00").size[0],
    "roller_half_length_m": lambda m: m.geom("roller_fl00").size[2],
    "roller_mass_kg": lambda m: m.body("roller_fl00").mass[0],
    "chassis_length_m": lambda m: extent(m, 0, "hull"),
    "chassis_width_m": lambda m: extent(m, 1, "hull"),
    "chassis_bottom_m": lambda m: level(m, "hull", np.min) - AXLE,
    "chassis_top_m": lambda m: level(m, "hull", np.max) - AXLE,
    "chassis_chamfer_m": lambda m: (
        (extent(m, 0, "hull") - side_at(m, "hull", AXLE + SMARTCAR.chassis_bottom_m)) / 2
    ),
    "chassis_mass_kg": lambda m: m.body("smartcar").mass[0],
    "chassis_com_m": lambda m: m.body("smartcar").ipos[2] - AXLE,
    "board_top_m": lambda m: m.body("board").pos[2] + level(m, "plate", np.max) - AXLE,
    "board_length_m": lambda m: extent(m, 0, "plate"),
    "board_width_m": lambda m: extent(m, 1, "plate"),
    "board_thickness_m": lambda m: extent(m, 2, "plate"),
    "board_mass_kg": lambda m: m.body("board").mass[0],
    "board_travel_m": lambda m: np.ptp(m.joint("board").range),
    "board_speed_m_s": lambda m: m.actuator("board").ctrlrange[1],
    "board_force_n": lambda m: m.actuator("board").forcerange[1],
    "boss_side_m": lambda m: side_at(m, "boss", 0.0),
    "boss_top_side_m": lambda m: side_at(m, "boss", SMARTCAR.boss_height_m),
    "boss_height_m": lambda m: level(m, "boss", np.max) - level(m, "plate", np.max),
    "wheel_torque_nm": lambda m: m.actuator("wheel_fl").forcerange[1],
    "wheel_speed_rad_s": lambda m: m.actuator("wheel_fl").ctrlrange[1],
    "wheel_gain_nms_rad": lambda m: m.actuator("wheel_fl").gainprm[0],
    "wheel_armature_kgm2": lambda m: m.dof_armature[m.joint("wheel_fl").dofadr[0]],
    "gear_friction_nm": lambda m: m.dof_frictionloss[m.joint("wheel_fl").dofadr[0]],
    "roller_bearing_friction_nm": lambda m: m.dof_frictionloss[m.joint("roller_fl00").dofadr[0]],
    "roller_friction": lambda m: m.geom("roller_fl00").friction[0],
    "board_friction": lambda m: m.geom("plate").friction[0],
    "chassis_friction": lambda m: m.geom("hull").friction[0],
}

BLOCK_FIGURES: Figures = {
    "side_m": lambda m: extent(m, 0, "deck", "leg_fl", "leg_rl"),
    "height_m": lambda m: level(m, "deck", np.max) - (m.geom("foot_fl").pos[2] - m.geom("foot_fl").size[0]),
    "leg_side_m": lambda m: extent(m, 0, "leg_fl"),
    "leg_offset_m": lambda m: m.geom("leg_fl").pos[0],
    "underside_m": lambda m: level(m, "frame_front", np.min),
    "deck_mass_kg": lambda m: m.body(m.geom("deck").bodyid[0]).mass[0] - 4 * BLOCK.leg_mass_kg,
    "leg_mass_kg": lambda m: BLOCK.leg_mass_kg,  # a geom's mass is not kept: the test of inertia checks it
    "pocket_side_m": lambda m: 2 * level(m, "frame_front", np.min, axis=0),
    "pocket_depth_m": lambda m: level(m, "deck", np.min) - level(m, "frame_front", np.min),
    "friction": lambda m: m.geom("deck").friction[0],
    "foot_radius_m": lambda m: m.geom("foot_rl").size[0],
    "foot_friction": lambda m: m.geom("foot_rl").friction[0],
}


def incline(points: np.ndarray) -> float:
    """Return the angle by which the upper edges of a wedge fall towards x."""
    high, low = (
        points[np.isclose(points[:, 0], x, atol=1e-6)] for x in (points[:, 0].min(), points[:, 0].max())
    )
    return math.atan2(high[:, 2].max() - low[:, 2].max(), low[0, 0] - high[0, 0])


def skin(model: mujoco.MjModel) -> float:
    points = corners(model, "incline")
    edge = points[np.isclose(points[:, 0], points[:, 0].min(), atol=1e-6)][:, 2]
    return float(np.ptp(edge) * math.cos(SLOPE.incline_rad))


SLOPE_FIGURES: Figures = {
    "side_m": lambda m: extent(m, 1, "wall_left", "wall_right"),
    "height_m": lambda m: m.body("flap").pos[2] - level(m, "flap", np.min),
    "hinge_x_m": lambda m: m.body("flap").pos[0],
    "hinge_z_m": lambda m: m.body("flap").pos[2],
    "incline_rad": lambda m: incline(corners(m, "incline")),
    "skin_m": skin,
    "underside_m": lambda m: level(m, "pad_left", np.min),
    "boss_play_m": lambda m: level(m, "pad_left", np.min, axis=1) - SMARTCAR.boss_side_m / 2,
    "base_mass_kg": lambda m: m.body("slope").mass[0],
    "flap_mass_kg": lambda m: m.body("flap").mass[0],
    "gear_radius_m": lambda m: m.geom("gear_left").size[0],
    "hinge_torque_nm": lambda m: m.actuator("hinge").forcerange[1],
    "hinge_speed_rad_s": lambda m: m.actuator("hinge").ctrlrange[1],
    "hinge_range_rad": lambda m: m.joint("hinge").range[1],
    "hinge_friction_nm": lambda m: m.dof_frictionloss[m.joint("hinge").dofadr[0]],
}

TABLES = {
    "smartcar": (SMARTCAR, SMARTCAR_FIGURES),
    "block": (BLOCK, BLOCK_FIGURES),
    "flag": (BLOCK, BLOCK_FIGURES),
    "slope": (SLOPE, SLOPE_FIGURES),
}


@pytest.mark.parametrize("part", TABLES)
def test_the_mjcf_holds_every_figure(open_part, part):
    """Band: 1e-5 of the figure (files are written with six digits), 0.1 % for the wheel's inertia."""
    parameters, figures = TABLES[part]
    assert set(figures) == {f.name for f in fields(parameters)}
    model = open_part(part)
    for name, measure in figures.items():
        band = 1e-3 if "inertia" in name else 1e-5
        assert measure(model) == pytest.approx(getattr(parameters, name), rel=band, abs=2e-6), name


def test_the_wall_has_the_blocks_shape(open_part):
    model, block = open_part("wall"), open_part("block")
    for geom in ("deck", "frame_front", "frame_left", "leg_fl", "leg_rr"):
        assert np.array_equal(corners(model, geom), corners(block, geom))


@pytest.mark.parametrize("kind", [SmartcarParameters, BlockParameters, SlopeParameters])
def test_every_figure_has_provenance(kind):
    for name, origin in provenance(kind).items():
        assert origin.origin in ("published", "derived", "assumed"), name
        if origin.origin != "published":
            assert origin.note, f"{name} is {origin.origin}, from what?"


@pytest.mark.parametrize(
    ("part", "mass"), [("smartcar", 10.3), ("block", 0.504), ("flag", 0.504), ("slope", 1.1)]
)
def test_masses_are_the_published_ones(open_part, part, mass):
    """Chassis 1.0 + four wheels of 2.3 + board 0.1; deck 0.5 + four legs of 0.001; base 1.0 + flap 0.1."""
    assert open_part(part).body(part).subtreemass[0] == pytest.approx(mass, abs=1e-5)
    parameters, _ = TABLES[part]
    assert parameters.mass_kg == pytest.approx(mass)


def test_all_four_wheels_are_alike(open_part):
    model = open_part("smartcar")
    for wheel in ("wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr"):
        place = np.abs(model.body(wheel).pos) - [SMARTCAR.wheel_x_m, SMARTCAR.wheel_y_m, AXLE]
        assert np.abs(place).max() < 1e-9
        assert model.body(wheel).subtreemass[0] == pytest.approx(SMARTCAR.wheel_mass_kg)
        assert len(descendants(model, wheel)) == 1 + SMARTCAR.rollers_per_wheel
        dof = model.joint(wheel).dofadr[0]
        assert model.dof_frictionloss[dof] == SMARTCAR.gear_friction_nm
        motor = model.actuator(wheel)
        assert motor.forcerange.tolist() == [-SMARTCAR.wheel_torque_nm, SMARTCAR.wheel_torque_nm]
        assert motor.ctrlrange.tolist() == [-SMARTCAR.wheel_speed_rad_s, SMARTCAR.wheel_speed_rad_s]
        assert -motor.biasprm[2] == motor.gainprm[0] == SMARTCAR.wheel_gain_nms_rad


def test_the_rollers_reach_the_wheels_radius(open_part):
    """A roller's middle is the wheel's outermost point: distance of its axis plus its own radius."""
    model = open_part("smartcar")
    roller = model.body("roller_fl00")
    reach = np.hypot(roller.pos[0], roller.pos[2]) + SMARTCAR.roller_radius_m
    assert reach == pytest.approx(SMARTCAR.wheel_radius_m, abs=1e-9)


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
