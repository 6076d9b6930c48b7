"""A car of an MJCF file as a machine's parameters: what is read, what is assumed, and what cannot be represented.

A short mapping names the car's body, its lift and its wheels. Masses, motors, lift and geometry are read from the
compiled model. The car then drives as craftsim's own: on four mecanum wheels, with its board and boss. Three or more
omni wheels, and a holonomic base on planar joints, become four mecanum wheels whose force and speed along the car's
axes are the least that the base has in any direction.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np
from pydantic import Field

from craftsim.compiled.arrays import Floats
from craftsim.errors import InputError, suggestion
from craftsim.mjcf.machines import NOMINAL, Machines
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.storage.limits import MESH, MIB, MJCF, shorten, size_text
from craftsim.storage.reading import read_bytes, read_text
from craftsim.storage.records import record
from craftsim.storage.yaml import read_document
from craftsim.workers.copying import NotCopyable

_NAME_CHARACTERS: Final = 80
"""Of a name that is repeated in a message or a file."""
_Origin = Literal["read", "assumed", "left out"]
_PartName = Annotated[str, Field(max_length=_NAME_CHARACTERS)]

_CODE: Final = ("include", "plugin", "extension", "model", "attach")
"""Elements that name other files or code."""
_MULTIPLYING: Final = ("replicate", "composite", "flexcomp")
"""Elements that stand for any number of bodies."""
_UNUSED: Final = (
    "camera",
    "custom",
    "deformable",
    "hfield",
    "keyframe",
    "lengthrange",
    "light",
    "material",
    "sensor",
    "size",
    "skin",
    "statistic",
    "texture",
    "visual",
)
"""Elements that say nothing of a machine; some take memory at will."""
_UNUSED_ATTRIBUTES: Final = ("material", "nsample", "interp", "delay")
"""Of any element: what is seen alone, and what keeps past values, which takes memory at will."""
_MOST_ELEMENTS: Final = 10_000
_MOST_NESTED: Final = 100
_MESHES_BYTES: Final = 16 * MIB
"""Size of all meshes, each as often as an element names it: MuJoCo reads and measures it each time."""
_MOST_POINTS: Final = 2_000_000
"""Points on geoms that are looked at together; a vertex of a mesh is one."""
_LISTED: Final = 40
"""Other joints that are named."""
_OPTIONAL: Final = (
    "wheel_gain_nms_rad",
    "wheel_armature_kgm2",
    "wheel_damping_nms_rad",
    "board_speed_m_s",
    "board_stiffness_n_m",
    "board_gain_ns_m",
    "board_armature_kg",
    "board_damping_ns_m",
    "screw_friction_n",
)
"""Parameters of motors that a file may leave open."""
_SURFACE_POINTS: Final = 64
"""Around a round geom."""
_LEVEL: Final = 0.01
"""Largest part of an axle along z, and of a lift along x and y."""
_SAME_M: Final = 0.001
"""By which the heights of axles may differ."""
_DIGITS: Final = 6
_LARGEST: Final = 1e9
_NUMBERS: Final = (
    "actuator_gear",
    "actuator_gainprm",
    "actuator_biasprm",
    "actuator_ctrlrange",
    "actuator_forcerange",
    "body_mass",
    "body_pos",
    "body_ipos",
    "dof_armature",
    "dof_damping",
    "dof_frictionloss",
    "geom_friction",
    "geom_pos",
    "geom_size",
    "jnt_actfrcrange",
    "jnt_range",
    "site_pos",
)
"""What is read of a model, none of it larger."""
_GEOMETRY: Final = (
    "chassis_com_m",
    "chassis_length_m",
    "chassis_width_m",
    "chassis_bottom_m",
    "chassis_top_m",
    "wheel_width_m",
    "wheel_x_m",
    "wheel_y_m",
    "wheel_radius_m",
    "board_top_m",
    "board_travel_m",
)
"""Sizes, in the order in which they are taken one by one where not all of them fit."""


@record(kw_only=True)
class MecanumJoints:
    """The hinges of four mecanum wheels: front or rear, left or right."""

    fl: _PartName
    fr: _PartName
    rl: _PartName
    rr: _PartName


@record(kw_only=True)
class PlanarJoints:
    """The joints of a holonomic base: two slides and a hinge."""

    x: _PartName
    y: _PartName
    yaw: _PartName


@record(kw_only=True)
class CarMapping:
    """The names of a car's parts in an MJCF file; exactly one of ``mecanum``, ``omni`` and ``base``."""

    body: _PartName
    """Of the car, x forward, y left, z up."""
    lift: _PartName
    """The slide of the board."""
    top: _PartName | None = None
    """A site on the upper face of the lowered board, or a geom that ends there; default: the highest point of what is
    lifted."""
    mecanum: MecanumJoints | None = None
    omni: Annotated[tuple[_PartName, ...], Field(min_length=3, max_length=8)] | None = None
    """The hinges of omni wheels."""
    base: PlanarJoints | None = None

    def __post_init__(self) -> None:
        drives = [self.mecanum, self.omni, self.base]
        if drives.count(None) != len(drives) - 1:
            raise ValueError("exactly one of mecanum, omni and base is needed")


