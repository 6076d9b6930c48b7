"""The stage: the model that is rendered. It has the joints of the physics model, and geoms that are visual only.

Both qualities have a floor with the grid, its coordinates and soft shadows, and numbers on the cars. ``draft`` is
quick; in ``paper`` machines shade each other, and have materials and smoother edges.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import islice
from typing import Final, Literal, NamedTuple

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.arrays import Floats
from craftsim.discrete.drawing import Rgb, car_colour
from craftsim.discrete.geometry import CELL_PITCH_M, cell_position, yaw_angle
from craftsim.mjcf.block import block_looks
from craftsim.mjcf.machines import Machines
from craftsim.mjcf.slope import slope_looks
from craftsim.mjcf.solids import add_mesh, meshes
from craftsim.models.composition import world_spec
from craftsim.models.config import SimulationConfig
from craftsim.rendering.cameras import label_strip_m, reached_m
from craftsim.rendering.offscreen import upload_texture
from craftsim.rendering.trajectory import GoalCell, Trajectory
from craftsim.workers.copying import NotCopyable

Quality = Literal["draft", "paper"]
Pixels = NDArray[np.uint8]
"""A texture, shape (height, width, 3), red green blue."""
_Bytes = tuple[int, int, int]

FLOOR_RGB: Final = (243, 243, 241)
_AREA_RGB: Final = (253, 253, 251)
_LINE_RGB: Final = (196, 199, 202)
_EDGE_RGB: Final = (120, 126, 132)
_TEXT_RGB: Final = (92, 98, 104)
_PLATE_RGB: Final = (250, 250, 250)
_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
_CELL_PIXELS: Final = 160
_MOST_PIXELS: Final = 4096  # of a side of a texture: what every OpenGL has
_UNLIT: Final = 1e-3
"""Share of its colour that the floor takes from the light: it glows with the rest, and its texture has the shadows."""
_SHADOW_CELL_PIXELS: Final = 80
_SHADE: Final = ((1.0, 0.02, 0.34), (0.0, 0.14, 0.22))
"""Of the shadows on the floor, that of the sun and that of the open sky: how far they fall to the side over how far
things are up, in parts of the sun's slope; the width of their edges in cells; and how dark they are."""
_AROUND_M: Final = 30.0  # how far the floor goes on around the area: further than any camera sees
_PROUD_M: Final = 0.0005  # so high the area lies on the ground, so that the two do not flicker
_PLATE_M: Final = 0.0004  # half of the thickness of a car's number plates
_ONLY_SEEN: Final = {"contype": 0, "conaffinity": 0, "mass": 0.0, "group": 2}

_MATERIALS: Final = {
    "plastic": (0.45, 0.55),
    "rubber": (0.10, 0.10),
    "metal": (0.85, 0.75),
    "matt": (0.15, 0.20),
}
"""Specular and shininess."""
_WOOD: Final = "wood"
_WOOD_RGB: Final = (222, 178, 118)
_LOOKS: Final[dict[str, tuple[str, Rgb | None]]] = {
    "chassis_visual": ("plastic", None),
    "chassis_trim": ("plastic", (0.96, 0.96, 0.97)),
    "board_visual": ("metal", (0.78, 0.79, 0.80)),
    "board_pads": ("rubber", (0.13, 0.13, 0.14)),
    "lift_post": ("metal", (0.62, 0.64, 0.67)),
    "hub": ("metal", (0.50, 0.52, 0.55)),
    "roller": ("rubber", (0.14, 0.14, 0.15)),
    "table_visual": (_WOOD, (1.0, 1.0, 1.0)),
    "trim": (_WOOD, (0.66, 0.55, 0.46)),
    "flag_visual": ("plastic", None),
    "base_visual": ("matt", (0.40, 0.49, 0.58)),
    "flap_visual": ("matt", (0.56, 0.66, 0.75)),
    "gear": ("metal", (0.72, 0.66, 0.50)),
    "worm": ("metal", (0.52, 0.54, 0.57)),
    "knuckle": ("metal", (0.40, 0.42, 0.45)),
    "pad": ("rubber", (0.16, 0.17, 0.19)),
}
"""Material and colour (r, g, b; None leaves that which it has) of the visual geoms whose names begin so."""
_WALL_RGB: Final = (0.60, 0.60, 0.60)
_SKY_RGB: Final = (
    [0.97, 0.97, 0.97],
    [0.86, 0.86, 0.84],
)  # overhead and at the horizon, where the floor ends
_SUN: Final = np.array([-0.42, -0.38, 1.0])
"""Towards the light: from the left of the overview, so that shadows fall to the right and backwards."""
_SHADOW_PIXELS: Final = 4096
_SHADOW_RADII: Final = 1.4
"""Half the width of what a map of shadows covers, over the radius of the area. MuJoCo reads its maps by up to a pixel
too far out, which speckles faces with their own shadow towards the light, in the outer half of the map."""
_SHADOW_SHIFT: Final = 0.35
"""By so many radii the maps are moved towards the light: nothing then stands in that half."""
_FAR_RADII: Final = 40.0  # how far cameras and lights see

