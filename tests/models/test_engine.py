"""What releases of MuJoCo before 3.12 get wrong in contacts of boxes, as worlds of craftsim have them."""

import math

import mujoco
import numpy as np
import pytest

PLATE = """<geom type="box" size="0.097 0.1 0.0015" pos="1.491530368315899 1.7737498843767183 0.37153055087148223"
  quat="3.576690305243774e-08 0.13920764550022757 -2.3585964694955878e-07 0.9902632132086024"/>"""
PAD = """<geom type="box" size="0.0935 0.0224 0.0025" pos="1.4892688540571553 1.8513498797202943 0.3763405382580435"
  quat="0.9902631983156368 1.7033978891942885e-07 0.13920775144242767 -9.814695686008013e-09"/>"""


def _depths_m(first: str, second: str, asset: str = "") -> list[float]:
    """Return how deep each contact of two bodies is."""
    bodies = f"<body>{first}</body><body><freejoint/>{second}</body>"
    text = f"<mujoco><asset>{asset}</asset><worldbody>{bodies}</worldbody></mujoco>"
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return [-float(one.dist) for one in data.contact]


def test_boxes_that_hardly_touch_have_no_deep_contact():
    """A car's plate below the pad of a slope that it carries, 5 nm deep; MuJoCo's issue 3476 made that 187 mm."""
    assert max(_depths_m(PLATE, PAD)) < 1e-6


@pytest.mark.parametrize("tilt_rad", [0.001, -0.002])
def test_each_point_of_a_face_on_a_mesh_has_its_own_depth(tilt_rad):
    """A box whose face dips into that of a mesh by 0.1 to 0.5 mm, more on one side."""
    corners = " ".join(
        f"{x} {y} {z}" for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.0)
    )
    mesh, slab = f'<mesh name="slab" vertex="{corners}"/>', '<geom type="mesh" mesh="slab"/>'
    half_m, middle_m = 0.05, 0.0003
    box = f"""<geom type="box" size="{half_m} {half_m} {half_m}" pos="0 0 {half_m - middle_m}"
      quat="{math.cos(tilt_rad / 2)} 0 {math.sin(tilt_rad / 2)} 0"/>"""
    # MuJoCo puts the origin of a mesh in its centre of mass, and shifts the geom by as much.
    depths_m = _depths_m(slab, box, mesh)
    expected = [middle_m - half_m * abs(tilt_rad), middle_m + half_m * abs(tilt_rad)]
    np.testing.assert_allclose([min(depths_m), max(depths_m)], expected, atol=5e-6)
    assert len(depths_m) == 4