@dataclass(frozen=True)
class ReadFigure:
    """A parameter, or something that no parameter is for, and where its value is from."""

    name: str
    origin: _Origin
    words: str
    value: float | None = None


@dataclass
class CarReading:
    """The machines of a car that was read, and where each parameter is from."""

    machines: Machines = NOMINAL
    figures: list[ReadFigure] = field(default_factory=list)
    values: dict[str, float] = field(default_factory=dict)
    """Parameters that differ from the nominal ones."""

    def set(self, name: str, value: float, words: str, origin: _Origin = "read") -> None:
        """Set a parameter."""
        value = float(f"{value:.{_DIGITS}g}")
        if not math.isfinite(value):
            raise InputError(f"{name} of the car, {words}, is not finite")
        self.values[name] = value
        self.figures.append(ReadFigure(name, origin, words, value))

    def forget(self, name: str) -> None:
        """Leave a parameter at its nominal value."""
        del self.values[name]
        self.figures = [figure for figure in self.figures if figure.name != name]

    def assume_nominal(self, names: Sequence[str]) -> None:
        """Note of which parameters nothing was said."""
        known_names = {figure.name for figure in self.figures}
        for name in names:
            if name not in known_names:
                value = getattr(NOMINAL.cars[0], name)
                self.figures.append(ReadFigure(name, "assumed", "not given: nominal", value))

    def leave_out(self, name: str, words: str) -> None:
        """Note what is not as in the file."""
        self.figures.append(ReadFigure(name, "left out", words))


def read_car(path: Path, mapping_path: Path) -> CarReading:
    """Return the car of an MJCF file, by a mapping of its parts.

    Raises InputError for a file that names code or files elsewhere, for one of which MuJoCo makes no model, and for
    parts that are missing or of another kind.
    """
    mapping = read_document(mapping_path).to(CarMapping)
    parts = _Parts(path, _compiled(path), mapping)
    reading = CarReading()
    wheels = parts.wheels()
    _read_masses(parts, wheels, reading)
    if mapping.base is not None:
        _read_planar(parts, mapping.base, reading)
    else:
        _read_wheels(parts, wheels, reading)
    if wheels:
        _read_sizes(parts, wheels, reading)
    else:
        reading.leave_out("wheels, chassis", "a base on planar joints has none: nominal ones")
    _read_lift(parts, wheels, reading)
    others = parts.other_joints()
    for joint in others[:_LISTED]:
        reading.leave_out(joint, "a joint that is neither wheel nor lift: rigid, as at the start")
    if len(others) > _LISTED:
        reading.leave_out(f"{len(others) - _LISTED:,} further joints", "rigid, as at the start")
    _fit(reading)
    reading.assume_nominal(_OPTIONAL)
    return reading


def _compiled(path: Path) -> mujoco.MjModel:
    """Return the model of a file that names no code and no file outside its folder."""
    text = read_text(path, MJCF)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(f"{path}: document types and entities are not allowed")
    try:
        root = Xml.fromstring(text)
    except Xml.ParseError as error:
        raise InputError(f"{path}: not XML: {error}") from None
    if root.tag != "mujoco":
        raise InputError(f"{path}: is no MJCF file: begins with <{root.tag}>, not <mujoco>")
    _check_size(path, root)
    _leave_out_unused(root)
    meshes: dict[str, bytes] = {}
    meshes_bytes = 0
    directory = ""
    for compiler in root.iter("compiler"):
        directory = compiler.get("meshdir", compiler.get("assetdir", directory))
    for element in root.iter():
        if element.tag in _CODE:
            raise InputError(
                f"{path}: <{element.tag}> names code or another file; allowed: one file with everything, and meshes "
                f"within its folder"
            )
        if element.tag in _MULTIPLYING:
            raise InputError(f"{path}: <{element.tag}> is not allowed: write each body out")
        _check_numbers(path, element)
        if element.tag == "mesh" and element.get("builtin"):
            raise InputError(f"{path}: a mesh that is generated is not allowed: take a geom")
        for key, name in element.attrib.items():
            if not key.startswith("file"):
                continue
            if (element.tag, key) != ("mesh", "file"):
                raise InputError(f"{path}: <{element.tag} {key}='{name[:80]}'>: leave it out")
            if name not in meshes:
                meshes[name] = _mesh(path, directory, name)
            meshes_bytes += len(meshes[name])
            if meshes_bytes > _MESHES_BYTES:
                raise InputError(
                    f"{path}: meshes of more than {size_text(_MESHES_BYTES)}, each counted as often as it is named: "
                    f"leave out what is only seen, or take simpler ones"
                )
    try:
        with warnings.catch_warnings(action="error"):
            model = mujoco.MjSpec.from_string(_without_folders(root), assets=meshes).compile()
    except (ValueError, UserWarning) as error:
        raise InputError(f"{path}: MuJoCo makes no model of it: {error}") from None
    for name in _NUMBERS:
        if not (np.abs(getattr(model, name)) <= _LARGEST).all():
            raise InputError(f"{path}: a number of {name} is not finite or above {_LARGEST:g}")
    return model


