"""A start in which things stand in each other is no start, and every door says so."""

import pytest
from drawn import draw

import craftsim
from craftsim.audit.situation import Row, Situation
from craftsim.checking.setup import Setup, set_up
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.errors import StartError
from craftsim.models.world import PhysicsWorld
from craftsim.validation.audit import AuditTrial, try_it

IN_THE_GEAR = draw((5, 3, 2), [(Kind.FSLOPE, (2, 1, 1), 2)], [(1, 1, 1, 0, Kind.BLOCK, 0, 0)])
"""A carried block where a folded slope has its gear."""
BESIDE = draw((5, 3, 2), [(Kind.FSLOPE, (2, 1, 1), 2)], [(0, 1, 1, 0, Kind.BLOCK, 0, 0)])


def test_a_start_names_what_stands_in_what_and_how_deep():
    (overlap,) = PhysicsWorld(IN_THE_GEAR).overlaps
    assert overlap.startswith("block 0 and slope 0 stand ")
    assert float(overlap.split()[6]) == pytest.approx(16, abs=1)
    assert PhysicsWorld(BESIDE).overlaps == ()


def test_no_judge_takes_such_a_world(tmp_path):
    with pytest.raises(
        StartError, match=r"block 0 and slope 0 stand 16\.\d mm in each other \(allowed 1 mm\)"
    ):
        set_up(IN_THE_GEAR, Setup())
    with pytest.raises(StartError):
        craftsim.perform(PhysicsWorld(IN_THE_GEAR), 0, "DROP")
    world = tmp_path / "world.yaml"
    world.write_text(blueprint_text(IN_THE_GEAR), encoding="utf-8")
    (tmp_path / "its.actions").write_text("0 DROP\n", encoding="utf-8")
    with pytest.raises(StartError):
        craftsim.validate(world, actions=tmp_path / "its.actions")


def test_an_audit_tries_nothing_there_and_says_why():
    scene = Situation(Row("DROP", scene="in the gear"), IN_THE_GEAR, (Action.DROP,))
    done = try_it(AuditTrial(scene, True, 0, 0, Setup()))
    assert not done.attempts
    assert "block 0 and slope 0 stand" in done.extra["does_not_stand"][0]
