"""What is written as URDF is read by MuJoCo's own loader as the machine that it was written from."""

from dataclasses import replace
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np
import pytest
from drawn import draw

from craftsim.cli import main
from craftsim.discrete.grid import Kind
from craftsim.mjcf.parameters import NOMINAL
from craftsim.models.composition import machine_spec, world_spec
from craftsim.models.config import SimulationConfig
from craftsim.models.exporting import LACKS, write_urdf


def _assert_same(read: mujoco.MjModel, own: mujoco.MjModel) -> None:
    """Compare bodies, joints, masses, inertias and ranges; band: 1e-6 of SI units."""
    plain = [own.body(i).name.replace("/", "_") for i in range(1, own.nbody)]
    assert [read.body(i).name for i in range(1, read.nbody)] == plain
    assert read.jnt_type.tolist() == own.jnt_type.tolist()
    for name in ("body_mass", "body_pos", "jnt_range", "jnt_axis", "dof_damping", "dof_frictionloss"):
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
            "bij,bj,bkj->bik", data.ximat.reshape(-1, 3, 3), model.body_inertia, data.ximat.reshape(-1, 3, 3)
        )
        for model, data in zip((read, own), ends, strict=True)
    )
    assert one == pytest.approx(other, abs=1e-6)


def test_mujoco_reads_the_same_machine(tmp_path):
    reduced = replace(NOMINAL, drive="reduced")
    names = ("smartcar", "slope", "block", "flag", "wall")
    for machine, machines in [*((name, NOMINAL) for name in names), ("smartcar", reduced)]:
        path = write_urdf(tmp_path / "own.urdf", machine_spec(machine, machines))
        own = machine_spec(machine, machines).compile()
        read = mujoco.MjModel.from_xml_path(str(path))
        _assert_same(read, own)
        solid = (own.geom_contype | own.geom_conaffinity) != 0
        assert read.ngeom == np.count_nonzero(solid & (own.geom_bodyid > 0))


def test_a_world_is_written_with_everything_where_it_stands(tmp_path):
    grid = draw(
        (4, 3, 2), [(Kind.WALL, (0, 0, 1), 0), (Kind.BODY, (1, 1, 1), 0)], [(3, 0, 1, 2), (3, 2, 1, 1)]
    )
    world = world_spec(grid, SimulationConfig())
    path = write_urdf(tmp_path / "own.urdf", world)
    _assert_same(mujoco.MjModel.from_xml_path(str(path)), world.compile())


def test_limits_are_those_of_the_motors_and_the_file_says_what_it_lacks(tmp_path):
    path = write_urdf(tmp_path / "car.urdf", machine_spec("smartcar", NOMINAL))
    robot, car = Xml.parse(path).getroot(), NOMINAL.cars[0]
    limits = {joint.get("name"): joint.find("limit") for joint in robot.iter("joint")}
    board, wheel = (limits[name].attrib for name in ("board", "wheel_fl"))
    assert (float(board["effort"]), float(board["velocity"])) == (car.board_force_n, car.board_speed_m_s)
    assert (float(wheel["effort"]), float(wheel["velocity"])) == (car.wheel_torque_nm, car.wheel_speed_rad_s)
    assert LACKS in path.read_text(encoding="utf-8")
    assert all((tmp_path / mesh.get("filename")).is_file() for mesh in robot.iter("mesh"))


def test_show_writes_a_machine_or_a_world(tmp_path, capsys):
    files = ["--export", str(tmp_path / "own.xml"), str(tmp_path / "own.urdf")]
    for words, names in (
        (["slope"], {"slope", "flap"}),
        (["strip"], {"car0/smartcar", "car1/board"}),
    ):
        assert main(["show", *words, *files, "--drive", "reduced"]) == 0
        assert LACKS.split()[-1] in capsys.readouterr().out
        model = mujoco.MjModel.from_xml_path(str(tmp_path / "own.xml"))
        assert names <= {model.body(i).name for i in range(model.nbody)}
        assert mujoco.MjModel.from_xml_path(str(tmp_path / "own.urdf")).nbody == model.nbody
    for words in ([], ["slope"]):
        assert main(["show", *words]) == 2
