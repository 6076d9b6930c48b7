"""A world is composed as it stands; what is only seen of it changes no number of its physics."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from drawn import draw

from craftsim.discrete.grid import Grid, Kind
from craftsim.errors import InputError
from craftsim.mjcf.block import TABLES
from craftsim.mjcf.parameters import NOMINAL, Drive, Machines, SmartcarParameters
from craftsim.models.composition import compile_world, world_spec
from craftsim.models.config import SimulationConfig
from craftsim.models.floor import FLAT, Floor
from craftsim.models.world import PhysicsWorld

GOALS = ((0, 0, 1), (1, 1, 2))
ORDERED = {"body": "body", "jnt": "joint", "actuator": "actuator", "dof": None, "pair": None, "tree": None}
"""What both worlds have in the same order, by the prefix of its arrays."""
NOT_PHYSICS = ("adr", "geomnum", "bvhnum", "user", "plugin", "pair_geom1", "pair_geom2", "signature", "trnid")


def _grid() -> Grid:
    return draw(
        (4, 4, 2),
        [
            *((Kind.WALL, (0, 0, 1), 0), (Kind.BLOCK, (0, 1, 1), 0), (Kind.FLAG, (1, 1, 1), 0)),
            *((Kind.BODY, (0, 2, 1), 0), (Kind.FSLOPE, (0, 3, 1), 0)),
        ],
        [(3, 0, 1, 0, 0, 0, 0), (3, 1, 1, 2, 0, 0, 0)],
    )


def _machines(drive: Drive) -> Machines:
    return replace(NOMINAL, cars=(SmartcarParameters(), SmartcarParameters(chassis_mass_kg=1.4)), drive=drive)


def test_what_is_only_seen_changes_no_number():
    """But how large MuJoCo takes bodies to be (``dof_length``), which decides when what hardly turns may sleep."""
    for drive in ("rollers", "reduced"):
        for floor in (FLAT, Floor(lippage_m=0.001)):
            config = replace(SimulationConfig(), sleep=False)
            world = _grid(), config, _machines(drive), GOALS, floor
            bare, seen = (compile_world(world_spec(*world, visual=visual)) for visual in (False, True))
            assert (bare.ncam, bare.nlight, bare.ntex) == (0, 0, 0)
            assert bare.ngeom < seen.ngeom
            geoms = [seen.geom(bare.geom(i).name).id for i in range(bare.ngeom)]
            assert geoms == np.flatnonzero(seen.geom_contype | seen.geom_conaffinity).tolist(), (
                "none is only seen, in order"
            )
            for name in dir(bare):
                kind = name.split("_")[0]
                if (
                    kind not in ("geom", *ORDERED)
                    or "_" not in name
                    or name.endswith(NOT_PHYSICS)
                    or name in ("geom_dataid", "geom_matid", "dof_length")
                ):
                    continue
                one, other = (np.asarray(getattr(model, name)) for model in (bare, seen))
                assert np.array_equal(one, other[geoms] if kind == "geom" else other), name
            assert np.array_equal(bare.qpos0, seen.qpos0)
            assert bare.stat.meaninertia == seen.stat.meaninertia
            ends = []
            for model in (bare, seen):
                data = mujoco.MjData(model)
                for step in range(150):
                    data.ctrl[:] = np.sin(step / 20 + np.arange(model.nu))
                    mujoco.mj_step(model, data)
                ends.append(np.concatenate([data.qpos, data.qvel, data.qacc_warmstart]))
            assert np.array_equal(*ends)


def test_equal_machines_share_their_meshes():
    grid = Grid.empty((4, 4, 1), 1)
    grid.kind[1:, 1:, 1] = Kind.BLOCK
    model = world_spec(grid, SimulationConfig()).compile()
    assert sum("block" in model.mesh(i).name for i in range(model.nmesh)) == 2


def test_worlds_of_one_grid_share_nothing():
    grid = Grid.empty((4, 3, 1), 1)
    first, second = PhysicsWorld(grid, reset=False), PhysicsWorld(grid, reset=False)
    first.model.geom_friction[:] = 0.25
    grid.cars[0, 0] = 3
    assert second.model.geom_friction.max() > 0.5
    assert first.seen_model().qpos0[0] == second.model.qpos0[0] < 1


def test_a_kind_without_a_machine_is_refused(monkeypatch):
    monkeypatch.delitem(TABLES, Kind.FLAG)
    with pytest.raises(InputError, match=r"FLAG in \(1, 1, 1\) has no machine"):
        PhysicsWorld(_grid())
