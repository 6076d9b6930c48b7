"""A car of an MJCF file becomes a machine: what is read, what cannot be, and files that name code."""

import math
import os
import re
from pathlib import Path

import pytest

from craftsim.errors import InputError
from craftsim.mjcf import car_reading
from craftsim.mjcf.car_reading import read_car
from craftsim.mjcf.machines import NOMINAL

CARS = Path(__file__).parents[1] / "data" / "cars"
CAR = NOMINAL.cars[0]
OWN = """
body: smartcar
lift: board
top: plate
mecanum: {fl: wheel_fl, fr: wheel_fr, rl: wheel_rl, rr: wheel_rr}
"""
ROSBOT = (CARS / "rosbot_like.xml").read_text(encoding="utf-8")
ROSBOT_PARTS = (CARS / "rosbot_like.yaml").read_text(encoding="utf-8")


def _read(folder, text, parts):
    (folder / "car.xml").write_text(text, encoding="utf-8")
    (folder / "parts.yaml").write_text(parts, encoding="utf-8")
    return read_car(folder / "car.xml", folder / "parts.yaml")


def _of(reading, origin):
    return {figure.name: figure for figure in reading.figures if figure.origin == origin}


def test_the_smartcar_as_it_is_exported_is_read_as_itself(tmp_path):
    """The envelope of the ten rollers of a wheel is within 0.2 % of its radius, 4 % of its width."""
    own = Path(__file__).parents[2] / "craftsim" / "mjcf" / "smartcar.xml"
    reading = _read(tmp_path, own.read_text(encoding="utf-8"), OWN)
    assert _of(reading, "left out") == {}
    bands = {"wheel_radius_m": 2e-3, "wheel_width_m": 4e-2}
    car = reading.machines.car(0)
    for name in _of(reading, "read"):
        assert getattr(car, name) == pytest.approx(getattr(CAR, name), rel=bands.get(name, 1e-5)), (
            name
        )
    assert len(_of(reading, "read")) == 28
    assert car.mass_kg == pytest.approx(CAR.mass_kg)


def test_a_mecanum_base_keeps_its_push_and_speed_where_its_sizes_do_not_fit():
    """The real one is too wide and too long for blocks of 0.32 m: 0.135 m from the middle to its wheels."""
    reading = read_car(CARS / "rosbot_like.xml", CARS / "rosbot_like.yaml")
    car = reading.machines.car(0)
    assert car.mass_kg == pytest.approx(5.7)
    assert (car.chassis_mass_kg, car.wheel_mass_kg, car.board_mass_kg) == (4.5, 0.25, 0.2)
    left_out = _of(reading, "left out")
    assert {"wheel_y_m", "wheel_radius_m", "chassis_length_m"} <= left_out.keys()
    assert "at most 0.1025 passes between a block's legs" in left_out["wheel_y_m"].words
    assert (car.wheel_y_m, car.wheel_radius_m) == (CAR.wheel_y_m, CAR.wheel_radius_m)
    assert car.wheel_torque_nm / car.wheel_radius_m == pytest.approx(1.5 / 0.05, rel=1e-5)
    assert car.wheel_speed_rad_s * car.wheel_radius_m == pytest.approx(16 * 0.05, rel=1e-5)
    assert (car.roller_friction, car.board_force_n, car.board_stiffness_n_m) == (0.7, 60.0, 20_000)
    assert car.chassis_com_m == pytest.approx(0.02)
    assert "gear_friction_nm" in _of(reading, "assumed")
    assert {"board_speed_m_s", "screw_friction_n"} <= {*_of(reading, "assumed")}


def test_three_omni_wheels_become_four_with_the_least_push_in_any_direction():
    """Of three wheels at 120 degrees it is 1.5 times the push of one, along the tread of one of them."""
    reading = read_car(CARS / "lekiwi_like.xml", CARS / "lekiwi_like.yaml")
    car = reading.machines.car(0)
    friction_nm = 2.94 * CAR.gear_friction_nm / CAR.wheel_torque_nm
    push_n = 4 * (car.wheel_torque_nm - car.gear_friction_nm) / car.wheel_radius_m
    assert push_n == pytest.approx(1.5 * (2.94 - friction_nm) / 0.05, rel=1e-5)
    assert 4 * car.wheel_mass_kg == pytest.approx(3 * 0.15)
    assert car.mass_kg == pytest.approx(1.2 + 0.45 + 0.1 + 0.05)
    assert {"omni wheels", "shoulder"} <= _of(reading, "left out").keys()
    assert "wheel_speed_rad_s" in _of(reading, "assumed")


