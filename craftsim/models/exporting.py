"""Machines and worlds as MJCF text that opens alone in MuJoCo's viewer, and machines as URDF for other simulators.

``python -m craftsim.models.exporting`` writes the nominal machines into ``craftsim/mjcf``, or into another folder. URDF
has links, inertias, shapes, joints with limits, damping and friction, and motors as ros2_control names them
(craftsim/models/ros2_control.py); LACKS says what it has not. A file holds one machine whose root is free, since
readers such as PyBullet make of a floating joint to a world a fixed one. Exported cars bear rollers: a tyre's friction
along its rollers is no part of MJCF or URDF (craftsim/models/wheel_contacts.py).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Final
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from craftsim.errors import InputError
from craftsim.mjcf.block import TABLE_NAMES, TABLES
from craftsim.mjcf.building import SOLID_GROUP, TOUCHES
from craftsim.mjcf.machines import NOMINAL
from craftsim.models.composition import MACHINES, machine_spec
from craftsim.models.ros2_control import add_ros2_control, controllers_text, ros_name
from craftsim.storage.folders import directory_within, output_directory
from craftsim.storage.paths import exists, is_folder
from craftsim.storage.writing import write_whole
from craftsim.workers.interrupts import defer_interrupts

_TITLES: Final = {
    "ground": "The floor, the light and the physics settings of every world.",
    "smartcar": "A mecanum smartcar with a lifting board: forty free rollers, turned by four wheel motors.",
    **{name: TABLES[kind].title for name, kind in TABLE_NAMES.items()},
    "slope": "A ramp that folds into a box: a hollow base, and a wedge, the flap, on a motorised hinge.",
}
_SOURCE: Final = """
       Written from the builders and parameters in craftsim/mjcf by python -m craftsim.models.exporting.
       contype and conaffinity: TOUCHES in craftsim/mjcf/building.py says what touches what. """

LACKS: Final = (
    "URDF says nothing of contacts (what touches what, friction of surfaces), of motors besides the limits of joints, "
    "of the inertia of rotors, of gears that lock themselves, and of where joints are at the start: set these up in "
    "your simulator. PyBullet reads a sliding friction for each link; release its motors of the rollers."
)
_NEWER: Final = ' input="vel"'
"""What MuJoCo 3.17 writes of every motor whose command is a speed. Older releases refuse it, and without it the motor
is the same."""
_ROOT: Final = "world"
_UNLIMITED: Final = "1e6"
MeshFile = Callable[[str, ArrayLike, ArrayLike], str]
"""Takes the name, points and faces of a mesh into the files, and returns the name of its file."""


def mjcf_text(spec: mujoco.MjSpec) -> str:
    """Return the MJCF of a spec, which every supported release of MuJoCo reads; its meshes are in it."""
    spec.compile()
    text: str = spec.to_xml()
    return text.replace(_NEWER, "")


def machine_texts() -> dict[str, str]:
    """Return the MJCF of each nominal machine, alone on the floor, by the name of its file without its ending."""
    machines = replace(NOMINAL, drive="rollers")
    specs = {kind: machine_spec(kind, machines) for kind in MACHINES}
    for name, spec in specs.items():
        spec.comment = f" {_TITLES[name]}{_SOURCE}"
    return {name: mjcf_text(spec) for name, spec in specs.items()}


def write_mjcf(path: Path, spec: mujoco.MjSpec) -> Path:
    """Write a machine, or the start of a world before it settles, as one file; return its path."""
    return write_whole(new_file(path), mjcf_text(spec))


def new_file(path: Path) -> Path:
    """Return the path of a file to be written, in whose folder it can be; raise InputError for what is no such path."""
    if not path.name or is_folder(path):
        raise InputError(f"{path}: is a folder; give the name of a file")
    return output_directory(path.parent) / path.name


def write_urdf(path: Path, spec: mujoco.MjSpec) -> list[Path]:
    """Write each machine of a spec as a URDF file, and its meshes into a folder beside it; return the paths.

    The root of a file is the machine itself, and so free to move; a fixed machine hangs on a link ``world``. Beside a
    car's file stand its controllers in ros2_control, ``NAME_controllers.yaml``. One machine becomes ``path``. Several
    become files with their names added to that of ``path``, and a table of this name with the ending .csv says where
    each stands: x, y, z in metres, and roll, pitch and yaw in radians.
    """
    path = new_file(path)
    model = spec.compile()
    folder = f"{path.stem}_meshes"
    meshes = dict[str, str]()
    if exists(path.parent / folder) and not is_folder(path.parent / folder):
        raise InputError(
            f"{path.parent / folder}: is no folder; the meshes of {path.name} need one"
        )

    def mesh_file(name: str, points: ArrayLike, faces: ArrayLike) -> str:
        lines = [f"v {_numbers(point)}" for point in np.asarray(points, float)]
        lines += [f"f {a} {b} {c}" for a, b, c in (np.asarray(faces) + 1).tolist()]
        meshes[name] = "\n".join([*lines, ""])
        return f"{folder}/{name}.obj"

    roots = [body for body in range(1, model.nbody) if model.body_parentid[body] == 0]
    if not roots:
        raise InputError(f"{path}: the world has no machines to write")
    files = dict.fromkeys(roots, path)
    if len(roots) > 1:
        files = {
            root: path.with_name(f"{path.stem}_{_link(model, root)}{path.suffix}") for root in roots
        }
    texts = {files[root]: _urdf_text(model, root, mesh_file) for root in roots}
    for name, text in meshes.items():
        write_whole(directory_within(path.parent, folder) / f"{name}.obj", text)
    for file, text in texts.items():
        write_whole(file, text)
    written = list(texts)
    for root, file in files.items():
        controllers = controllers_text(model, root)
        if controllers is not None:
            controllers_file = file.with_name(f"{file.stem}_controllers.yaml")
            written.append(write_whole(controllers_file, controllers))
    if len(roots) > 1:
        written.append(_write_places(path.with_suffix(".csv"), model, files))
    return written


def _urdf_text(model: mujoco.MjModel, root: int, mesh_file: MeshFile) -> str:
    """Return the URDF of the machine with this root, which stands at the origin."""
    robot = Xml.Element("robot", name=_link(model, root))
    robot.append(Xml.Comment(f" {LACKS} "))
    # Other readers pass over this: MuJoCo's drops what has no mass of its own otherwise, and the paths of meshes.
    mujoco_element = Xml.SubElement(robot, "mujoco")
    off = dict.fromkeys(("strippath", "fusestatic", "balanceinertia"), "false")
    Xml.SubElement(mujoco_element, "compiler", off | {"discardvisual": "true"})
    if model.body_dofnum[root] == 0:
        Xml.SubElement(robot, "link", name=_ROOT)
        joint = _add(robot, "joint", name=f"{_link(model, root)}_fixed", type="fixed")
        _add(joint, "parent", link=_ROOT)
        _add(joint, "child", link=_link(model, root))
    for body in np.flatnonzero(model.body_rootid == root).tolist():
        _add_link(robot, model, body, mesh_file)
        if body != root:
            _add_joint(robot, model, body)
    add_ros2_control(robot, model, root)
    Xml.indent(robot)
    return Xml.tostring(robot, encoding="unicode") + "\n"


def _write_places(path: Path, model: mujoco.MjModel, files: dict[int, Path]) -> Path:
    """Write the table of where machines stand, by body and file."""
    lines = ["file,x_m,y_m,z_m,roll_rad,pitch_rad,yaw_rad"]
    for root, file in files.items():
        place = [*model.body_pos[root], *_angles(model.body_quat[root])]
        lines.append(",".join([file.name, *_numbers(place).split()]))
    return write_whole(path, "\n".join(lines) + "\n")


def _link(model: mujoco.MjModel, body: int) -> str:
    return ros_name(model.body(body).name)


def _add_link(robot: Xml.Element, model: mujoco.MjModel, body: int, mesh_file: MeshFile) -> None:
    link = _add(robot, "link", name=_link(model, body))
    touching = [
        geom
        for geom in np.flatnonzero(model.geom_bodyid == body).tolist()
        if _is_solid(model, geom)
    ]
    if touching:
        # Read by PyBullet, which multiplies the figures of two links; others pass over it.
        contact = _add(link, "contact")
        _add(contact, "lateral_friction", value=_friction(model, touching))
    if model.body_mass[body]:
        inertial = _add(link, "inertial")
        _add_origin(inertial, model.body_ipos[body], model.body_iquat[body])
        _add(inertial, "mass", value=model.body_mass[body])
        x, y, z = model.body_inertia[body]
        _add(inertial, "inertia", ixx=x, iyy=y, izz=z, ixy=0, ixz=0, iyz=0)
    for geom in np.flatnonzero(model.geom_bodyid == body).tolist():
        if _is_solid(model, geom):
            _add_shape(_add(link, "collision"), model, geom, mesh_file)
        if model.geom_group[geom] < SOLID_GROUP:
            visual = _add(link, "visual")
            _add_shape(visual, model, geom, mesh_file)
            material = _add(visual, "material", name=ros_name(model.geom(geom).name))
            _add(material, "color", rgba=model.geom_rgba[geom])


def _is_solid(model: mujoco.MjModel, geom: int) -> bool:
    """Return whether a geom touches what it meets.

    The guards of wheels do not: they touch other cars alone, which URDF cannot say, and on the floor they would roll in
    the rollers' place.
    """
    touches = int(model.geom_contype[geom]), int(model.geom_conaffinity[geom])
    guards = TOUCHES["guards"]
    return touches not in ((0, 0), (guards["contype"], guards["conaffinity"]))


def _friction(model: mujoco.MjModel, geoms: list[int]) -> float:
    """Return the sliding friction of a link: of the geoms that it stands on, which have priority, else the largest."""
    priority = model.geom_priority[geoms].max()
    deciding = [geom for geom in geoms if model.geom_priority[geom] == priority]
    return max(_sliding_friction(model, geom) for geom in deciding)


def _sliding_friction(model: mujoco.MjModel, geom: int) -> float:
    """Return a geom's sliding friction, which one with frictionless contacts does not have."""
    if model.geom_condim[geom] > 1:
        return float(model.geom_friction[geom, 0])
    return 0.0


