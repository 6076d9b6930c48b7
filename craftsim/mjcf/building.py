"""What the builders of all machines share: the floor and its light, contacts, classes of geoms, and numbers in MJCF."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.mjcf.parameters import ContactParameters
from craftsim.mjcf.solids import ClosedSolid, Interval, Point, add_mesh, meshes

TOUCHES: Final = {
    "things": {"contype": 1, "conaffinity": 7},
    "wheels": {"contype": 2, "conaffinity": 0},
    "hulls": {"contype": 4, "conaffinity": 13},
    "guards": {"contype": 8, "conaffinity": 12},
    "flanks": {"contype": 10, "conaffinity": 12},
    "seen": {"contype": 0, "conaffinity": 0},
}
"""What touches what: the bits of each kind of surface. Things are the floor and all that stands
on it. Wheels, and the rollers of wheels, touch things; hulls touch things, other cars' hulls and guards; guards, the
envelopes of wheels, stand in for wheels between cars; flanks are guards that touch things as well. What is only seen
touches nothing."""
SOLID_GROUP = 3
SEEN_GROUP = 2
"""MuJoCo's viewer shows geoms of the second group, and not those of the first unless asked to."""
GROUND: Final = "ground"
"""The name of the floor's geom."""
FLOOR_RGBA: Final = [0.80, 0.81, 0.80, 1.0]
CORNERS: Final = {"fl": (1, 1), "fr": (1, -1), "rl": (-1, 1), "rr": (-1, -1)}
"""Of a car or a block: front or rear, left or right, and the signs of x and y."""


Pose = tuple[ArrayLike, ArrayLike]
"""Position, (3,) in metres, and unit quaternion, (4,) w, x, y, z, in the world."""
ORIGIN: Final[Pose] = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))


def digits(values: float | Iterable[float]) -> Any:
    """Return numbers that follow from parameters to ten digits: what sums and products add beyond is not theirs."""
    if isinstance(values, int | float):
        return float(f"{values:.10g}") + 0.0
    return [digits(value) for value in values]


def micro(values: float | Iterable[float]) -> Any:
    """Return masses, inertias or coordinates to a milligram, 1e-6 kg m^2 or a micrometre."""
    if isinstance(values, int | float):
        return round(values, 6) + 0.0
    return [micro(value) for value in values]


def friction(contact: ContactParameters, sliding: float) -> list[float]:
    """Return a surface's coefficients of sliding, torsional and rolling friction."""
    return [sliding, contact.torsional_friction_m, contact.rolling_friction_m]


def surface(contact: ContactParameters, sliding: float, stiffness: float = 1.0) -> dict[str, Any]:
    """Return the attributes of a geom with a sliding friction; ``stiffness`` is over that of other contacts."""
    # A contact of impedance d is as stiff as d / (1 - d).
    ends = contact.impedance_min, contact.impedance_max
    low, high = (round(stiffness * d / (1 - d + stiffness * d), 4) for d in ends)
    return {
        "friction": friction(contact, sliding),
        "solref": [contact.time_constant_s, contact.damping_ratio],
        "solimp": [low, high, contact.impedance_depth_m, 0.5, 2.0],
    }


SEEN: Final = {**TOUCHES["seen"], "mass": 0, "group": SEEN_GROUP}
"""The attributes of a geom that is only seen."""


def dry_friction(contact: ContactParameters) -> dict[str, Any]:
    """Return the attributes of a joint with dry friction."""
    impedance = contact.joint_impedance
    width = contact.joint_impedance_width
    return {
        "solref_friction": [contact.time_constant_s, contact.damping_ratio],
        "solimp_friction": [impedance, impedance, width, 0.5, 2.0],
    }


def set_inertia(body: mujoco.MjsBody, height_m: float, mass_kg: float, inertia_kgm2: Point) -> None:
    """Give a body its mass and its inertia about a centre of mass at a height on its z axis."""
    body.explicitinertial = True
    body.mass = digits(mass_kg)
    body.ipos = digits((0.0, 0.0, height_m))
    body.inertia = micro(inertia_kgm2)


def both(limit: float) -> list[float]:
    """Return the range from minus to plus a limit."""
    return [-limit, limit]


def volume(*spans: Interval) -> float:
    """Return the volume of a box over three intervals."""
    return math.prod(b - a for a, b in spans)