def _check_size(path: Path, root: Xml.Element) -> None:
    """Raise InputError if there are too many elements, or too many in one another."""
    count = 0
    waiting = [(root, 1)]
    while waiting:
        element, depth = waiting.pop()
        count += 1
        if depth > _MOST_NESTED:
            raise InputError(f"{path}: elements are nested {depth} deep, at most {_MOST_NESTED}")
        if count > _MOST_ELEMENTS:
            raise InputError(f"{path}: has more than {_MOST_ELEMENTS:,} elements")
        waiting += [(child, depth + 1) for child in element]


def _leave_out_unused(root: Xml.Element) -> None:
    """Remove elements and attributes that say nothing of a machine."""
    for parent in list(root.iter()):
        for name in _UNUSED_ATTRIBUTES:
            parent.attrib.pop(name, None)
        for child in list(parent):
            if child.tag in _UNUSED:
                parent.remove(child)


def _check_numbers(path: Path, element: Xml.Element) -> None:
    """Raise InputError for a number that is not finite: MuJoCo takes 0 in its place."""
    for key, text in element.attrib.items():
        try:
            numbers = [float(word) for word in text.split()]
        except ValueError:
            continue  # a name, or a choice
        if not np.isfinite(numbers).all():
            raise InputError(f"{path}: <{element.tag} {key}='{text[:80]}'>: is not finite")


def _mesh(path: Path, directory: str, name: str) -> bytes:
    """Return a mesh file within the folder of an MJCF file."""
    folder = path.parent.resolve()
    file = (folder / directory / name).resolve()
    if not file.is_relative_to(folder):
        raise InputError(f"{path}: the mesh '{name[:80]}' is not within the folder of the file")
    return read_bytes(file, MESH)


def _without_folders(root: Xml.Element) -> str:
    """Return MJCF whose meshes are found by their names alone."""
    for compiler in root.iter("compiler"):
        for key in ("meshdir", "assetdir", "texturedir"):
            compiler.attrib.pop(key, None)
    return Xml.tostring(root, encoding="unicode")


@dataclass(frozen=True)
class _Wheel:
    """A wheel, in the frame of the car's body."""

    name: str
    joint: int
    place: Floats
    axis: Floats
    radius_m: float
    width_m: float
    friction: float
    mass_kg: float


@dataclass(frozen=True)
class _Motor:
    """What drives a joint; None where the model does not say."""

    name: str
    force: float | None
    speed: float | None
    stiffness: float | None
    gain: float | None


