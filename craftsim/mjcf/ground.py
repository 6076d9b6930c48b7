"""The floor and the light of every world, and the physics settings that its machines are made for."""

from __future__ import annotations

import mujoco
from numpy.typing import ArrayLike

from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.mjcf.building import digits, surface, touching
from craftsim.mjcf.parameters import ContactParameters

GROUND = "ground"
"""The name of the floor's geom."""
FLOOR_RGBA = [0.80, 0.81, 0.80, 1.0]


def new_world(
    contact: ContactParameters, size: ArrayLike, middle: ArrayLike, visual: bool = True
) -> mujoco.MjSpec:
    """Return the spec of a world with a floor alone.

    Args:
        contact: how surfaces give way to each other.
        size: (3,) metres: half-lengths of the floor as it is drawn, 0 for endless; and what MuJoCo's viewer takes.
        middle: (3,) metres: where it is drawn.
        visual: whether it has light and textures.
    """
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
        **touching("things"),
        **surface(contact, contact.ground_friction),
    )
    if visual:
        _light(spec)
        _paint(spec, ground)
    return spec


def _light(spec: mujoco.MjSpec) -> None:
    spec.worldbody.add_light(
        name="sun",
        pos=[-1.5, -2.5, 5],
        dir=[0.28, 0.42, -0.86],
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        diffuse=[0.55, 0.54, 0.50],
        specular=[0.15, 0.15, 0.15],
    )
    view, head = spec.visual.global_, spec.visual.headlight
    view.offwidth, view.offheight, view.azimuth, view.elevation = 1920, 1080, 130, -30
    head.ambient, head.diffuse, head.specular = [0.38] * 3, [0.35] * 3, [0.05] * 3
    spec.visual.quality.shadowsize, spec.visual.quality.offsamples = 4096, 4
    spec.visual.map.znear, spec.visual.map.zfar = 0.02, 60
    spec.visual.rgba.haze = [0.86, 0.90, 0.95, 1]


def _paint(spec: mujoco.MjSpec, ground: mujoco.MjsGeom) -> None:
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.93, 0.95, 0.98],
        rgb2=[0.62, 0.72, 0.84],
        width=256,
        height=256,
    )
    spec.add_texture(
        name="floor",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        rgb1=FLOOR_RGBA[:3],
        mark=mujoco.mjtMark.mjMARK_EDGE,
        markrgb=[0.55, 0.57, 0.58],
        width=256,
        height=256,
    )
    # A tile of the texture is a grid cell: texrepeat counts tiles per two metres.
    tiles = digits(round(2 / CELL_PITCH_M, 7))
    floor = spec.add_material(
        name="floor", texuniform=True, texrepeat=[tiles, tiles], specular=0.1, shininess=0.1, reflectance=0
    )
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    ground.material = "floor"
