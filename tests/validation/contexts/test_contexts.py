"""The contexts: found by walking the product, legal each one, and worlds that stand in physics."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.readback import read_grid
from craftsim.discrete.rules import Rules
from craftsim.errors import CraftsimError
from craftsim.models.measuring import read_poses
from craftsim.models.world import PhysicsWorld
from craftsim.validation.contexts.context import DIRECTION_NAMES, Ground, Thing, Verb
from craftsim.validation.contexts.survey import make_world, survey
from craftsim.validation.contexts.worlds import ImpossibleError, check_car

RULES = Rules("physical")
SURVEY = survey()
CONTEXTS = SURVEY.contexts


def _world(context, seed=0):
    return make_world(context, np.random.default_rng(seed))


def test_what_the_rules_forbid_is_kept_apart():
    assert not set(CONTEXTS) & set(SURVEY.illegal)
    on_slopes = {(context.verb, context.ground.half > 0) for context in SURVEY.illegal}
    assert (Verb("LIFT"), True) in on_slopes


def test_what_no_world_can_show_is_refused_with_its_reason():
    with pytest.raises(ImpossibleError, match="a load and what the car stands under would share a cell"):
        check_car(next(ground for ground in Ground if not ground.half), Thing(Kind.BLOCK, 0), Kind.FLAG)


def test_the_number_of_contexts_is_known():
    # A change of this number is to be looked at: it says that the rules changed.
    assert len(CONTEXTS) == 1406


def test_every_action_load_level_and_ground_occurs():
    assert {context.verb for context in CONTEXTS} == set(Verb)
    assert {context.load for context in CONTEXTS} == {Kind.AIR, Kind.BLOCK, Kind.FLAG, Kind.FSLOPE}
    assert {context.level for context in CONTEXTS} == {1, 2, 3}
    assert {context.ground for context in CONTEXTS} == set(Ground)
    assert {context.direction for context in CONTEXTS} == {None, 0, 1, 2, 3}
    assert {context.own.kind for context in CONTEXTS} == set(Kind) - {Kind.GROUND, Kind.WALL}


def test_levels_two_and_three_have_the_same_contexts():
    counts = Counter(context.level for context in CONTEXTS)
    assert counts[2] == counts[3] > counts[1]  # on level 1 there is no ramp down


def test_the_sides_of_a_car_are_alike():
    sides = Counter(context.direction for context in CONTEXTS)
    assert sides[1] == sides[3]
    assert (
        Counter(context.verb for context in CONTEXTS)[Verb.ROTATE_LEFT]
        == Counter(context.verb for context in CONTEXTS)[Verb.ROTATE_RIGHT]
    )


def test_ids_are_unique_and_stable():
    ids = [context.id for context in CONTEXTS]
    assert len(set(ids)) == len(ids)
    assert "LIFT/level=1/ground=flat/own=block/load=none/room=tight" in ids
    assert "MOVE-forward/level=2/ground=high-down/own=air/load=fslope/next=air/room=free" in ids
    assert "UNFOLD/level=1/ground=flat/own=fslope-back/load=none/room=free" in ids


@pytest.mark.parametrize("seed", range(3))
def test_each_world_is_legal_for_its_action(seed):
    turns = Counter()
    for context in CONTEXTS:
        grid = _world(context, seed)
        heading = int(grid.cars[0, CarField.YAW])
        turns[heading] += 1
        assert RULES.legal(grid, 0, context.action(heading)), context.id
    assert len(turns) == 1, "equal generators draw equal headings"


def test_all_map_directions_and_several_places_are_drawn():
    context = CONTEXTS[0]
    rng = np.random.default_rng(0)
    rows = [tuple(make_world(context, rng).cars[0, :4]) for _ in range(40)]
    assert {row[3] for row in rows} == {0, 1, 2, 3}
    assert len({row[:2] for row in rows}) > 5


def test_a_world_is_what_its_context_says():
    for context in CONTEXTS:
        grid = _world(context, 1)
        x, y, z, yaw, load, _, slope = (int(v) for v in grid.cars[0])
        assert (z, load, slope) == (context.level, context.load, context.ground.half), context.id
        assert grid.kind[x, y, z] == context.own.kind, context.id
        if context.direction is not None and context.next is not None:
            dx, dy = ((1, 0), (0, 1), (-1, 0), (0, -1))[(yaw + context.direction) % 4]
            there = grid.kind[x + dx, y + dy, z - context.next.below]
            assert there == context.next.kind, context.id


def test_tight_worlds_have_more_blocks():
    for context in CONTEXTS:
        if context.tight:
            tight, free = (_world(c) for c in (context, _free(context)))
            assert (tight.kind == Kind.BLOCK).sum() > (free.kind == Kind.BLOCK).sum(), context.id


def _free(context):
    return replace(context, tight=False)


@pytest.mark.parametrize("context", CONTEXTS[::23], ids=lambda context: context.id)
def test_each_world_stands_in_physics_as_drawn(context):
    grid = _world(context, 2)
    physics = PhysicsWorld(grid)
    reading = read_grid(read_poses(physics), physics.size, physics.walls)
    assert reading.problems == ()
    assert reading.grid.same_visible(grid)


def test_a_combination_that_is_none_says_why():
    lift = next(c for c in CONTEXTS if c.verb is Verb.LIFT)
    with pytest.raises(CraftsimError, match="a load and what the car stands under would share a cell"):
        _world(replace(lift, load=Kind.BLOCK))
    with pytest.raises(CraftsimError, match="the rules forbid it"):
        _world(replace(lift, own=Thing(), tight=False))


def test_relative_directions_become_map_actions():
    forward = next(c for c in CONTEXTS if c.verb is Verb.MOVE and DIRECTION_NAMES[c.direction] == "forward")
    assert [forward.action(yaw) for yaw in range(4)] == [
        Action.MOVE_RIGHT,
        Action.MOVE_FORWARD,
        Action.MOVE_LEFT,
        Action.MOVE_BACK,
    ]