class _Parts(NotCopyable):
    """The named parts of a compiled car, its lift at the lower end."""

    _instead = "read the file again"

    def __init__(self, path: Path, model: mujoco.MjModel, mapping: CarMapping) -> None:
        self.path = path
        self.model = model
        self.mapping = mapping
        self.body = self._id("body", mapping.body)
        self.lift = self.joint(mapping.lift, mujoco.mjtJoint.mjJNT_SLIDE, "the lift")
        self.data = mujoco.MjData(model)
        self.data.qpos[model.jnt_qposadr[self.lift]] = model.jnt_range[self.lift, 0]
        mujoco.mj_kinematics(model, self.data)
        mujoco.mj_comPos(model, self.data)
        for numbers in (self.data.xanchor, self.data.xaxis, self.data.xipos, self.data.geom_xpos):
            if not np.isfinite(numbers).all():
                raise self.error("places or axes of its parts are not finite")
        self.lift_body = int(model.jnt_bodyid[self.lift])
        lift_axis = self.turned(self.data.xaxis[self.lift])
        if max(abs(lift_axis[0]), abs(lift_axis[1])) > _LEVEL:
            raise self.error(f"the lift '{mapping.lift}' does not move along z of the body")
        self._check_below(self.lift_body, mapping.lift)

    def error(self, words: str) -> InputError:
        """Return the error of this file."""
        return InputError(f"{self.path}: {words}")

    def _id(self, kind: Literal["body", "joint", "site"], name: str) -> int:
        number = mujoco.mj_name2id(
            self.model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), name
        )
        if number < 0:
            counts = {"body": self.model.nbody, "joint": self.model.njnt, "site": self.model.nsite}
            names = []
            for i in range(counts[kind]):
                names.append(shorten(getattr(self.model, kind)(i).name, _NAME_CHARACTERS))
            close = suggestion(name, names)
            listed = ", ".join(names[:20])
            raise self.error(f"there is no {kind} '{name}'{close}; there are {listed}")
        return int(number)

    def joint(self, name: str, kind: mujoco.mjtJoint, role: str) -> int:
        """Return the number of a joint of a kind."""
        number = self._id("joint", name)
        if self.model.jnt_type[number] != kind:
            words = {mujoco.mjtJoint.mjJNT_SLIDE: "slide", mujoco.mjtJoint.mjJNT_HINGE: "hinge"}
            raise self.error(f"{role} '{name}' is no {words[kind]} joint")
        return number

    def _check_below(self, body: int, joint: str) -> None:
        if self.body not in self._ancestors(body):
            raise self.error(f"the joint '{joint}' does not belong to '{self.mapping.body}'")

    def _ancestors(self, body: int) -> Iterator[int]:
        while body:
            yield body
            body = int(self.model.body_parentid[body])

    def below(self, body: int) -> list[int]:
        """Return a body and all that are attached to it."""
        return [b for b in range(1, self.model.nbody) if body in self._ancestors(b)]

    def turned(self, vectors: Floats) -> Floats:
        """Return vectors of the world in the frame of the car."""
        frame = self.data.xmat[self.body].reshape(3, 3)
        return np.asarray(vectors @ frame)

    def placed(self, points: Floats) -> Floats:
        """Return points of the world in the frame of the car."""
        return self.turned(points - self.data.xpos[self.body])

    def geoms(self, bodies: Sequence[int]) -> list[int]:
        """Return the geoms of bodies that touch something, or all if none does."""
        geoms = [g for g in range(self.model.ngeom) if self.model.geom_bodyid[g] in bodies]
        touching = []
        for geom in geoms:
            if self.model.geom_contype[geom] or self.model.geom_conaffinity[geom]:
                touching.append(geom)
        return touching or geoms

    def points(self, geoms: Sequence[int]) -> Floats:
        """Return (n, 3) points on geoms, that hold their extent, in the frame of the car."""
        parts = [np.empty((0, 3))]
        n_points = 0
        for geom in geoms:
            turn = self.data.geom_xmat[geom].reshape(3, 3)
            local = _surface_points(self.model, geom)
            n_points += len(local)
            if n_points > _MOST_POINTS:
                raise self.error(
                    f"geoms with more than {_MOST_POINTS:,} points: leave out what is only seen, or take simpler meshes"
                )
            parts.append(self.placed(local @ turn.T + self.data.geom_xpos[geom]))
        return np.concatenate(parts)

    def top(self) -> tuple[Floats, str]:
        """Return (n, 3) points of which the highest is on the upper face of the lowered board, and what they are."""
        name = self.mapping.top
        if name is None:
            points = self.points(self.geoms(self.below(self.lift_body)))
            return points, "highest point of what is lifted"
        geom = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_GEOM, name)
        if geom >= 0:
            return self.points([geom]), f"top of {name}"
        site = self._id("site", name)
        return self.placed(self.data.site_xpos[[site]]), f"site {name}"

    def wheels(self) -> list[_Wheel]:
        """Return the wheels, of mecanum ones in the order fl, fr, rl, rr."""
        mapping = self.mapping
        if mapping.mecanum is not None:
            corners = mapping.mecanum
            wheels = [self._wheel(n) for n in (corners.fl, corners.fr, corners.rl, corners.rr)]
            self._check_corners(wheels)
        elif mapping.omni is not None:
            wheels = [self._wheel(name) for name in mapping.omni]
        else:
            return []
        heights = [wheel.place[2] for wheel in wheels]
        if max(heights) - min(heights) > _SAME_M:
            raise self.error("the axles of the wheels are not at one height")
        return wheels

    def _wheel(self, name: str) -> _Wheel:
        joint = self.joint(name, mujoco.mjtJoint.mjJNT_HINGE, "the wheel")
        body = int(self.model.jnt_bodyid[joint])
        self._check_below(body, name)
        axis = self.turned(self.data.xaxis[joint])
        if abs(axis[2]) > _LEVEL:
            raise self.error(f"the axle of the wheel '{name}' is not level")
        place = self.placed(self.data.xanchor[joint])
        geoms = self.geoms(self.below(body))
        if not geoms:
            raise self.error(f"the wheel '{name}' has no geom, so that its radius is not known")
        offsets = self.points(geoms) - place
        along = offsets @ axis
        across = np.linalg.norm(offsets - np.outer(along, axis), axis=1)
        friction = float(self.model.geom_friction[geoms, 0].max())
        mass_kg = float(self.model.body_subtreemass[body])
        width_m = float(np.ptp(along))
        return _Wheel(name, joint, place, axis, float(across.max()), width_m, friction, mass_kg)

    def _check_corners(self, wheels: Sequence[_Wheel]) -> None:
        middle = np.mean([wheel.place for wheel in wheels], axis=0)
        signs = ((1, 1), (1, -1), (-1, 1), (-1, -1))
        for wheel, corner, (x, y) in zip(wheels, ("fl", "fr", "rl", "rr"), signs, strict=True):
            offset = wheel.place - middle
            if offset[0] * x <= 0 or offset[1] * y <= 0:
                raise self.error(
                    f"the wheel '{wheel.name}' is not the one at {corner}: x is forward, y left, and it is at "
                    f"{offset[0]:.3g}, {offset[1]:.3g}"
                )
            if abs(wheel.axis[0]) > _LEVEL:
                raise self.error(
                    f"the axle of '{wheel.name}' does not point to the side, as of a mecanum wheel; give 'omni' wheels"
                )

    def motor(self, joint: int) -> _Motor:
        """Return what drives a joint."""
        model = self.model
        name = model.joint(joint).name
        motors = []
        for actuator in range(model.nu):
            on_joint = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
            if on_joint and model.actuator_trnid[actuator, 0] == joint:
                motors.append(actuator)
        if len(motors) != 1:
            raise self.error(f"{len(motors)} actuators drive the joint '{name}'; needed is one")
        (motor,) = motors
        return _motor(model, joint, motor)

    def other_joints(self) -> list[str]:
        """Return the names of joints of the car that are neither wheel nor lift, nor move it about."""
        mapping = self.mapping
        named = {mapping.lift}
        if mapping.base is not None:
            named |= {mapping.base.x, mapping.base.y, mapping.base.yaw}
        wheel_bodies: set[int] = set()
        for wheel in self.wheels():
            wheel_bodies |= set(self.below(int(self.model.jnt_bodyid[wheel.joint])))
        names = []
        for joint in range(self.model.njnt):
            body = int(self.model.jnt_bodyid[joint])
            name = self.model.joint(joint).name or f"joint {joint}"
            is_of_car = self.body in self._ancestors(body) and body not in wheel_bodies
            is_free = self.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
            if is_of_car and not is_free and name not in named:
                names.append(shorten(name, _NAME_CHARACTERS))
        return names


