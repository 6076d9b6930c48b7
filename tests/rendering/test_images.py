"""Images for learning agree with the geometry of the world: colours, depth, and the machine that each pixel is of."""

import math

import numpy as np
import pytest

from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
from craftsim.discrete.grid import Grid, Kind
from craftsim.errors import InputError
from craftsim.mjcf.machines import NOMINAL
from craftsim.models.cameras import overview_aim
from craftsim.models.world import PhysicsWorld
from craftsim.rendering.cameras import View
from craftsim.rendering.images import FAR_M, LABELS, CameraImages, take_images
from craftsim.rendering.trajectory import SeenWorld

SIZE = (64, 48)
CAMERAS = ("overview", "top", "front:0")
NAMES = ("ground", "wall", "car 0", "block 0", "slope 0")


def world(block: int = 1, length: int = 6, goals: tuple = ()) -> PhysicsWorld:
    """A car that looks along x at a block, a slope beside them and a wall behind."""
    grid = Grid.empty((length, 2, 1), 1)
    grid.cars[0, :4] = 0, 0, 1, 0
    grid.kind[block, 0, 1] = Kind.BLOCK
    grid.kind[2, 1, 1] = Kind.FSLOPE
    grid.kind[length - 1, 1, 1] = Kind.WALL
    return PhysicsWorld(grid, goals=goals)


@pytest.fixture(scope="module")
def physics(rendering) -> PhysicsWorld:
    return world()


def seen_points(physics: PhysicsWorld, camera: str, depth: np.ndarray) -> np.ndarray:
    """Return the points (height, width, 3) of the world that pixels show, if depths are from the image plane."""
    seen = SeenWorld(physics)
    model, data = seen.model, seen.at(physics.data.qpos)
    number = model.camera("car0/front" if camera == "front:0" else camera).id
    height, width = depth.shape
    high = math.tan(math.radians(model.cam_fovy[number]) / 2)
    across = ((np.arange(width) + 0.5) / width * 2 - 1) * high * width / height
    up = (1 - (np.arange(height) + 0.5) / height * 2) * high
    rays = np.dstack([*np.meshgrid(across, up), np.full(depth.shape, -1.0)])
    return data.cam_xpos[number] + depth[:, :, None] * (
        rays @ data.cam_xmat[number].reshape(3, 3).T
    )


@pytest.mark.parametrize("camera", CAMERAS)
def test_depth_and_machines_are_those_of_the_world(physics, camera):
    """Bands: 0.2 mm of the floor, 2 mm of the outlines of what stands on it."""
    seen = take_images(physics, camera, SIZE)
    machine, label = np.moveaxis(seen["segmentation"], 2, 0)
    points = seen_points(physics, camera, seen["depth"])
    assert np.abs(points[machine == 0][:, 2]).max() < 2e-4
    assert ((machine < 0) == (seen["depth"] == FAR_M)).all()
    assert ((machine < 0) == (label < 0)).all()
    centres = {2: (0, 0), 3: (1, 0), 4: (2, 1), 1: (5, 1)}
    half = NOMINAL.block.side_m / 2
    for number in set(np.unique(machine).tolist()) - {-1, 0}:
        assert physics.machine_names.names[number] == NAMES[number]
        assert LABELS[label[machine == number].max()] == NAMES[number].split()[0]
        centre = (np.array(centres[number]) + 0.5) * CELL_PITCH_M
        # A folded slope's flap reaches over its cell by its heel's width, and a car of the floor is smaller.
        assert np.abs(points[machine == number][:, :2] - centre).max() < half + (
            0.01 if number == 4 else 2e-3
        )
    if camera == "top":
        assert set(np.unique(machine)) == {0, 1, 2, 3, 4}
        deck = points[machine == 3][:, 2]
        assert np.median(deck) == pytest.approx(NOMINAL.block.height_m, abs=1e-3)


def test_what_is_close_to_a_car_is_seen_however_large_the_world_is(physics):
    """MuJoCo's own near plane lies at 2 % of the world's size."""
    large = world(length=20)
    near, same = (take_images(one, "front:0", SIZE) for one in (physics, large))
    seen = SeenWorld(large).model
    znear_m = seen.vis.map.znear * seen.stat.extent
    block = near["segmentation"][:, :, 1] == LABELS.index("block")
    np.testing.assert_array_equal(block, same["segmentation"][:, :, 1] == LABELS.index("block"))
    np.testing.assert_allclose(near["depth"][block], same["depth"][block], atol=1e-5)
    assert near["depth"][block].min() < 0.08 < znear_m


def test_taking_images_changes_nothing(rendering):
    first, second = world(), world()
    take_images(first, "front:0", SIZE)
    for one in (first, second):
        one.drive(0, [5, 5, 5, 5])
        for _ in range(5):
            one.advance()
    np.testing.assert_array_equal(first.data.qpos, second.data.qpos)


def test_one_renderer_after_the_other_or_the_same_for_all_worlds_gives_the_same_images(rendering):
    other = Grid.empty((4, 2, 1), 2)
    other.cars[:, :4] = [[0, 0, 1, 0], [2, 1, 1, 2]]
    sites = [PhysicsWorld(other), world(block=3), world(block=3, goals=((4, 0, 1),))]
    with CameraImages(CAMERAS, SIZE) as images:
        together = [images.take(physics) for physics in sites]
        renderer = images._renderer
        again = images.take(sites[2])
        assert images._renderer is renderer
    for kind, array in again.items():
        np.testing.assert_array_equal(array, together[2][kind])
    for physics, taken in zip(sites[:2], together, strict=False):
        with CameraImages(CAMERAS, SIZE) as images:
            for kind, array in images.take(physics).items():
                np.testing.assert_array_equal(taken[kind], array)
    assert (together[1]["rgb"] != together[2]["rgb"]).any(), "a goal shows in the colours"
    for kind in ("depth", "segmentation"):
        np.testing.assert_array_equal(together[1][kind], together[2][kind])


def test_a_view_of_films_is_a_camera_too(physics):
    """The site's own overview, once as its camera and once as a view."""
    aim = overview_aim(physics.size, 2 * LEVEL_HEIGHT_M, SIZE[0] / SIZE[1])
    view = View(aim.fovy_deg, lambda time_s: aim)
    with CameraImages(["overview", view], SIZE, ("depth", "segmentation")) as images:
        taken = images.take(physics)
    assert (np.abs(np.diff(taken["depth"], axis=0)) > 1e-4).mean() < 0.01, "but for pixels at edges"
    assert np.diff(taken["segmentation"], axis=0).any(axis=-1).mean() < 0.01


def test_what_there_is_not_is_refused_with_what_there_is(physics):
    for arguments, message in (
        (
            ("fromt:0",),
            "unknown camera 'fromt:0'; did you mean 'front:0'.*there are overview, top, front:0",
        ),
        (("front:1",), "unknown camera 'front:1'"),
        (("top", (0, 48)), r"size is \(0, 48\); allowed: \(width, height\)"),
        (("top", (10_000, 10_000)), "4194304 at most"),
        (("top", SIZE, ("rgb", "deth")), "unknown kind of image 'deth'; did you mean 'depth'"),
        (("top", SIZE, ()), "one or more of rgb, depth, segmentation"),
    ):
        with pytest.raises(InputError, match=message):
            take_images(physics, *arguments)
