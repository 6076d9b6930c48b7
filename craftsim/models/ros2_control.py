"""Exported machines in ros2_control: the tags in their URDF, and the controllers of a car beside it.

Names and parameters are those of ros2_control's hardware components and of ros2_controllers'
``mecanum_drive_controller``, ``velocity_controllers`` and ``joint_state_broadcaster`` (control.ros.org, Jazzy and
later). Their mecanum controller has the kinematics of craftsim/skills/mecanum.py: x forward, y left, rollers in X.
"""

from __future__ import annotations

from typing import Final
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np

from craftsim.mjcf.building import CORNERS
from craftsim.models.config import SimulationConfig

_MOCK: Final = "mock_components/GenericSystem"
"""What answers until a simulator's or a machine's own plugin stands here: ros2_control brings it along."""
_WORDS: Final = {"fl": "front_left", "fr": "front_right", "rl": "rear_left", "rr": "rear_right"}
_SILENT_S: Final = 0.1
"""Time without a command after which a car stops, as the robots of ``craftsim robot serve`` do."""
_CONTROLLERS: Final = """\
# Controllers of {robot} in ros2_control, beside its URDF, whose <hardware> is a mock: put your plugin there.
/**:
  controller_manager:
    ros__parameters:
      update_rate: {rate_hz}
      joint_state_broadcaster:
        type: joint_state_broadcaster/JointStateBroadcaster
      mecanum_drive_controller:
        type: mecanum_drive_controller/MecanumDriveController
      board_controller:
        type: velocity_controllers/JointGroupVelocityController
  mecanum_drive_controller:
    ros__parameters:
      reference_timeout: {silent_s}
{wheels}
      kinematics:
        base_frame_offset: {{x: 0.0, y: 0.0, theta: 0.0}}
        wheels_radius: {radius_m}
        # Half the wheelbase plus half the track.
        sum_of_robot_center_projection_on_X_Y_axis: {lever_m}
      base_frame_id: {robot}
      odom_frame_id: odom
      enable_odom_tf: true
  board_controller:
    ros__parameters:
      joints: [{board}]
"""


def ros_name(name: str) -> str:
    """Return a name as ROS takes it."""
    return name.replace("/", "_")


def add_ros2_control(robot: Xml.Element, model: mujoco.MjModel, root: int) -> None:
    """Add a system with the motors of the machine with this root, whose commands are speeds, if it has any."""
    motors = _motors(model, root)
    if not motors:
        return
    name = ros_name(model.body(root).name)
    system = Xml.SubElement(robot, "ros2_control", name=name, type="system")
    hardware = Xml.SubElement(system, "hardware")
    Xml.SubElement(hardware, "plugin").text = _MOCK
    Xml.SubElement(hardware, "param", name="calculate_dynamics").text = "true"
    for number, motor in motors.items():
        joint = Xml.SubElement(system, "joint", name=ros_name(model.joint(number).name))
        command = Xml.SubElement(joint, "command_interface", name="velocity")
        low, high = model.actuator_ctrlrange[motor].tolist()
        Xml.SubElement(command, "param", name="min").text = str(low)
        Xml.SubElement(command, "param", name="max").text = str(high)
        for state in ("position", "velocity"):
            Xml.SubElement(joint, "state_interface", name=state)


def controllers_text(model: mujoco.MjModel, root: int) -> str | None:
    """Return the parameters of a car's controllers as YAML; None for what has no four wheels and a board."""
    joints = {model.joint(number).name: number for number in _motors(model, root)}
    by_part = {name.rpartition("/")[2]: name for name in joints}
    if by_part.keys() != {"board", *(f"wheel_{corner}" for corner in CORNERS)}:
        return None
    lines = []
    for corner, words in _WORDS.items():
        name = ros_name(by_part[f"wheel_{corner}"])
        lines.append(f"      {words}_wheel_command_joint_name: {name}")
    # A car's frame is on the floor, midway between its wheels.
    wheel = int(model.jnt_bodyid[joints[by_part["wheel_fl"]]])
    x_m, y_m, radius_m = model.body_pos[wheel].tolist()
    return _CONTROLLERS.format(
        robot=ros_name(model.body(root).name),
        rate_hz=round(1 / SimulationConfig().control_period_s),
        silent_s=_SILENT_S,
        wheels="\n".join(lines),
        radius_m=round(radius_m, 10),
        lever_m=round(x_m + y_m, 10),
        board=ros_name(by_part["board"]),
    )


def _motors(model: mujoco.MjModel, root: int) -> dict[int, int]:
    """Return the motor of each joint of a machine that has one, by the joint."""
    motors = {}
    for motor in np.flatnonzero(model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT).tolist():
        number = int(model.actuator_trnid[motor, 0])
        if model.body_rootid[model.jnt_bodyid[number]] == root:
            motors[number] = motor
    return motors