def _add_shape(parent: Xml.Element, model: mujoco.MjModel, geom: int, mesh_file: MeshFile) -> None:
    """Add the shape of a geom; an ellipsoid, which URDF does not have, becomes a convex mesh."""
    size = model.geom_size[geom]
    kind = model.geom_type[geom]
    parent.set("name", ros_name(model.geom(geom).name))
    _add_origin(parent, model.geom_pos[geom], model.geom_quat[geom])
    shape = _add(parent, "geometry")
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        _add(shape, "box", size=2 * size)
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        _add(shape, "sphere", radius=size[0])
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        _add(shape, "cylinder", radius=size[0], length=2 * size[1])
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        with defer_interrupts():
            import trimesh

        ball = trimesh.creation.icosphere(subdivisions=2)
        name = "_".join(["ellipsoid", *(f"{1e6 * half:.0f}" for half in size)])
        _add(shape, "mesh", filename=mesh_file(name, ball.vertices * size, ball.faces))
    else:
        # Its points are in the frame of the geom that shows it.
        mesh = model.mesh(int(model.geom_dataid[geom]))
        points = model.mesh_vert[mesh.vertadr[0] :][: mesh.vertnum[0]]
        faces = model.mesh_face[mesh.faceadr[0] :][: mesh.facenum[0]]
        _add(shape, "mesh", filename=mesh_file(ros_name(mesh.name), points, faces))