def _surface_points(model: mujoco.MjModel, geom: int) -> Floats:
    """Return points (n, 3) on a geom, in its frame, that hold its extent."""
    size = model.geom_size[geom]
    kind = mujoco.mjtGeom(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first = int(model.mesh_vertadr[mesh])
        return np.asarray(model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])], float)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return np.array(np.meshgrid(*[(-s, s) for s in size])).reshape(3, -1).T
    turn = np.linspace(0.0, math.tau, _SURFACE_POINTS, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        half = np.array((0.0, 0.0, size[1]))
        return np.concatenate([ring * size[0] - half, ring * size[0] + half])
    radii = np.array(size)
    if kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE):
        radii = np.full(3, size[0])
    tilt = np.linspace(-math.pi / 2, math.pi / 2, _SURFACE_POINTS // 2 + 1)
    up = np.array((0.0, 0.0, 1.0))
    rings = [ring * math.cos(angle) + up * math.sin(angle) for angle in tilt]
    points = np.concatenate(rings) * radii
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        half = np.array((0.0, 0.0, size[1]))
        return np.concatenate([points - half, points + half])
    return points


def _motor(model: mujoco.MjModel, joint: int, motor: int) -> _Motor:
    """Return the limits and loops of an actuator, at its joint."""
    gear = abs(float(model.actuator_gear[motor, 0]))
    gain = abs(float(model.actuator_gainprm[motor, 0]))
    of_position = 0.0
    of_speed = 0.0
    if model.actuator_biastype[motor] == mujoco.mjtBias.mjBIAS_AFFINE:
        _, of_position, of_speed = model.actuator_biasprm[motor, :3].tolist()
    is_servo = of_position != 0 or of_speed != 0
    largest = None
    if model.actuator_ctrllimited[motor]:
        largest = float(np.abs(model.actuator_ctrlrange[motor]).max())
    forces = []
    if model.actuator_forcelimited[motor]:
        forces.append(gear * float(np.abs(model.actuator_forcerange[motor]).max()))
    if model.jnt_actfrclimited[joint]:
        forces.append(float(np.abs(model.jnt_actfrcrange[joint]).max()))
    if not is_servo and largest is not None:
        forces.append(gear * gain * largest)
    # The speed at which the servo's force is zero; an integrator's command is the speed of a position.
    opposing = 0.0
    if model.actuator_dyntype[motor] == mujoco.mjtDyn.mjDYN_INTEGRATOR:
        opposing = -of_position
    elif of_position == 0:
        opposing = -of_speed
    speed = None
    if opposing > 0 and largest is not None and gear > 0:
        speed = gain / opposing * largest / gear
    return _Motor(
        shorten(model.actuator(motor).name, _NAME_CHARACTERS) or f"actuator {motor}",
        min(forces, default=None),
        speed,
        _positive(-of_position * gear**2),
        _positive(-of_speed * gear**2),
    )


def _positive(value: float) -> float | None:
    if value > 0:
        return value
    return None


def _read_masses(parts: _Parts, wheels: Sequence[_Wheel], reading: CarReading) -> None:
    nominal = NOMINAL.cars[0]
    total_kg = float(parts.model.body_subtreemass[parts.body])
    board_kg = float(parts.model.body_subtreemass[parts.lift_body])
    reading.set("board_mass_kg", board_kg, "what the lift carries")
    if wheels:
        wheels_kg = sum(wheel.mass_kg for wheel in wheels)
        words = "mean of the wheels"
        if len(wheels) != 4:
            words = f"a quarter of {len(wheels)} wheels"
        origin: _Origin = "read"
    else:
        wheels_kg = (
            (total_kg - board_kg)
            * 4
            * nominal.wheel_mass_kg
            / (4 * nominal.wheel_mass_kg + nominal.chassis_mass_kg)
        )
        words = "the nominal car's share of its mass"
        origin = "assumed"
    chassis_kg = total_kg - wheels_kg - board_kg
    if chassis_kg <= 0:
        raise parts.error("the body has no mass besides its wheels and its lift")
    reading.set("chassis_mass_kg", chassis_kg, "all else below the body", origin)
    reading.set("wheel_mass_kg", wheels_kg / 4, words, origin)
    share = nominal.roller_mass_kg / nominal.wheel_mass_kg
    reading.set("roller_mass_kg", share * wheels_kg / 4, "the nominal share of a wheel", "assumed")
    softer = (total_kg / nominal.mass_kg) ** (1 / 3)
    words = "nominal tyres under this mass, by Hertz"
    reading.set("tyre_time_constant_s", nominal.tyre_time_constant_s * softer, words, "assumed")


def _mean(values: Sequence[float | None]) -> float | None:
    """Return the mean of numbers of equal parts; None where one is not known."""
    known_values = [value for value in values if value is not None]
    if len(known_values) < len(values):
        return None
    return float(np.mean(known_values))


def _read_wheels(parts: _Parts, wheels: Sequence[_Wheel], reading: CarReading) -> None:
    """Read motors and friction of wheels; other than four become four of the same force and speed."""
    nominal = NOMINAL.cars[0]
    model = parts.model
    motors = [parts.motor(wheel.joint) for wheel in wheels]
    names = ", ".join(motor.name for motor in motors)
    torque_nm = _mean([motor.force for motor in motors])
    if torque_nm is None:
        raise parts.error(f"no limit of the torque of {names}: give forcerange or actfrcrange")
    dofs = [int(model.jnt_dofadr[wheel.joint]) for wheel in wheels]
    friction_nm = float(model.dof_frictionloss[dofs].mean())
    origin: _Origin = "read"
    words = "frictionloss of the wheels' joints"
    if friction_nm <= 0:
        friction_nm = torque_nm * nominal.gear_friction_nm / nominal.wheel_torque_nm
        words = "no frictionloss given: the nominal share of the torque"
        origin = "assumed"
    share = 1.0
    ratio = 1.0
    if parts.mapping.omni is not None:
        share = _least_force(wheels) / 4
        ratio = len(wheels) / 4
        reading.leave_out(
            "omni wheels",
            f"driven as four mecanum wheels, each with {share:.3g} of the push of one, the least in any direction; "
            f"their places, and so how the car turns, are nominal",
        )
    gear_nm = ratio * friction_nm
    reading.set("gear_friction_nm", gear_nm, words, origin)
    words = f"limit of {names}"
    reading.set("wheel_torque_nm", gear_nm + share * (torque_nm - friction_nm), words)
    speed = _mean([motor.speed for motor in motors])
    if speed is None:
        reading.set("wheel_speed_rad_s", nominal.wheel_speed_rad_s, "no speed given", "assumed")
    else:
        reading.set("wheel_speed_rad_s", speed, "ctrlrange of the wheels' speed servos")
    gain = _mean([motor.gain for motor in motors])
    if gain is not None:
        reading.set("wheel_gain_nms_rad", ratio * gain, "speed servos of the wheels")
    armature = float(model.dof_armature[dofs].mean())
    if armature > 0:
        reading.set("wheel_armature_kgm2", ratio * armature, "armature of the wheels' joints")
    damping = float(model.dof_damping[dofs].mean())
    if damping > 0:
        reading.set("wheel_damping_nms_rad", ratio * damping, "damping of the wheels' joints")
    reading.set(
        "roller_friction", float(np.mean([w.friction for w in wheels])), "friction of the wheels"
    )


def _least_force(wheels: Sequence[_Wheel]) -> float:
    """Return the least force in any direction, without a turn, of wheels of which each pushes by 1 at most.

    Each pushes along its tread; the pushes are those of least norm, as controllers choose them.
    """
    middle = np.mean([wheel.place for wheel in wheels], axis=0)
    rows = []
    for wheel in wheels:
        push = np.cross(wheel.axis, (0.0, 0.0, 1.0))
        arm = wheel.place - middle
        rows.append((push[0], push[1], arm[0] * push[1] - arm[1] * push[0]))
    matrix = np.array(rows).T
    if np.linalg.matrix_rank(matrix, tol=1e-6) < 3:
        raise InputError("the omni wheels cannot push the car in all directions and turn it")
    shares = np.linalg.pinv(matrix)
    turn = np.linspace(0.0, math.pi, 181)
    pushes = shares @ np.stack([np.cos(turn), np.sin(turn), 0.0 * turn])
    return float(1.0 / np.abs(pushes).max())


def _read_planar(parts: _Parts, joints: PlanarJoints, reading: CarReading) -> None:
    """Read the motors of a base on planar joints, as those of four wheels."""
    nominal = NOMINAL.cars[0]
    parts.joint(joints.yaw, mujoco.mjtJoint.mjJNT_HINGE, "the base's yaw")
    slides = []
    for name in (joints.x, joints.y):
        slides.append(parts.joint(name, mujoco.mjtJoint.mjJNT_SLIDE, "the base's slide"))
    motors = [parts.motor(slide) for slide in slides]
    forces_n = [motor.force for motor in motors if motor.force is not None]
    if not forces_n:
        raise parts.error(
            f"no limit of the force of {motors[0].name}: give forcerange or actfrcrange"
        )
    push_nm = min(forces_n) * nominal.wheel_radius_m / 4
    share = nominal.gear_friction_nm / nominal.wheel_torque_nm
    torque_nm = push_nm / (1 - share)
    reading.set("wheel_torque_nm", torque_nm, "the least force of the base, on four wheels")
    reading.set("gear_friction_nm", share * torque_nm, "the nominal share of torque", "assumed")
    speeds = [motor.speed for motor in motors if motor.speed is not None]
    if speeds:
        speed = min(speeds) / nominal.wheel_radius_m
        reading.set("wheel_speed_rad_s", speed, "the least speed of the base")
    else:
        reading.set("wheel_speed_rad_s", nominal.wheel_speed_rad_s, "no speed given", "assumed")
    reading.leave_out("base", "driven by friction of four mecanum wheels, not by planar joints")


def _read_sizes(parts: _Parts, wheels: Sequence[_Wheel], reading: CarReading) -> None:
    places = np.array([wheel.place for wheel in wheels])
    middle = places.mean(axis=0)
    reading.set("wheel_radius_m", float(np.mean([w.radius_m for w in wheels])), "geoms of wheels")
    reading.set("wheel_width_m", float(np.mean([w.width_m for w in wheels])), "geoms of wheels")
    if parts.mapping.mecanum is not None:
        reach = np.abs(places - middle).mean(axis=0)
        reading.set("wheel_x_m", float(reach[0]), "places of the wheels")
        reading.set("wheel_y_m", float(reach[1]), "places of the wheels")
    moving = set(parts.below(parts.lift_body))
    for wheel in wheels:
        moving |= set(parts.below(int(parts.model.jnt_bodyid[wheel.joint])))
    bodies = [body for body in parts.below(parts.body) if body not in moving]
    points = parts.points(parts.geoms(bodies))
    if len(points):
        low = points.min(axis=0) - middle
        high = points.max(axis=0) - middle
        reading.set("chassis_length_m", 2 * max(-low[0], high[0]), "geoms of the body")
        reading.set("chassis_width_m", 2 * max(-low[1], high[1]), "geoms of the body")
        reading.set("chassis_bottom_m", low[2], "geoms of the body")
        reading.set("chassis_top_m", high[2], "geoms of the body")
    masses = parts.model.body_mass[bodies]
    centres = parts.placed(parts.data.xipos[bodies])
    com_m = float((masses @ centres)[2] / masses.sum() - middle[2])
    reading.set("chassis_com_m", com_m, "centre of mass of the body")


def _read_lift(parts: _Parts, wheels: Sequence[_Wheel], reading: CarReading) -> None:
    model = parts.model
    motor = parts.motor(parts.lift)
    dof = int(model.jnt_dofadr[parts.lift])
    if motor.force is None:
        reading.set("board_force_n", NOMINAL.cars[0].board_force_n, "no limit given", "assumed")
    else:
        reading.set("board_force_n", motor.force, f"limit of {motor.name}")
    if motor.speed is not None:
        reading.set("board_speed_m_s", motor.speed, f"ctrlrange of {motor.name}")
    if motor.stiffness is not None:
        reading.set("board_stiffness_n_m", motor.stiffness, f"position loop of {motor.name}")
    if motor.stiffness is not None and motor.gain is not None:
        reading.set("board_gain_ns_m", motor.gain, f"speed loop of {motor.name}")
    if model.dof_frictionloss[dof] > 0:
        reading.set("screw_friction_n", model.dof_frictionloss[dof], "frictionloss of the lift")
    if model.dof_armature[dof] > 0:
        reading.set("board_armature_kg", model.dof_armature[dof], "armature of the lift")
    if model.dof_damping[dof] > 0:
        reading.set("board_damping_ns_m", model.dof_damping[dof], "damping of the lift")
    if model.jnt_limited[parts.lift]:
        reading.set("board_travel_m", float(np.ptp(model.jnt_range[parts.lift])), "lift's range")
    else:
        reading.leave_out("board_travel_m", "the lift has no range: nominal")
    if not wheels:
        return
    axle_m = float(np.mean([wheel.place[2] for wheel in wheels]))
    points, words = parts.top()
    if len(points):
        reading.set("board_top_m", float(points[:, 2].max()) - axle_m, words)
    words = "those of the nominal car, for which blocks are made"
    reading.figures.append(ReadFigure("board, boss", "assumed", words))


def _fit(reading: CarReading) -> None:
    """Make the machines: with all sizes that were read, or with those that fit blocks and slopes, one by one."""
    values: dict[str, Any] = dict(reading.values)
    sizes: dict[str, Any] = {name: values.pop(name) for name in _GEOMETRY if name in values}
    car = replace(NOMINAL.cars[0], **values)
    try:
        reading.machines = Machines(cars=(replace(car, **sizes),))
        return
    except InputError:
        pass
    for name, size in sizes.items():
        try:
            size_alone: dict[str, Any] = {name: size}
            changed = replace(car, **size_alone)
            Machines(cars=(changed,))
        except InputError as error:
            words = str(error).replace("SmartcarParameters: ", "").replace("Machines: ", "")
            reading.forget(name)
            reading.leave_out(name, f"{size:.4g} does not fit: {words}")
        else:
            car = changed
    radius_m = sizes.get("wheel_radius_m", car.wheel_radius_m)
    if radius_m != car.wheel_radius_m:
        car = _scaled(car, car.wheel_radius_m / radius_m, reading)
    reading.machines = Machines(cars=(car,))


def _scaled(car: SmartcarParameters, factor: float, reading: CarReading) -> SmartcarParameters:
    """Return a car whose wheels, of another radius by a factor, push and roll as those that were read."""
    changed: dict[str, Any] = {"wheel_speed_rad_s": car.wheel_speed_rad_s / factor}
    powers = {
        "wheel_torque_nm": 1,
        "gear_friction_nm": 1,
        "wheel_gain_nms_rad": 2,
        "wheel_armature_kgm2": 2,
        "wheel_damping_nms_rad": 2,
    }
    for name, power in powers.items():
        changed[name] = getattr(car, name) * factor**power
    for name, value in changed.items():
        changed[name] = float(f"{value:.{_DIGITS}g}")
        for number, figure in enumerate(reading.figures):
            if figure.name == name:
                words = f"{figure.words}, for this radius"
                reading.figures[number] = replace(figure, value=changed[name], words=words)
    return replace(car, **changed)
