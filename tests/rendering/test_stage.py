"""The stage has the positions of the physics and adds what is only to be seen; the grid seen from above."""

import copy
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from rendering.recorded import record

from craftsim import Trajectory
from craftsim.discrete.drawing import KIND_COLOURS, car_colour
from craftsim.discrete.grid import CarField, Grid, Kind, Piece
from craftsim.rendering.cameras import make_view
from craftsim.rendering.grid_picture import CELL_PX, MARGIN_PX, levels_of, world_image
from craftsim.rendering.offscreen import make_renderer
from craftsim.rendering.stage import Stage
from craftsim.rendering.trajectory import GoalCell, show_at

SIZE = (160, 120)


@pytest.fixture(scope="module")
def standing() -> Trajectory:
    grid = Grid.empty((4, 3, 2), n_cars=2)
    grid.cars[1, CarField.X] = 1
    grid.kind[0, 2, 1] = Kind.BLOCK
    grid.kind[2, 1, 1] = Kind.FSLOPE
    trajectory = record(grid)
    design = (
        GoalCell("block", (0, 2, 1), -1),
        GoalCell("block", (3, 2, 1), -1),
        GoalCell("body", (2, 1, 1), 0),
        GoalCell("foot", (3, 1, 1), 0),
    )
    return replace(trajectory, story=replace(trajectory.story, design=design))


def _scene(stage: Stage, trajectory: Trajectory, qpos: np.ndarray, **how: bool) -> mujoco.MjvScene:
    data, scene = mujoco.MjData(stage.model), mujoco.MjvScene(stage.model, 1000)
    data.qpos[:] = qpos
    mujoco.mj_forward(stage.model, data)
    camera, all_of_it = (
        make_view("overview", trajectory, 4 / 3).camera(0.0),
        mujoco.mjtCatBit.mjCAT_ALL,
    )
    mujoco.mjv_updateScene(stage.model, data, mujoco.MjvOption(), None, camera, all_of_it, scene)
    stage.finish(scene, data.qpos, **how)
    return scene


def _drawn(scene: mujoco.MjvScene) -> list[mujoco.MjvGeom]:
    return [scene.geoms[i] for i in range(scene.ngeom)]


def _ghosts(scene: mujoco.MjvScene) -> list[mujoco.MjvGeom]:
    return [
        g for g in _drawn(scene) if g.transparent and g.category == mujoco.mjtCatBit.mjCAT_DECOR
    ]


@pytest.mark.parametrize("quality", ["draft", "paper"])
def test_a_stage_moves_as_the_physics_and_adds_nothing_that_touches(quality, standing):
    model, physics = Stage(standing, quality).model, standing.physics.model
    data, own = mujoco.MjData(model), mujoco.MjData(physics)
    own.qpos[:] = data.qpos[:] = standing.qpos[-1]
    mujoco.mj_forward(model, data)
    mujoco.mj_forward(physics, own)
    assert np.array_equal(data.xpos, own.xpos)
    touching = [[model.geom(g).name for g in pair] for pair in data.contact.geom]
    assert touching == [[physics.geom(g).name for g in pair] for pair in own.contact.geom]
    assert np.array_equal(model.body_mass, physics.body_mass)


def test_the_ghost_shows_what_the_design_still_wants(standing):
    stage, rest = Stage(standing, "draft"), standing.qpos[-1]
    meshes = {name: 2 * stage.model.mesh(name).id for name in ("block", "slope_flap")}
    found = _ghosts(_scene(stage, standing, rest))
    # One block stands in its place, as does the base of the slope; its flap is still folded.
    assert [ghost.dataid for ghost in found] == [meshes["block"], meshes["slope_flap"]]
    unfolded = rest.copy()
    unfolded[standing.physics.slopes[0].hinge.qpos] = 0.0
    assert [ghost.dataid for ghost in _ghosts(_scene(stage, standing, unfolded))] == [
        meshes["block"]
    ]
    assert not _ghosts(_scene(stage, standing, rest, ghost=False))