PLANAR = """
<mujoco>
  <worldbody>
    <body name="car">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="y" type="slide" axis="0 1 0"/>
      <joint name="yaw" axis="0 0 1"/>
      <geom type="box" size=".1 .08 .04" mass="6"/>
      <body name="plate" pos="0 0 .05">
        <joint name="lift" type="slide" axis="0 0 1" range="0 .04"/>
        <geom type="box" size=".09 .09 .002" mass=".5"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <velocity joint="x" kv="100" ctrlrange="-.6 .6" forcerange="-40 40"/>
    <velocity joint="y" kv="100" ctrlrange="-.5 .5" forcerange="-30 30"/>
    <velocity joint="yaw" kv="10"/>
    <intvelocity joint="lift" kp="9000" actrange="0 .04" ctrlrange="-.03 .03" forcerange="-50 50"/>
  </actuator>
</mujoco>
"""


def test_a_holonomic_base_becomes_four_wheels_of_its_least_force_and_speed(tmp_path):
    parts = "body: car\nlift: lift\nbase: {x: x, y: y, yaw: yaw}"
    reading = _read(tmp_path, PLANAR, parts)
    car = reading.machines.car(0)
    assert car.mass_kg == pytest.approx(6.5, rel=1e-5)
    push_n = 4 * (car.wheel_torque_nm - car.gear_friction_nm) / car.wheel_radius_m
    assert push_n == pytest.approx(30.0, rel=1e-4)
    assert car.wheel_speed_rad_s * car.wheel_radius_m == pytest.approx(0.5, rel=1e-5)
    assert (car.board_speed_m_s, car.board_stiffness_n_m, car.board_travel_m) == (0.03, 9000, 0.04)
    assert {"base", "wheels, chassis"} <= _of(reading, "left out").keys()
    # The same written out: a command of 1 asks for 2 m/s; turned around; and a motor without a loop.
    speed_loop = '<general joint="y" biastype="affine" gainprm="-200" biasprm="0 0 -100" ctrlrange="-.25 .25"'
    general = PLANAR.replace('<velocity joint="y" kv="100" ctrlrange="-.5 .5"', speed_loop)
    motor = '<general joint="x" biastype="affine" gainprm="-8" ctrlrange="-5 5"'
    general = general.replace('<velocity joint="x" kv="100" ctrlrange="-.6 .6"', motor)
    assert _read(tmp_path, general, parts).machines == reading.machines


@pytest.mark.parametrize(
    ("change", "parts", "message"),
    [
        (("", ""), "lift: lift", "key 'body' is missing"),
        (("", ""), ROSBOT_PARTS + "omni: [a, b, c]", "exactly one of mecanum, omni and base"),
        (("", ""), ROSBOT_PARTS.replace("fl_wheel", "fl_weel"), "did you mean 'fl_wheel'?"),
        (("", ""), ROSBOT_PARTS.replace("fl: fl_wheel, fr: fr", "fl: fr_wheel, fr: fl"), "not the"),
        (("", ""), ROSBOT_PARTS.replace("lift: lift", "lift: fl_wheel"), "is no slide joint"),
        (('axis="0 0 1" range', 'axis="1 0 0" range'), ROSBOT_PARTS, "does not move along z"),
        (('axis="0 1 0" damping', 'axis="1 0 0" damping'), ROSBOT_PARTS, "give 'omni' wheels"),
        (('axis="0 1 0" damping', 'axis="0 0 1" damping'), ROSBOT_PARTS, "is not level"),
        (('pos="0.085 0.135 0"', 'pos="0.085 0.135 0.01"'), ROSBOT_PARTS, "not at one height"),
        ((' forcerange="-1.5 1.5"', ""), ROSBOT_PARTS, "give forcerange or actfrcrange"),
        (('<velocity joint="fl_wheel"', '<velocity joint="fr_wheel"'), ROSBOT_PARTS, "0 actuators"),
        (("<worldbody>", "<worldbody><plugin/>"), ROSBOT_PARTS, "<plugin> names code"),
        (("<worldbody>", '<include file="a.xml"/><worldbody>'), ROSBOT_PARTS, "<include> names"),
        (("<mujoco", "<!DOCTYPE a><mujoco"), ROSBOT_PARTS, "document types and entities"),
        (("<worldbody>", "<worldbody><geom/>"), ROSBOT_PARTS, "MuJoCo makes no model of it"),
        (("</mujoco>", ""), ROSBOT_PARTS, "not XML"),
        (("<worldbody>", '<worldbody><geom file="a.png"/>'), ROSBOT_PARTS, "leave it out"),
        (("<worldbody>", '<worldbody><replicate count="9"/>'), ROSBOT_PARTS, "write each body out"),
        (('mass="4.5"', 'mass="nan"'), ROSBOT_PARTS, "mass='nan'>: is not finite"),
        (
            ("<worldbody>", '<asset><mesh builtin="sphere"/></asset><worldbody>'),
            ROSBOT_PARTS,
            "take a geom",
        ),
        (
            ("<worldbody>", "<worldbody>" + 2000 * "<body>" + 2000 * "</body>"),
            ROSBOT_PARTS,
            "nested 101 deep",
        ),
        (
            ("<worldbody>", "<worldbody>" + 10_000 * "<site/>"),
            ROSBOT_PARTS,
            "more than 10,000 elements",
        ),
        (
            ("<worldbody>", '<asset><mesh file="../a.stl"/></asset><worldbody>'),
            ROSBOT_PARTS,
            "not within the folder",
        ),
        (
            ("<worldbody>", '<asset><mesh file="pipe.stl"/></asset><worldbody>'),
            ROSBOT_PARTS,
            "not a regular file",
        ),
        (
            ("<worldbody>", '<asset><mesh file="link.stl"/></asset><worldbody>'),
            ROSBOT_PARTS,
            "not within the folder",
        ),
        (
            ("<worldbody>", "<asset>" + 3 * '<mesh file="large.stl"/>' + "</asset><worldbody>"),
            ROSBOT_PARTS,
            "meshes of more than 16 MiB",
        ),
        (
            ("", ""),
            ROSBOT_PARTS.replace("fl_wheel", "x" * 81),
            "key 'mecanum.fl': has 81 characters",
        ),
    ],
)
def test_what_cannot_be_read_is_said(change, parts, message, tmp_path):
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "link.stl").symlink_to("/etc/passwd")
    (tmp_path / "large.stl").touch()
    os.truncate(tmp_path / "large.stl", 8 * 2**20)
    text = ROSBOT
    if change[0]:
        assert change[0] in text
        text = re.sub(r"<!--.*?-->\s*", "", text, flags=re.S).replace(change[0], change[1], 1)
        if "forcerange" in change[0]:
            text = text.replace(*change)
    with pytest.raises(InputError, match=re.escape(message)):
        _read(tmp_path, text, parts)