class MachineBuilder:
    """Adds one machine to the spec of a world."""

    def __init__(
        self,
        spec: mujoco.MjSpec,
        prefix: str,
        kind: str,
        visual: bool,
        looks: Callable[[Any], dict[str, list[ClosedSolid]]],
        parameters: Any,
        **solid: Any,
    ) -> None:
        """Begin a machine of a kind, such as ``block``; ``prefix`` begins the names of all its parts.

        ``visual`` is whether it has what is only seen, ``looks`` gives the solids of that by the names of meshes, from
        the machine's parameters; ``solid`` are attributes of the geoms that touch.
        """
        self.spec = spec
        self.prefix = prefix
        self.visual = visual
        self._kind = kind
        self._looks = looks
        self.parameters = parameters
        # Cars differ; other machines have equal meshes and classes of geoms, which a world has once.
        if kind == "smartcar":
            self._own = prefix
        else:
            self._own = ""
        self.solid = self.geoms("", **{"group": SOLID_GROUP} | solid)

    def geoms(self, name: str, **geom: Any) -> mujoco.MjsDefault:
        """Return a class of geoms, by default those that touch, with some attributes; it is made unless it is there."""
        full = f"{self._own}{self._kind}{name and '_'}{name}"
        defaults = self.spec.find_default(full)
        if defaults is None:
            defaults = self.spec.add_default(full, self.solid if name else self.spec.default)
            for attribute, value in geom.items():
                setattr(defaults.geom, attribute, value)
        return defaults

    def body(self, pose: Pose, free: bool = True) -> mujoco.MjsBody:
        """Add the machine's body at a pose, fixed or free to move; its free joint bears its name."""
        name = self.prefix + self._kind
        position, quaternion = (np.asarray(values, float) + 0.0 for values in pose)
        body = self.spec.worldbody.add_body(name=name, pos=position, quat=quaternion)
        if free:
            body.add_freejoint(name=name)
        return body

    def add(self, body: mujoco.MjsBody, of: mujoco.MjsDefault, name: str, **geom: Any) -> None:
        """Add a geom of a class."""
        body.add_geom(of, name=self.prefix + name, **geom)

    def add_box(
        self,
        body: mujoco.MjsBody,
        of: mujoco.MjsDefault,
        name: str,
        spans: Sequence[Interval],
        density: float,
    ) -> None:
        """Add a box over three intervals, with the mass that a density in kg/m^3 gives it."""
        middle = [(a + b) / 2 for a, b in spans]
        half = [(b - a) / 2 for a, b in spans]
        mass = micro(density * volume(*spans))
        self.add(body, of, name, pos=digits(middle), size=digits(half), mass=mass)

    def add_hull(
        self,
        body: mujoco.MjsBody,
        of: mujoco.MjsDefault,
        name: str,
        corners: ArrayLike,
        **geom: Any,
    ) -> None:
        """Add the convex solid of some corners, (n, 3)."""
        mesh = self._own + name
        if self.spec.mesh(mesh) is None:
            points = np.round(np.asarray(corners, float), 6).ravel() + 0.0
            self.spec.add_mesh(name=mesh, uservert=points)
        self.add(body, of, name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh, **geom)

    def show(
        self, body: mujoco.MjsBody, name: str, mesh: str, rgba: Sequence[float], **placement: Any
    ) -> None:
        """Add what is only seen, if that is wanted: one of the machine's meshes, or a geom of another type."""
        if not self.visual:
            return
        visual_class = self.geoms("seen", type=mujoco.mjtGeom.mjGEOM_MESH, **SEEN)
        if mesh:
            solid = meshes(self._looks, self.parameters)[mesh]
            placement["meshname"] = add_mesh(self.spec, self._own + mesh, solid)
        self.add(body, visual_class, name, rgba=rgba, **placement)

    def add_drive(
        self, name: str, kp: float, kv: float, speed: float, force: float, travel: float
    ) -> None:
        """Add a motor to a joint: its command is a speed, and it holds the position that it has reached."""
        full = self.prefix + name
        motor = self.spec.add_actuator(name=full, target=full, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_intvelocity(kp=kp, kv=kv)
        motor.ctrlrange = both(speed)
        motor.forcerange = both(force)
        motor.actrange = [0, travel]


# A tile of the texture is a grid cell: texrepeat counts tiles per two metres.
_SCENE: Final = f"""
<mujoco>
  <visual>
    <global offwidth="1920" offheight="1080" azimuth="130" elevation="-30"/>
    <headlight ambient=".38 .38 .38" diffuse=".35 .35 .35" specular=".05 .05 .05"/>
    <quality shadowsize="4096" offsamples="4"/>
    <map znear=".02" zfar="60"/>
    <rgba haze=".86 .9 .95 1"/>
  </visual>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1=".93 .95 .98" rgb2=".62 .72 .84" width="256"
             height="256"/>
    <texture name="floor" type="2d" builtin="flat" rgb1="{" ".join(map(str, FLOOR_RGBA[:3]))}" mark="edge"
             markrgb=".55 .57 .58" width="256" height="256"/>
    <material name="floor" texture="floor" texuniform="true" texrepeat="{2 / CELL_PITCH_M:.7f} {2 / CELL_PITCH_M:.7f}"
              specular=".1" shininess=".1" reflectance="0"/>
  </asset>
  <worldbody>
    <light name="sun" pos="-1.5 -2.5 5" dir=".28 .42 -.86" type="directional" diffuse=".55 .54 .5"
           specular=".15 .15 .15"/>
  </worldbody>
</mujoco>
"""
"""Light, sky and floor, for what is to be seen."""


def new_world(
    contact: ContactParameters, size: ArrayLike, middle: ArrayLike, visual: bool
) -> mujoco.MjSpec:
    """Return the spec of a world with a floor alone, and with light and textures if it is ``visual``.

    ``size`` are the half-lengths, (3,) metres, of the floor as it is drawn, 0 for endless, and what MuJoCo's viewer
    takes; ``middle`` (3,) is where it is drawn.
    """
    if visual:
        spec = mujoco.MjSpec.from_string(_SCENE)
    else:
        spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    # Joint damping is one of the forces that contacts are solved for; damped after that, rollers slip and rattle.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    ground = spec.worldbody.add_geom(
        name=GROUND,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=size,
        pos=middle,
        **TOUCHES["things"],
        **surface(contact, contact.ground_friction),
    )
    if visual:
        ground.material = "floor"
    return spec