_GHOST_RGBA: Final = np.array([0.10, 0.62, 0.42, 0.16], np.float32)
_NEAR_M: Final = 0.02  # what stands nearer than this to its place fills it
_NEAR_RAD: Final = 0.15
_HINGE_RAD: Final = {
    "fslope": math.pi,
    "body": 0.0,
}  # angle at which the hinge of a slope is wanted


class Stage(NotCopyable):
    """The render model of a trajectory, with the shadows on its floor and the ghost of the design.

    A picture is made of data of its model with the positions of a sample: ``renderer.update_scene(data, camera)``,
    ``stage.finish(renderer.scene, data.qpos)``, ``renderer.render()``.
    """

    _instead = "make it again of the trajectory"

    def __init__(self, trajectory: Trajectory, quality: Quality) -> None:
        """Build the stage of a trajectory, in ``draft`` or ``paper`` quality."""
        story = trajectory.story
        physics = trajectory.physics
        recipe = story.recipe
        machines = story.recipe.setup.machines
        config = recipe.setup.simulation or SimulationConfig()
        spec = world_spec(recipe.grid, config, machines, recipe.goals)
        _number_cars(spec, machines, recipe.grid.n_cars)
        stage_meshes = meshes(block_looks, machines.block) | meshes(slope_looks, machines.slope)
        for name, mesh in stage_meshes.items():
            if name in _GHOST_MESHES:
                add_mesh(spec, name, mesh)
        if story.design:
            for marker in [site for site in spec.sites if site.name.startswith("goal")]:
                spec.delete(marker)  # the ghost shows them
        quads = spec.visual.quality
        # of a roller: forty a car are most of a picture's cost
        quads.numslices = 14
        quads.numstacks = 8
        _lay_floor(spec, recipe.grid.size, reached_m(trajectory))
        self.shadows = quality == "paper"
        """Whether machines are meant to be drawn with shadows; the floor has its own."""
        if quality == "paper":
            _light(spec, recipe.grid.size, reached_m(trajectory))
            _give_materials(spec)
        self.model: mujoco.MjModel = spec.compile()
        """Its ``qpos`` are those of the trajectory."""
        pieces = []
        for goal in story.design:
            for piece in _pieces(self.model, machines, goal):
                pieces.append(piece)
        self._pieces = pieces
        self._blocks = [block.qpos for block in physics.blocks]
        self._slopes = [(slope.base.qpos, slope.hinge.qpos) for slope in physics.slopes]
        self._floors = {self.model.geom(name).id for name in ("ground", "area")}
        self._shadow = _FloorShadow(self.model)

    def finish(self, scene: mujoco.MjvScene, qpos: Floats, ghost: bool = True) -> None:
        """Complete a scene of a renderer after ``update_scene``, which makes it anew, with the positions (nq,) that it
        shows.

        ``ghost`` says whether to draw what the design wants and does not stand in its place.
        """
        geoms = (scene.geoms[number] for number in range(scene.ngeom))
        floors = (
            g for g in geoms if g.objtype == mujoco.mjtObj.mjOBJ_GEOM and g.objid in self._floors
        )
        for geom in islice(floors, len(self._floors)):
            # What decorates shows shadows and casts none: without it a floor is speckled with its own.
            geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        for piece in self._pieces if ghost else ():
            if scene.ngeom == scene.maxgeom or self._stands(piece, qpos):
                continue
            geom = scene.geoms[scene.ngeom]
            mesh = mujoco.mjtGeom.mjGEOM_MESH
            mujoco.mjv_initGeom(geom, mesh, np.zeros(3), piece.pos, piece.mat, _GHOST_RGBA)
            geom.dataid = 2 * piece.mesh
            geom.category = mujoco.mjtCatBit.mjCAT_DECOR
            geom.transparent = 1
            scene.ngeom += 1

    def shade(self, renderer: mujoco.Renderer, data: mujoco.MjData) -> None:
        """Let the shadows of data of the model fall on the floor that a renderer draws."""
        self._shadow.cast(data)
        upload_texture(renderer, self._shadow.texture)

    def _stands(self, piece: _Piece, qpos: Floats) -> bool:
        if piece.slope:
            slopes = self._slopes
        else:
            slopes = [(at, at) for at in self._blocks]
        return any(
            math.dist(qpos[at : at + 3], piece.place) < _NEAR_M
            and (piece.angle is None or abs(qpos[hinge] - piece.angle) < _NEAR_RAD)
            for at, hinge in slopes
        )


