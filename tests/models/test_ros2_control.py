"""Exported machines in ros2_control: tags and controllers say what the model's parameters say."""

from dataclasses import replace
from xml.etree import ElementTree as Xml

import numpy as np
import pytest
import yaml
from discrete.drawn import draw

from craftsim.discrete.grid import Kind
from craftsim.mjcf.machines import NOMINAL
from craftsim.models.composition import machine_spec, world_spec
from craftsim.models.config import SimulationConfig
from craftsim.models.exporting import write_urdf
from craftsim.skills.mecanum import Mecanum

WIDE = replace(
    NOMINAL.cars[0],
    wheel_radius_m=0.049,
    wheel_x_m=0.063,
    wheel_y_m=0.085,
    wheel_speed_rad_s=15.0,
    board_speed_m_s=0.04,
)
PARTS = ("front_left", "front_right", "rear_left", "rear_right")
"""In the order of everything that is given per wheel."""


def ros2_control(path) -> tuple[Xml.Element, dict[str, Xml.Element]]:
    """Return the URDF of a file, and the joints in its only ros2_control tag by name."""
    robot = Xml.parse(path).getroot()
    (system,) = robot.findall("ros2_control")
    assert system.get("type") == "system"
    assert system.find("hardware/plugin").text == "mock_components/GenericSystem"
    assert system.find("hardware/param[@name='calculate_dynamics']").text == "true"
    return robot, {joint.get("name"): joint for joint in system.findall("joint")}


def assert_limits(robot: Xml.Element, name: str, joint: Xml.Element, speed: float) -> None:
    """Check that a joint is commanded a speed within limits, is one of the URDF, and says what it does."""
    (command,) = joint.findall("command_interface")
    assert command.get("name") == "velocity"
    limits = {parameter.get("name"): float(parameter.text) for parameter in command}
    assert limits == pytest.approx({"min": -speed, "max": speed})
    assert [state.get("name") for state in joint.findall("state_interface")] == [
        "position",
        "velocity",
    ]
    (limit,) = (own.find("limit") for own in robot.findall("joint") if own.get("name") == name)
    assert float(limit.get("velocity")) == pytest.approx(speed)


@pytest.mark.parametrize("drive", ["wheels", "rollers"])
@pytest.mark.parametrize("car", [NOMINAL.cars[0], WIDE], ids=["nominal", "wide"])
def test_tags_and_controllers_of_a_car_are_its_parameters(tmp_path, car, drive):
    machines = replace(NOMINAL, cars=(car,), drive=drive)
    urdf, controllers = write_urdf(tmp_path / "my.urdf", machine_spec("smartcar", machines))
    assert controllers == tmp_path / "my_controllers.yaml"
    robot, joints = ros2_control(urdf)
    nodes = yaml.safe_load(controllers.read_text(encoding="utf-8"))["/**"]
    manager, drives, board = (
        nodes[name]["ros__parameters"]
        for name in ("controller_manager", "mecanum_drive_controller", "board_controller")
    )
    assert manager.pop("update_rate") == round(1 / SimulationConfig().control_period_s)
    assert {name: kind["type"] for name, kind in manager.items()} == {
        "joint_state_broadcaster": "joint_state_broadcaster/JointStateBroadcaster",
        "mecanum_drive_controller": "mecanum_drive_controller/MecanumDriveController",
        "board_controller": "velocity_controllers/JointGroupVelocityController",
    }
    wheels = [drives.pop(f"{part}_wheel_command_joint_name") for part in PARTS]
    assert wheels == ["wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr"]
    assert board == {"joints": ["board"]}
    assert joints.keys() == {*wheels, "board"}
    for wheel in wheels:
        assert_limits(robot, wheel, joints[wheel], car.wheel_speed_rad_s)
    assert_limits(robot, "board", joints["board"], car.board_speed_m_s)
    kinematics = drives.pop("kinematics")
    assert kinematics.pop("base_frame_offset") == {"x": 0.0, "y": 0.0, "theta": 0.0}
    assert kinematics == {
        "wheels_radius": pytest.approx(car.wheel_radius_m),
        "sum_of_robot_center_projection_on_X_Y_axis": pytest.approx(car.wheel_x_m + car.wheel_y_m),
    }
    # ROS takes no integer for a parameter that is a double.
    assert all(
        type(value) is float for value in [*kinematics.values(), drives["reference_timeout"]]
    )
    assert drives == {
        "reference_timeout": 0.1,
        "base_frame_id": "smartcar",
        "odom_frame_id": "odom",
        "enable_odom_tf": True,
    }
    assert "smartcar" in {link.get("name") for link in robot.findall("link")}


def test_the_controller_turns_the_wheels_as_the_skills_do(tmp_path):
    """With the formula of mecanum_drive_controller (ros2_controllers, update_and_write_commands)."""
    machines = replace(NOMINAL, cars=(WIDE,))
    _, controllers = write_urdf(tmp_path / "my.urdf", machine_spec("smartcar", machines))
    nodes = yaml.safe_load(controllers.read_text(encoding="utf-8"))["/**"]
    kinematics = nodes["mecanum_drive_controller"]["ros__parameters"]["kinematics"]
    radius = kinematics["wheels_radius"]
    lever = kinematics["sum_of_robot_center_projection_on_X_Y_axis"]
    for x, y, turn in np.random.default_rng(0).uniform(-1, 1, (20, 3)):
        speeds = {
            "front_left": (x - y - lever * turn) / radius,
            "front_right": (x + y + lever * turn) / radius,
            "rear_right": (x - y + lever * turn) / radius,
            "rear_left": (x + y - lever * turn) / radius,
        }
        ours = Mecanum(WIDE).wheel_speeds((x, y, turn))
        assert [speeds[part] for part in PARTS] == pytest.approx(ours)


def test_each_car_of_a_world_has_its_own_and_what_has_no_motor_has_none(tmp_path):
    objects = [(Kind.BLOCK, (1, 1, 1), 0), (Kind.FSLOPE, (3, 1, 1), 1)]
    grid = draw((5, 3, 2), objects, [(0, 0, 1, 0), (0, 2, 1, 1)])
    written = write_urdf(tmp_path / "own.urdf", world_spec(grid, SimulationConfig()))
    controllers = [path for path in written if path.suffix == ".yaml"]
    assert [path.name for path in controllers] == [
        f"own_car{car}_smartcar_controllers.yaml" for car in (0, 1)
    ]
    names = {}
    for path in written:
        if path.suffix == ".urdf":
            robot = Xml.parse(path).getroot()
            names[path.stem] = [joint.get("name") for joint in robot.iterfind("ros2_control/joint")]
    for car, path in enumerate(controllers):
        text = path.read_text(encoding="utf-8")
        parameters = yaml.safe_load(text)["/**"]["mecanum_drive_controller"]["ros__parameters"]
        assert parameters["base_frame_id"] == f"car{car}_smartcar"
        in_file = [parameters[f"{part}_wheel_command_joint_name"] for part in PARTS]
        assert in_file == names.pop(f"own_car{car}_smartcar")[:4]
    slope = [joints for name, joints in names.items() if "slope" in name]
    others = [joints for name, joints in names.items() if "slope" not in name]
    assert [len(joints) for joints in slope] == [1]
    assert others == [[]]
