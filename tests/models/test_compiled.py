"""A world whose parts are put in place is the one that is compiled there, whichever worlds were made before it."""

import mujoco
import numpy as np
import pytest

from craftsim.discrete.files.blueprint import read_blueprint
from craftsim.discrete.grid import Grid, Kind
from craftsim.mjcf.parameters import NOMINAL, BlockParameters, Machines, SmartcarParameters
from craftsim.models.compiled import compiled_parts
from craftsim.models.composition import compose
from craftsim.models.config import SimulationConfig
from craftsim.models.parts import load_part
from craftsim.models.placement import placements
from craftsim.models.world import Site
from craftsim.validation.audit.scenes import SCENES

VISUAL = {"stat.meansize"}
"""How large MuJoCo draws arrows: the last digit of a mean over the parts moves with them."""


def _figures(model):
    """Return all numbers of a model by name."""
    found = {}
    for prefix, part in (("", model), ("opt.", model.opt), ("stat.", model.stat), ("vis.", model.vis)):
        for name in dir(part):
            value = getattr(part, name)
            if not name.startswith("_") and isinstance(value, np.ndarray | int | float | bytes):
                found[prefix + name] = np.asarray(value).tobytes()
    assert {"qpos0", "body_invweight0", "cam_pos0", "stat.meaninertia", "opt.timestep"} < found.keys()
    return found


def _compiled_there(grid, config, goals=(), machines=NOMINAL):
    spec, _ = compose(
        load_part("ground", machines), grid.size, placements(grid, machines), config, goals, machines
    )
    return spec.compile()


def _walled():
    grid = Grid.empty((5, 4, 2), 1)
    grid.kind[0, 0, 1] = grid.kind[3, 1, 1] = Kind.WALL
    return grid


@pytest.fixture(scope="module")
def worlds():
    """Worlds with all kinds of parts: cars on ramps and with loads, stacks, walls, flags, goals."""
    loaded = Grid.empty((6, 5, 3), 2)
    loaded.cars[0, :6] = 1, 2, 1, 3, Kind.BLOCK, 0
    loaded.cars[1, :6] = 4, 1, 1, 2, Kind.FSLOPE, 1
    loaded.kind[3, 3, 1] = Kind.FLAG
    return [
        *(scene.world() for scene in SCENES[::12]),
        read_blueprint("simple_two_story").grid(np.random.default_rng(0)),
        loaded,
        _walled(),
    ]


def test_a_world_put_in_place_is_the_one_compiled_there(worlds):
    config, goals = SimulationConfig(timestep_s=0.002, sleep=False), [(0, 0, 1), (2, 1, 2)]
    for grid in worlds:
        there = _figures(_compiled_there(grid, config, goals))
        placed = _figures(Site(grid, config, goals, reset=False).model)
        assert {name for name in there if there[name] != placed[name]} <= VISUAL


def test_so_it_is_with_figures_of_ones_own():
    machines = Machines(
        cars=(SmartcarParameters(), SmartcarParameters(chassis_mass_kg=2.0)),
        block=BlockParameters(friction=0.7),
    )
    grid = Grid.empty((4, 3, 1), 2)
    grid.cars[:, :3] = [[0, 0, 1], [2, 1, 1]]
    grid.kind[3, 2, 1] = Kind.BLOCK
    there = _figures(_compiled_there(grid, SimulationConfig(), machines=machines))
    placed = _figures(Site(grid, machines=machines, reset=False).model)
    assert {name for name in there if there[name] != placed[name]} <= VISUAL


def test_worlds_of_equal_parts_compile_once_and_share_nothing():
    one, other = Grid.empty((4, 3, 1), 1), Grid.empty((5, 5, 2), 1)
    other.cars[0, :4] = 3, 4, 1, 2
    compiled_parts.cache_clear()
    first, second, again = (Site(grid, reset=False) for grid in (one, other, one))
    assert (compiled_parts.cache_info().misses, compiled_parts.cache_info().hits) == (1, 2)
    for name in ("geom_friction", "body_pos", "tree_sleep_policy", "actuator_gainprm"):
        getattr(first.model, name)[:] = 0.25
    first.model.opt.gravity[:] = 0
    assert _figures(again.model) == _figures(Site(one, reset=False).model)
    assert np.array_equal(second.data.qpos[:2], second.model.qpos0[:2])
    assert second.model.geom("ground").size[0] > again.model.geom("ground").size[0]


def test_what_was_made_before_changes_nothing(worlds):
    """The numbers of a run are bit-equal with cold and with warm caches."""
    ends = []
    for before in ([], worlds):
        compiled_parts.cache_clear()
        for grid in before:
            Site(grid, reset=False)
        site = Site(worlds[0])
        site.drive(0, [3.0, 3.0, 3.0, 3.0])
        for _ in range(10):
            site.advance()
        ends.append(np.concatenate([site.data.qpos, site.data.qvel, site.data.qacc_warmstart]))
    assert np.array_equal(*ends)


def test_a_part_that_is_edited_is_read_anew():
    edited = load_part("block", NOMINAL)
    edited.body("block").add_geom(size=[0.1, 0.1, 0.1], type=mujoco.mjtGeom.mjGEOM_BOX)
    assert len(load_part("block", NOMINAL).geoms) == len(edited.geoms) - 1