# The goal ghost: what a design still wants, drawn translucent where it is to stand.

_GHOST_MESHES: Final = ("block", "slope_base", "slope_flap")


class _Piece(NamedTuple):
    """A block, or the base or the flap of a slope, that the design wants.

    ``place`` (3,) is that of the frame of the block or slope, ``angle`` that of a flap's hinge; ``pos`` (3,) and
    ``mat`` (9,) say where and how turned the mesh is drawn. In metres.
    """

    place: Floats
    angle: float | None
    slope: bool
    mesh: int
    pos: Floats
    mat: Floats


def _pieces(model: mujoco.MjModel, machines: Machines, goal: GoalCell) -> Iterator[_Piece]:
    """Yield what is to stand in a cell; nothing for the foot of a slope, which the flap of its body reaches."""
    place = cell_position(*goal.cell)
    heading = yaw_angle(max(goal.yaw, 0))
    turn = np.array([math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2)])
    if goal.kind == "block":
        yield _Piece(place, None, False, *_drawn(model, "block", place, turn))
    elif goal.kind in _HINGE_RAD:
        angle = _HINGE_RAD[goal.kind]
        slope = machines.slope
        axis = np.empty(3)
        folded = np.empty(4)
        mujoco.mju_rotVecQuat(axis, np.array([slope.hinge_x_m, 0.0, slope.hinge_z_m]), turn)
        mujoco.mju_mulQuat(
            folded, turn, np.array([math.cos(angle / 2), 0.0, -math.sin(angle / 2), 0.0])
        )
        yield _Piece(place, None, True, *_drawn(model, "slope_base", place, turn))
        yield _Piece(place, angle, True, *_drawn(model, "slope_flap", place + axis, folded))


def _drawn(
    model: mujoco.MjModel, name: str, place: Floats, turn: Floats
) -> tuple[int, Floats, Floats]:
    """Return a mesh's number, position and rotation: MuJoCo keeps meshes in the frame of their own inertia."""
    mesh = model.mesh(name).id
    pos = np.empty(3)
    quat = np.empty(4)
    mat = np.empty(9)
    mujoco.mju_rotVecQuat(pos, model.mesh_pos[mesh], turn)
    mujoco.mju_mulQuat(quat, turn, model.mesh_quat[mesh])
    mujoco.mju_quat2Mat(mat, quat)
    return mesh, place + pos, mat


