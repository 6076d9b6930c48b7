"""Rules.explain names the rule that forbids an action, and agrees with the compiled rules."""

import numpy as np

from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action, Correction
from craftsim.discrete.rules import REASONS, Rules

from .worldgen import play, random_world

FORBIDDING = [reason.correction for reason in REASONS.values() if reason.correction is not None]
THINGS = [Kind.BLOCK, Kind.FSLOPE, Kind.GEAR, Kind.BODY, Kind.FOOT, Kind.WALL, Kind.FLAG]


def _dense_world(rng):
    """Return a small world crowded with ramps, slopes, blocks and loaded cars, many of them where no game leads."""
    grid = random_world(rng)
    for _ in range(int(rng.integers(4, 16))):
        cell = tuple(
            int(rng.integers(low, n)) for low, n in zip((0, 0, 1), grid.kind.shape, strict=True)
        )
        grid.kind[cell] = rng.choice(THINGS)
        grid.yaw[cell] = rng.integers(4) if grid.kind[cell] in (5, 6, 7, 8) else 0
    for row in grid.cars:
        row[2] = rng.integers(1, grid.kind.shape[2] + 1)
        row[4] = rng.choice([Kind.AIR, Kind.BLOCK, Kind.FSLOPE])
        row[5] = (row[3] + 2) % 4 if row[4] == Kind.FSLOPE else 0
        row[6] = rng.choice([0, 0, 1, 2])
    grid.derive_marks()
    return grid


def _worlds(rules, rng):
    yield _dense_world(rng)
    yield from (grid for _, grid in play(rules, random_world(rng), rng, 12))


def test_every_forbidden_action_has_a_reason_and_every_legal_one_is_said_to_be_legal():
    for rule_set in ("published", "physical"):
        rules, rng = Rules(rule_set), np.random.default_rng(5)
        seen = {True: 0, False: 0}
        for _ in range(25):
            for grid in _worlds(rules, rng):
                mask = rules.mask(grid)
                for car in range(grid.n_cars):
                    for action in Action:
                        explanation = rules.explain(grid, car, action)
                        assert explanation.legal == mask[car, action] == (not explanation.reason), (
                            explanation
                        )
                        assert bool(explanation.cells) != explanation.legal
                        assert all(len(cell) == 3 for cell in explanation.cells)
                        seen[explanation.legal] += 1
        assert min(seen.values()) > 200


def test_without_the_flag_that_is_named_the_action_is_legal_or_has_another_reason():
    rules, rng = Rules("physical"), np.random.default_rng(1)
    named = dict.fromkeys(FORBIDDING, 0)
    for _ in range(1000):
        grid = _dense_world(rng)
        legal = Rules("published", Correction(sum(set(Correction) - set(FORBIDDING)))).mask(grid)
        for car, action in np.argwhere(legal & ~rules.mask(grid)):
            explanation = rules.explain(grid, int(car), Action(action))
            assert explanation.correction is not None
            named[explanation.correction] += 1
            other = Rules("physical", ~explanation.correction)
            assert other.explain(grid, int(car), Action(action)).reason != explanation.reason
        if min(named.values()) > 0:
            break
    assert min(named.values()) > 0, named