def test_what_is_only_seen_opens_no_file_and_takes_no_memory(tmp_path):
    """A cube's texture names up to six files; a motor keeps as many past values as it is told."""
    (tmp_path / "elsewhere").mkdir()
    os.mkfifo(tmp_path / "elsewhere" / "a.png")
    seen = (
        '<visual><global offwidth="100000"/></visual><size memory="100G"/><asset>'
        f'<texture name="t" type="cube" fileright="{tmp_path}/elsewhere/a.png"/>'
        '<texture name="s" builtin="checker" width="20000" height="20000"/>'
        '<material name="m" texture="t"/></asset><worldbody><geom size="1" material="m"/>'
    )
    text = ROSBOT.replace("<worldbody>", seen, 1)
    text = text.replace("<velocity ", '<velocity delay="1" nsample="1000000000" ')
    assert (
        _read(tmp_path, text, ROSBOT_PARTS).machines
        == _read(tmp_path, ROSBOT, ROSBOT_PARTS).machines
    )


def test_a_mesh_within_the_folder_is_read(tmp_path):
    corners = "v 1 1 0\nv 1 -1 0\nv -1 0 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 2 3 4\nf 1 3 4\n"
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "hull.obj").write_text(corners)
    text = ROSBOT.replace(
        'type="box" pos="0 0 0.02" size="0.166 0.11 0.045"', 'type="mesh" mesh="hull"'
    )
    head = '<compiler meshdir="meshes"/><asset><mesh name="hull" file="hull.obj" scale=".1 .1 .05"/></asset>'
    reading = _read(tmp_path, text.replace("<worldbody>", f"{head}<worldbody>"), ROSBOT_PARTS)
    assert math.isclose(reading.machines.car(0).chassis_mass_kg, 4.5, rel_tol=1e-6)


def test_of_many_other_joints_some_are_named(tmp_path):
    """Else the file that is written is larger than one that is read."""
    arm = "".join(
        f'<body name="b{n}"><joint/><geom size=".01" mass=".01"/></body>' for n in range(60)
    )
    reading = _read(tmp_path, ROSBOT.replace("<site", f"{arm}<site", 1), ROSBOT_PARTS)
    left_out = _of(reading, "left out")
    assert left_out["20 further joints"].words == "rigid, as at the start"
    assert sum(name.startswith("joint ") for name in left_out) == 40


def test_many_geoms_are_refused_before_their_points_fill_the_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(car_reading, "_MOST_POINTS", 1000)
    text = ROSBOT.replace('<geom class="wheel"/>', 8 * '<geom class="wheel"/>')
    with pytest.raises(InputError, match="geoms with more than 1,000 points: leave out"):
        _read(tmp_path, text, ROSBOT_PARTS)