class _FloorShadow(NotCopyable):
    """The soft shadows of all that collides on the floor, drawn into its texture: quick without a GPU, too."""

    _instead = "make its stage again"

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self.texture = model.texture("drawn").id
        height = int(model.tex_height[self.texture])
        width = int(model.tex_width[self.texture])
        first = int(model.tex_adr[self.texture])
        self._shown = model.tex_data[first : first + 3 * height * width].reshape(height, width, 3)
        self._plain = self._shown.copy()
        area = model.geom("area")
        self._corner = np.array([area.pos[0] - area.size[0], area.pos[1] + area.size[1]])
        self._pixels_m = _SHADOW_CELL_PIXELS / CELL_PITCH_M
        self._size = (2 * area.size[:2] * self._pixels_m).round().astype(int)
        floors = mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD
        solid = (model.geom_contype | model.geom_conaffinity) & ~np.isin(model.geom_type, floors)
        self._points = {geom: _corners(model, geom) for geom in np.flatnonzero(solid).tolist()}
        self._cast_at = np.full(model.nq, np.nan)

    def cast(self, data: mujoco.MjData) -> None:
        if np.array_equal(self._cast_at, data.qpos):
            return
        self._cast_at = data.qpos.copy()
        light = np.full(self._size[::-1], 1.0, np.float32)
        places = []
        for geom, points in self._points.items():
            places.append(points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom])
        for slope, edge, dark in _SHADE:
            shade = np.zeros(self._size[::-1], np.uint8)
            for place in places:
                flat = place[:, :2] - slope * place[:, 2:] * _SUN[:2] / _SUN[2]
                pixels = (flat - self._corner) * [self._pixels_m, -self._pixels_m]
                hull = cv2.convexHull((16 * pixels).round().astype(np.int32))
                cv2.fillConvexPoly(shade, hull, 255, cv2.LINE_AA, 4)
            soft = cv2.GaussianBlur(shade, (0, 0), edge * _SHADOW_CELL_PIXELS)
            light *= 1.0 - dark / 255 * soft.astype(np.float32)
        large = cv2.resize((255 * light).astype(np.uint8), self._shown.shape[1::-1])
        cv2.multiply(self._plain, cv2.cvtColor(large, cv2.COLOR_GRAY2RGB), self._shown, 1 / 255)


def _corners(model: mujoco.MjModel, geom: int) -> Floats:
    """Return points (n, 3) in the frame of a geom whose convex hull it is, or fits into."""
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        points: Floats = model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(
            np.float64
        )
        return points
    middle = model.geom_aabb[geom, :3]
    half = model.geom_aabb[geom, 3:]
    return middle + half * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


# What is added to the world.


def _number_cars(spec: mujoco.MjSpec, machines: Machines, n_cars: int) -> None:
    """Put each car's number on its boss, upright as seen from behind, on its nose and on its tail."""
    for number in range(n_cars):
        car = machines.car(number)
        name = f"plate{number}"
        _painted(spec, name, number_plate(number)).specular = 0.2
        lid = 0.42 * car.boss_top_side_m
        nose = 0.012
        end = car.chassis_length_m / 2 - 0.0018
        height = car.wheel_radius_m + car.chassis_top_m - 0.017
        for body, place, half, turns in (
            ("board", [0.0, 0.0, car.boss_height_m + 0.0008], lid, [0.0, 0.0, -math.pi / 2]),
            ("smartcar", [end, 0.0, height], nose, [0.0, math.pi / 2, math.pi / 2]),
            ("smartcar", [-end, 0.0, height], nose, [0.0, -math.pi / 2, -math.pi / 2]),
        ):
            quaternion = np.empty(4)
            mujoco.mju_euler2Quat(quaternion, np.array(turns), "xyz")
            spec.body(f"car{number}/{body}").add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=place,
                quat=quaternion,
                size=[half, half, _PLATE_M],
                material=name,
                rgba=[1.0, 1.0, 1.0, 1.0],
                **_ONLY_SEEN,
            )


