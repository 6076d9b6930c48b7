"""The stage has the positions of the physics, and what it adds is only to be seen."""

import copy
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from recorded import record

from craftsim import Trajectory
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.rendering.cameras import make_view
from craftsim.rendering.offscreen import make_renderer
from craftsim.rendering.playback import Posed
from craftsim.rendering.stage import Stage
from craftsim.rendering.trajectory import GoalCell

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
    camera, all_of_it = make_view("overview", trajectory, 4 / 3).camera(0.0), mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(stage.model, data, mujoco.MjvOption(), None, camera, all_of_it, scene)
    stage.finish(scene, data.qpos, **how)
    return scene


def _drawn(scene: mujoco.MjvScene) -> list[mujoco.MjvGeom]:
    return [scene.geoms[i] for i in range(scene.ngeom)]


def _ghosts(scene: mujoco.MjvScene) -> list[mujoco.MjvGeom]:
    return [g for g in _drawn(scene) if g.transparent and g.category == mujoco.mjtCatBit.mjCAT_DECOR]


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


def test_a_world_is_not_changed_by_its_stage(standing):
    before = copy.copy(standing.model)
    Stage(standing, "paper")
    for name in ("geom_rgba", "geom_group", "geom_matid", "light_pos", "site_rgba"):
        assert np.array_equal(getattr(standing.model, name), getattr(before, name)), name


def test_the_ghost_shows_what_the_design_still_wants(standing):
    stage, rest = Stage(standing, "draft"), standing.qpos[-1]
    meshes = {name: 2 * stage.model.mesh(name).id for name in ("block", "slope_flap")}
    found = _ghosts(_scene(stage, standing, rest))
    # One block stands in its place, as does the base of the slope; its flap is still folded.
    assert [ghost.dataid for ghost in found] == [meshes["block"], meshes["slope_flap"]]
    unfolded = rest.copy()
    unfolded[standing.physics.slopes[0].hinge.qpos] = 0.0
    assert [ghost.dataid for ghost in _ghosts(_scene(stage, standing, unfolded))] == [meshes["block"]]
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
    for name, ghost in zip(("base", "flap"), _ghosts(_scene(stage, standing, away))[1:], strict=True):
        twin = real[f"slope0/{name}_visual"]
        assert ghost.pos == pytest.approx(twin.pos, abs=2e-4)
        assert ghost.mat == pytest.approx(twin.mat, abs=2e-3)


def test_paper_shows_shadows_on_a_light_floor_and_no_sky(rendering, standing):
    stage, view = Stage(standing, "paper"), make_view("overview", standing, SIZE[0] / SIZE[1])
    renderer, data = make_renderer(stage.model, SIZE), Posed(stage.model).at(standing.qpos[-1])
    stage.model.vis.global_.fovy = view.fovy_deg
    pictures = []
    for shadows in (False, True):
        renderer.update_scene(data, view.camera(0.0))
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadows
        stage.finish(renderer.scene, data.qpos)
        pictures.append(renderer.render().astype(int))
    renderer.close()
    bright, shaded = pictures
    darker = (bright.sum(axis=2) - shaded.sum(axis=2)) > 60
    assert 0.005 < darker.mean() < 0.2
    # The edges of the picture are floor, evenly lit: neither sky nor speckles.
    edge = np.concatenate([shaded[0], shaded[:, 0], shaded[:, -1]])
    assert edge.min() > 180
    assert np.ptp(edge, axis=0).max() < 40
