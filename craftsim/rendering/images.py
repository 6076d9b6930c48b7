"""Images as arrays for learning, from any camera of a world: colours, depth in metres, and what is seen where."""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Sequence
from typing import Any, Final, Literal, Self, get_args

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.errors import InputError, suggestion
from craftsim.mjcf.block import TABLE_NAMES
from craftsim.models.parts import MachineNames
from craftsim.models.world import PhysicsWorld
from craftsim.rendering.cameras import View
from craftsim.rendering.offscreen import make_renderer
from craftsim.rendering.trajectory import SeenWorld
from craftsim.storage.limits import IMAGE_PIXELS, PHYSICS_PARTS
from craftsim.workers.copying import Copyable

ImageKind = Literal["rgb", "depth", "segmentation"]
IMAGE_KINDS: Final[tuple[ImageKind, ...]] = get_args(ImageKind)
FAR_M: Final = 100.0
"""What is further from the image plane, or nothing at all, has this depth."""
LABELS: Final = tuple(
    dict.fromkeys(("ground", "wall", "car", "block", "flag", "slope", *TABLE_NAMES))
)
"""The kinds of machines, in the order of their numbers in a segmentation."""


PIXELS: Final[dict[ImageKind, tuple[tuple[int, ...], Any, float, float]]] = {
    "rgb": ((3,), np.uint8, 0, 255),
    "depth": ((), np.float32, 0.0, FAR_M),
    "segmentation": ((2,), np.int16, -1, PHYSICS_PARTS + 1),  # with the ground and the walls
}
"""Of each kind of image the shape of a pixel, its type, and its least and largest value."""

_Images = dict[str, NDArray[Any]]
"""By kind."""

_NEAR_M: Final = 0.005
"""What is nearer to a camera is cut away: a car's comes close to what the car docks with."""
_FIXED: Final = mujoco.mjtCamera.mjCAMERA_FIXED
_DRAWN: Final = (
    "ngeom",
    "nsite",
    "geom_dataid",
    "mesh_vert",
    "mesh_normal",
    "mesh_face",
    "tex_data",
)
"""Of a model: worlds in which these are equal are drawn by one renderer."""


def take_images(
    physics: PhysicsWorld,
    camera: str = "overview",
    size: tuple[int, int] = (640, 480),
    kinds: Sequence[ImageKind] = IMAGE_KINDS,
) -> _Images:
    """Return what a camera of a PhysicsWorld sees, as arrays by kind.

    Who takes many keeps a :class:`craftsim.rendering.images.CameraImages`: preparing takes a hundred times as long as
    an image.

    Args:
        physics: the world, as it stands.
        camera: ``overview``, ``top``, or ``front:CAR``, the one in the nose of a car, given by its number.
        size: width and height in pixels.
        kinds: ``rgb``, shape (height, width, 3), uint8; ``depth``, (height, width), float32, metres from the image
            plane along the camera's axis, not along each pixel's ray, and 100 where there is nothing; ``segmentation``,
            (height, width, 2), int16: the number of the machine in ``physics.machine_names.names``, that of its kind
            (0 ground, 1 wall, 2 car, 3 block, 4 flag, 5 slope), both -1 where there is nothing. Markers of goals show
            in the colours only.

    Raises:
        InputError: there is no such camera, size or kind.
        RenderingUnavailable: nothing renders on this machine.

    Example:
        >>> import craftsim
        >>> physics = craftsim.PhysicsWorld(craftsim.Grid.empty((3, 1, 1), n_cars=1))
        >>> seen = craftsim.take_images(physics, "top", size=(64, 48))
        >>> {kind: (array.shape, str(array.dtype)) for kind, array in seen.items()}
        {'rgb': ((48, 64, 3), 'uint8'), 'depth': ((48, 64), 'float32'), 'segmentation': ((48, 64, 2), 'int16')}
        >>> physics.machine_names.names[seen["segmentation"][24, 10, 0]]
        'car 0'
    """
    with CameraImages([camera], size, kinds) as images:
        return {
            kind: images_of_cameras[0] for kind, images_of_cameras in images.take(physics).items()
        }