def _lay_floor(spec: mujoco.MjSpec, size: tuple[int, ...], height_m: float) -> None:
    """Draw the floor of an area of ``size`` cells, as far as shadows from a height fall, and bare floor around it."""
    margin_m = height_m * float(np.abs(_SUN[:2]).max()) / _SUN[2]
    bare = spec.add_material(name="bare", rgba=[*(_UNLIT * c / 255 for c in FLOOR_RGB), 1.0])
    floor_material = _painted(spec, "drawn", floor(size[0], size[1], margin_m))
    floor_material.rgba = [_UNLIT, _UNLIT, _UNLIT, 1.0]
    for material in (bare, floor_material):
        material.specular = material.shininess = 0.0
        material.emission = 1 / _UNLIT
    strip = label_strip_m(*size[:2]) + margin_m
    length, width = (n * CELL_PITCH_M / 2 for n in size[:2])
    ground = spec.geom("ground")
    ground.material = "bare"
    ground.size = [length + _AROUND_M, width + _AROUND_M, 0.05]
    spec.worldbody.add_geom(
        name="area",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=[length, width, _PROUD_M],
        size=[length + strip, width + strip, 0.05],
        material="drawn",
        contype=0,
        conaffinity=0,
    )


def _light(spec: mujoco.MjSpec, size: tuple[int, ...], height_m: float) -> None:
    """Light an area of ``size`` cells, built up to a height, with a sun that casts shadows."""
    sky = spec.texture("sky")
    sky.rgb1, sky.rgb2 = _SKY_RGB
    spec.delete(spec.light("sun"))
    head = spec.visual.headlight
    head.ambient = [0.52] * 3
    head.diffuse = [0.16] * 3
    head.specular = [0.05] * 3
    centre = np.array([size[0] * CELL_PITCH_M, size[1] * CELL_PITCH_M, height_m]) / 2
    radius = float(np.linalg.norm(centre))
    aside = _SHADOW_SHIFT * radius * np.array([*_SUN[:2], 0.0]) / float(np.hypot(*_SUN[:2]))
    towards = _SUN / np.linalg.norm(_SUN)
    spec.worldbody.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=centre + aside + 3 * radius * towards,
        dir=-towards,
        diffuse=[0.42] * 3,
        specular=[0.30] * 3,
        castshadow=True,
    )
    spec.visual.quality.shadowsize = _SHADOW_PIXELS
    spec.visual.quality.offsamples = 8
    spec.visual.map.shadowclip = _SHADOW_RADII
    spec.visual.map.zfar = _FAR_RADII
    spec.stat.extent = radius
    spec.stat.center = centre


def _give_materials(spec: mujoco.MjSpec) -> None:
    for name, (specular, shininess) in _MATERIALS.items():
        spec.add_material(name=name, specular=specular, shininess=shininess)
    grain = _painted(spec, _WOOD, _wood(np.random.default_rng(0)))
    grain.specular = 0.12
    grain.shininess = 0.2
    for geom in spec.geoms:
        geom_material, rgb = _look(geom.name, geom.group)
        if geom_material:
            geom.material = geom_material
        if rgb is not None:
            geom.rgba = [*rgb, 1.0]


def _look(name: str, group: int) -> tuple[str, Rgb | None]:
    machine, _, part = name.partition("/")
    look = next((look for start, look in _LOOKS.items() if part.startswith(start)), ("", None))
    if group != 2:
        return "", None
    if look[0] and machine.startswith("wall"):
        return "matt", _WALL_RGB
    return look


def dressed_rgb(name: str, group: int) -> Rgb | None:
    """Return the ``paper`` colour of a geom such as ``car0/board_visual``; None for one that keeps its own."""
    material, rgb = _look(name, group)
    if rgb is None or material != _WOOD:
        return rgb
    red, green, blue = (tint * grain / 255 for tint, grain in zip(rgb, _WOOD_RGB, strict=True))
    return red, green, blue


# Textures.


def _painted(spec: mujoco.MjSpec, name: str, pixels: Pixels) -> mujoco.MjsMaterial:
    """Add a texture, for a plane or the six sides of a thing, and a material that shows it; return the material."""
    texture = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D)
    texture.height, texture.width, texture.nchannel = pixels.shape
    texture.data = pixels.tobytes()
    material = spec.add_material(name=name)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    return material


