"""A slope's flap touches the base it folds onto, and nothing of it when unfolded."""

import mujoco
import numpy as np
import pytest
from drawn import draw

from craftsim.discrete.grid import Kind
from craftsim.mjcf.parameters import NOMINAL
from craftsim.models.config import SimulationConfig
from craftsim.models.randomization import DomainRandomization, randomize
from craftsim.models.world import PhysicsWorld

GRAVITY = 9.81


def flap_on_base(physics: PhysicsWorld) -> tuple[float, float]:
    """Return the summed normal force between flap and base, and their deepest penetration in metres."""
    model, data = physics.model, physics.data
    flap, base = model.body("slope0/flap").id, model.body("slope0/slope").id
    force, total, depth = np.zeros(6), 0.0, 0.0
    for i, contact in enumerate(data.contact):
        if {model.geom_bodyid[contact.geom1], model.geom_bodyid[contact.geom2]} == {flap, base}:
            mujoco.mj_contactForce(model, data, i, force)
            total, depth = total + force[0], max(depth, -contact.dist)
    return total, depth


def slope_at(kind: Kind, settle_s: float = 0.3, cars=()) -> PhysicsWorld:
    config = SimulationConfig(sleep=False, settle_s=settle_s)
    return PhysicsWorld(draw((3, 5, 3), [(kind, (1, 1, 1), 1)], cars), config)


@pytest.mark.parametrize("settle_s", [0.0, 0.3])
def test_a_folded_flap_lies_on_the_base_with_no_more_than_its_weight_and_an_unfolded_one_does_not(settle_s):
    force, depth = flap_on_base(slope_at(Kind.FSLOPE, settle_s))
    assert 0 < force < NOMINAL.slope.flap_mass_kg * GRAVITY
    assert depth < 2e-6
    assert flap_on_base(slope_at(Kind.BODY, settle_s)) == (0, 0)


def test_the_base_bears_what_stands_on_a_folded_flap():
    """Band: the flap's tip bears half of the car, less a tenth that the hinge's stop holds."""
    physics = slope_at(Kind.FSLOPE, cars=[(1, 1, 2, 0)])
    force, depth = flap_on_base(physics)
    assert force > 0.45 * NOMINAL.cars[0].mass_kg * GRAVITY
    assert depth < 5e-4
    position, _ = physics.free_body_state(physics.cars[0].base)
    assert position[2] == pytest.approx(NOMINAL.slope.height_m, abs=5e-4)


def test_randomized_friction_reaches_the_flap():
    physics = slope_at(Kind.FSLOPE)
    randomize(physics, DomainRandomization(), np.random.default_rng(0))
    model = physics.model
    flap = model.geom("slope0/flap").friction[0]
    assert flap != NOMINAL.slope.friction
    assert (model.pair_friction[:, :2] == flap).all()