class CameraImages(Copyable):
    """Takes images from cameras, of one world after the other; a context manager that closes its renderer.

    A copy makes a renderer of its own when it takes its first image.

    Images have no shadows and no anti-aliasing, which take three times as long where no GPU draws: each pixel shows
    what its depth and its label are of. Equal worlds give equal images, bit for bit on one machine.
    """

    _bound = ("_solids", "_physics", "_renderer", "_seen")

    def __init__(
        self,
        cameras: Sequence[str | View],
        size: tuple[int, int],
        kinds: Sequence[ImageKind] = IMAGE_KINDS,
    ) -> None:
        """Prepare for cameras, by name or as views of films; other arguments and errors as in :func:`take_images`."""
        check_images(size, kinds)
        self.cameras = tuple(cameras)
        self.size = size
        self.kinds = tuple(kinds)
        self._bind()

    def _bind(self) -> None:
        self._solids = mujoco.MjvOption()
        self._solids.sitegroup[:] = 0
        self._physics: PhysicsWorld | None = None
        self._renderer: mujoco.Renderer | None = None

    def take(
        self, physics: PhysicsWorld, qpos: NDArray[np.float64] | None = None, time_s: float = 0.0
    ) -> _Images:
        """Return what the cameras see of a world, each array with a leading dimension of one entry a camera.

        ``qpos`` (nq,) are MuJoCo's positions of everything, those of the world unless given; ``time_s`` moves views.
        """
        if physics is not self._physics:
            self._begin(physics)
        model = self._seen.model
        if qpos is None:
            data = self._seen.now()
        else:
            data = self._seen.at(qpos)
        width, height = self.size
        images_of: _Images = {}
        for kind in self.kinds:
            shape, dtype, _, _ = PIXELS[kind]
            images_of[kind] = np.empty((len(self.cameras), height, width, *shape), dtype)
        for place, camera in enumerate(self.cameras):
            if isinstance(camera, View):
                shot = camera.camera(time_s)
                # How much wider the view is than MuJoCo's free camera is for this model.
                wide = camera.fovy_deg
                usual = model.vis.global_.fovy
                zoom = math.tan(math.radians(wide) / 2) / math.tan(math.radians(usual) / 2)
            else:
                shot = mujoco.MjvCamera()
                zoom = 1.0
                shot.type = _FIXED
                shot.fixedcamid = camera_number(model, camera)
            for name, images in images_of.items():
                images[place] = self._image(name, shot, zoom, data)
        return images_of

    def _begin(self, physics: PhysicsWorld) -> None:
        self._seen = SeenWorld(physics)
        model = self._seen.model
        rendered_model = self._renderer and self._renderer.model
        if rendered_model is None or not all(
            np.array_equal(getattr(rendered_model, name), getattr(model, name)) for name in _DRAWN
        ):
            self.close()
            # Without anti-aliasing, and with depths as in _image.
            plain = copy.copy(model)
            plain.vis.quality.offsamples = 0
            plain.vis.global_.offwidth, plain.vis.global_.offheight = self.size
            plain.stat.extent = 1.0
            plain.vis.map.znear = _NEAR_M
            plain.vis.map.zfar = FAR_M
            self._renderer = make_renderer(plain, self.size)
        self._physics = physics
        names = MachineNames.of(model)
        label = [LABELS.index(name.split()[0]) for name in names.names]
        self._labels = np.column_stack([names.of_geom, np.array(label)[names.of_geom]]).astype(
            np.int16
        )

    def _image(
        self, kind: str, shot: mujoco.MjvCamera, zoom: float, data: mujoco.MjData
    ) -> NDArray[Any]:
        assert self._renderer is not None
        renderer = self._renderer
        scene = self._renderer.scene
        if kind == "rgb":
            options = mujoco.MjvOption()
        else:
            options = self._solids
        # Not the renderer's own: that draws the world for which it was made.
        mujoco.mjv_updateScene(
            self._seen.model, data, options, None, shot, mujoco.mjtCatBit.mjCAT_ALL.value, scene
        )
        for eye in scene.camera:
            scale = zoom * _NEAR_M / eye.frustum_near
            eye.frustum_bottom = scale * eye.frustum_bottom
            eye.frustum_top = scale * eye.frustum_top
            eye.frustum_center = scale * eye.frustum_center
            eye.frustum_width = scale * eye.frustum_width
            eye.frustum_near = _NEAR_M
            eye.frustum_far = FAR_M
        if kind == "depth":
            renderer.enable_depth_rendering()
        elif kind == "segmentation":
            renderer.enable_segmentation_rendering()
        pixels: NDArray[Any] = renderer.render()
        renderer.disable_depth_rendering()
        renderer.disable_segmentation_rendering()
        match kind:
            case "rgb":
                return pixels
            case "depth":
                return np.clip(pixels, 0.0, FAR_M, out=pixels)
            case "segmentation":
                geoms = pixels[:, :, 0]
                return np.where(geoms[:, :, None] < 0, np.int16(-1), self._labels[geoms])
            case _:
                raise ValueError(f"there are no images of the kind '{kind}'")

    def close(self) -> None:
        """Close the renderer."""
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = self._physics = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def check_images(size: object, kinds: Sequence[str]) -> None:
    """Raise InputError for a size or for kinds of images that there are not."""
    is_size = (
        isinstance(size, tuple) and len(size) == 2 and all(type(n) is int and n > 0 for n in size)
    )
    if not (is_size and size[0] * size[1] <= IMAGE_PIXELS):  # type: ignore[index]
        raise InputError(
            f"an image's size is {size!r}; allowed: (width, height) in pixels, 1 and more, {IMAGE_PIXELS} at most"
        )
    allowed = ", ".join(IMAGE_KINDS)
    if isinstance(kinds, str) or not kinds or len(set(kinds)) != len(kinds):
        raise InputError(f"the kinds of images are {kinds!r}; allowed: one or more of {allowed}")
    for kind in kinds:
        if kind not in IMAGE_KINDS:
            hint = suggestion(str(kind), IMAGE_KINDS)
            raise InputError(f"unknown kind of image '{kind}'{hint}; there are {allowed}")


def camera_number(model: mujoco.MjModel, camera: str) -> int:
    """Return the number of a camera of a world; raise InputError for one that it lacks."""
    # ``front:0`` is said for ``car0/front``.
    names = [re.sub(r"car(\d+)/(.+)", r"\2:\1", model.camera(n).name) for n in range(model.ncam)]
    if camera not in names:
        raise InputError(
            f"unknown camera '{camera}'{suggestion(str(camera), names)}; there are {', '.join(names)}"
        )
    return names.index(camera)