def floor(length: int, width: int, beyond_m: float = 0.0) -> Pixels:
    """Return an area of ``length`` x ``width`` cells seen from above, x to the right and y upwards.

    In a strip around it stand the coordinates of the cells: those along x below the area, those along y to its right.
    So many metres beyond it are bare.
    """
    strip_cells = label_strip_m(length, width) / CELL_PITCH_M
    beyond_cells = beyond_m / CELL_PITCH_M
    around = 2 * (strip_cells + beyond_cells)
    pitch = min(_CELL_PIXELS, int(_MOST_PIXELS / (max(length, width) + around)))
    strip = round(strip_cells * pitch)
    margin = round(beyond_cells * pitch)
    right = strip + length * pitch
    bottom = strip + width * pitch
    picture = np.full((bottom + strip, right + strip, 3), FLOOR_RGB, np.uint8)
    picture[strip:bottom, strip:right] = _AREA_RGB
    thin = max(1, pitch // 60)
    thick = max(2, pitch // 40)
    tall = 0.55 * strip
    for x in range(strip + pitch, right, pitch):
        cv2.line(picture, (x, strip), (x, bottom), _LINE_RGB, thin, cv2.LINE_AA)
    for y in range(strip + pitch, bottom, pitch):
        cv2.line(picture, (strip, y), (right, y), _LINE_RGB, thin, cv2.LINE_AA)
    cv2.rectangle(picture, (strip, strip), (right, bottom), _EDGE_RGB, thick, cv2.LINE_AA)
    for cell in range(length):
        _write(picture, str(cell), (strip + (cell + 0.5) * pitch, bottom + tall), tall, _TEXT_RGB)
    for cell in range(width):
        _write(picture, str(cell), (right + tall, bottom - (cell + 0.5) * pitch), tall, _TEXT_RGB)
    bare = np.full(
        (picture.shape[0] + 2 * margin, picture.shape[1] + 2 * margin, 3), FLOOR_RGB, np.uint8
    )
    bare[margin : margin + picture.shape[0], margin : margin + picture.shape[1]] = picture
    return bare


def number_plate(number: int) -> Pixels:
    """Return a car's number on a plate of the car's colour with a white rim."""
    side = 256
    text = str(number)
    picture = np.full(
        (side, side, 3), [round(255 * channel) for channel in car_colour(number)], np.uint8
    )
    cv2.rectangle(picture, (10, 10), (side - 11, side - 11), _PLATE_RGB, 8, cv2.LINE_AA)
    height = side * (0.60 if len(text) == 1 else 0.44)
    _write(picture, text, (side / 2, side / 2), height, _PLATE_RGB, 0.13)
    return picture


def _wood(rng: np.random.Generator) -> Pixels:
    side = 512
    rows = np.arange(side)[:, None]
    bend = cv2.GaussianBlur(rng.normal(0, 1, (side, side)), (0, 0), 60) * 900
    rings = 0.5 + 0.5 * np.sin((rows + bend) / 9.0)
    fibre = cv2.GaussianBlur(rng.normal(0, 1, (side, side)), (0, 0), sigmaX=24, sigmaY=0.8)
    shade = 1.0 - 0.07 * rings + 0.35 * fibre / fibre.std() * 0.1
    picture: Pixels = np.clip(shade[:, :, None] * _WOOD_RGB, 0, 255).astype(np.uint8)
    return picture


def _write(
    picture: Pixels,
    text: str,
    centre: tuple[float, float],
    height: float,
    rgb: _Bytes,
    weight: float = 0.10,
) -> None:
    thickness = max(1, round(weight * height))
    scale = cv2.getFontScaleFromHeight(_FONT, max(4, round(height)), thickness)
    (width, tall), _ = cv2.getTextSize(text, _FONT, scale, thickness)
    corner = round(centre[0] - width / 2), round(centre[1] + tall / 2)
    cv2.putText(picture, text, corner, _FONT, scale, rgb, thickness, cv2.LINE_AA)