def test_a_ghost_is_where_the_real_thing_will_be(standing):
    stage = Stage(standing, "draft")
    unfolded = standing.qpos[-1].copy()
    unfolded[standing.physics.slopes[0].hinge.qpos] = 0.0
    away = unfolded.copy()
    away[standing.physics.slopes[0].base.qpos] += 1.0
    real = {}
    for geom in _drawn(_scene(stage, standing, unfolded)):
        if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM:
            real[stage.model.geom(geom.objid).name] = geom
    for name, ghost in zip(
        ("base", "flap"), _ghosts(_scene(stage, standing, away))[1:], strict=True
    ):
        twin = real[f"slope0/{name}_visual"]
        assert ghost.pos == pytest.approx(twin.pos, abs=2e-4)
        assert ghost.mat == pytest.approx(twin.mat, abs=2e-3)


@pytest.mark.parametrize("quality", ["draft", "paper"])
def test_what_stands_shades_a_light_floor_and_no_sky_is_seen(rendering, standing, quality):
    stage, view = Stage(standing, quality), make_view("overview", standing, SIZE[0] / SIZE[1])
    renderer, data = make_renderer(stage.model, SIZE), mujoco.MjData(stage.model)
    show_at(stage.model, data, standing.qpos[-1])
    stage.model.vis.global_.fovy = view.fovy_deg
    pictures = []
    for shadows in (False, True):
        renderer.update_scene(data, view.camera(0.0))
        stage.finish(renderer.scene, data.qpos)
        if shadows:
            stage.shade(renderer, data)
        pictures.append(renderer.render().astype(int))
    renderer.close()
    bright, shaded = pictures
    darker = (bright.sum(axis=2) - shaded.sum(axis=2)) > 60
    assert 0.005 < darker.mean() < 0.2
    # The edges of the picture are floor, evenly lit: neither sky nor speckles.
    edge = np.concatenate([shaded[0], shaded[:, 0], shaded[:, -1]])
    assert edge.min() > 180
    assert np.ptp(edge, axis=0).max() < 40


def _in_bytes(colour):
    return tuple(round(255 * part) for part in colour)


def test_a_tile_has_the_colour_of_what_is_there():
    grid = Grid.empty((2, 2, 2), n_cars=1)
    grid.kind[1, 0, 1], grid.kind[0, 1, 2] = Kind.BLOCK, Kind.BLOCK
    image = world_image(grid)

    def near_the_edge(level, x, y):
        """A place between a block's edge and its inner line, where a car has its nose or a wheel's gap."""
        column = MARGIN_PX + (level - 1) * (2 * CELL_PX + MARGIN_PX) + x * CELL_PX + CELL_PX // 2
        return tuple(image[MARGIN_PX + (1 - y) * CELL_PX + round(0.1 * CELL_PX), column].tolist())

    block = _in_bytes(KIND_COLOURS[Kind.BLOCK])
    assert near_the_edge(1, 1, 0) == near_the_edge(2, 0, 1) == block
    assert near_the_edge(1, 1, 1) == _in_bytes(KIND_COLOURS[Kind.GROUND])
    car = image[MARGIN_PX + CELL_PX : -MARGIN_PX, MARGIN_PX : MARGIN_PX + CELL_PX].reshape(-1, 3)
    assert (car == _in_bytes(car_colour(0))).all(axis=1).sum() > 200


def test_levels_with_nothing_are_left_out():
    grid = Grid.empty((2, 2, 4), n_cars=1)
    assert levels_of([grid]) == (1,)
    grid.kind[0, 0, 3] = Kind.BLOCK
    assert levels_of([grid], (0, 0, 2)) == (1, 2, 3)
    assert levels_of([grid], None, [Piece(Kind.BLOCK, (0, 0, 4), -1)]) == (1, 3, 4)


def test_a_world_is_not_changed_by_its_stage(standing):
    before = copy.copy(standing.model)
    Stage(standing, "paper")
    for name in ("geom_rgba", "geom_group", "geom_matid", "light_pos", "site_rgba"):
        assert np.array_equal(getattr(standing.model, name), getattr(before, name)), name