def _add_joint(robot: Xml.Element, model: mujoco.MjModel, body: int) -> None:
    number = int(model.body_jntadr[body])
    limited = False
    name = f"{_link(model, body)}_fixed"
    kind = "fixed"
    if number >= 0:
        name = ros_name(model.joint(number).name)
        limited = bool(model.jnt_limited[number])
        kind = {
            mujoco.mjtJoint.mjJNT_SLIDE: "prismatic",
            mujoco.mjtJoint.mjJNT_HINGE: "revolute" if limited else "continuous",
        }[mujoco.mjtJoint(model.jnt_type[number])]
    joint = _add(robot, "joint", name=name, type=kind)
    _add_origin(joint, model.body_pos[body], model.body_quat[body])
    _add(joint, "parent", link=_link(model, int(model.body_parentid[body])))
    _add(joint, "child", link=_link(model, body))
    if kind == "fixed":
        return
    _add(joint, "axis", xyz=model.jnt_axis[number])
    dof = model.jnt_dofadr[number]
    _add(joint, "dynamics", damping=model.dof_damping[dof], friction=model.dof_frictionloss[dof])
    on_joints = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    motors = np.flatnonzero(on_joints & (model.actuator_trnid[:, 0] == number))
    effort = _UNLIMITED
    if len(motors):
        effort = model.actuator_forcerange[motors[0], 1]
    velocity = _UNLIMITED
    if len(motors):
        velocity = model.actuator_ctrlrange[motors[0], 1]
    low, high = model.jnt_range[number]
    ends = {}
    if limited:
        ends = {"lower": low, "upper": high}
    _add(joint, "limit", effort=effort, velocity=velocity, **ends)


def _add(parent: Xml.Element, tag: str, **values: str | ArrayLike) -> Xml.Element:
    """Add an element with texts, numbers, or lists of these as its attributes."""
    plain = {
        name: value if isinstance(value, str) else _numbers(value) for name, value in values.items()
    }
    return Xml.SubElement(parent, tag, plain)


def _numbers(values: ArrayLike) -> str:
    # An added 0 takes the sign from -0.
    return " ".join(
        f"{value + 0.0:.10g}" for value in np.atleast_1d(np.asarray(values, float)).tolist()
    )


def _add_origin(
    parent: Xml.Element, position: NDArray[np.float64], quaternion: NDArray[np.float64]
) -> None:
    _add(parent, "origin", xyz=position, rpy=_angles(quaternion))


def _angles(quaternion: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return roll, pitch and yaw in radians, as URDF takes them: about the fixed x, then y, then z axis."""
    with defer_interrupts():
        from trimesh.transformations import euler_from_quaternion

    roll, pitch, yaw = euler_from_quaternion(quaternion, "sxyz")
    return roll, pitch, yaw


if __name__ == "__main__":
    written_to = Path(sys.argv[1] if len(sys.argv) > 1 else str(files("craftsim.mjcf")))
    for machine, mjcf in machine_texts().items():
        write_whole(written_to / f"{machine}.xml", mjcf)
