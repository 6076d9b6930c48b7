"""The rules in undecided worlds: where all is known they allow and do what they allow and do in real ones."""

import numpy as np
import pytest
from planning.test_pddl import LEARNED, is_left_out

from craftsim.discrete.kinds import Action, Correction
from craftsim.discrete.learned import LearnedRules
from craftsim.discrete.rules import Rules
from craftsim.planning.undecided import UndecidedWorld
from craftsim.planning.variables import conceivable, stance_of, variables_of
from craftsim.validation.worlds import RandomWorlds

RULE_SETS = {
    "published": "published",
    "physical": "physical",
    "learned": LEARNED,
    "learned, other effects": LearnedRules(
        "mine", "published", ("derived_marks", "second_ramp"), rules=LEARNED.rules
    ),
}


def shown(values, rules):
    """Return the variables that are not as in an empty world, without marks where rules keep none."""
    unused = set()
    if rules.corrections & Correction.derived_marks:
        unused = {"mark", "landing"}
    return {key: value for key, value in values.items() if value != 1 and key.name not in unused}


def differences(grid, rules, real_rules):
    """Yield the actions in a world that differ from what the real rules allow and do."""
    values = variables_of(grid)
    undecided = UndecidedWorld(grid, rules, values)
    for car in range(grid.n_cars):
        for action in range(Action.STOP):
            cases = undecided.cases(stance_of(grid, car), action)
            after = real_rules.apply(grid, car, action)
            legal = real_rules.legal(grid, car, action) and not is_left_out(grid, after)
            if len(cases) != int(legal):
                yield Action(action), cases
            elif legal:
                (case,) = cases
                same_car = case.after == stance_of(after, car)
                changed = shown(values | case.effects, rules)
                if not same_car or changed != shown(variables_of(after), rules):
                    yield Action(action), cases


def played(rules, seed, n_steps=12):
    """Yield worlds of random play in a random world; what is rare among moves is preferred."""
    rng = np.random.default_rng(seed)
    grid = RandomWorlds().grid(rng)
    for _ in range(n_steps):
        yield grid
        options = np.argwhere(rules.mask(grid))
        rare = options[options[:, 1] <= Action.UNFOLD]
        if len(rare) and rng.random() < 0.6:
            options = rare
        for car, action in rng.permutation(options).tolist():
            after = rules.apply(grid, car, action)
            if not is_left_out(grid, after):
                grid = after
                break


@pytest.mark.parametrize("name", RULE_SETS)
def test_known_worlds_are_as_the_rules_have_them(name):
    rules = Rules(RULE_SETS[name])
    n_legal = 0
    for seed in range(3):
        for grid in played(rules, seed):
            n_legal += int(rules.mask(grid).sum())
            assert list(differences(grid, rules, rules)) == []
    assert n_legal > 150


def test_a_missing_correction_is_found():
    rules = Rules("physical")
    without = Rules("physical", ~Correction.turning_load)
    worlds = (grid for seed in range(8) for grid in played(rules, seed))
    assert any(list(differences(grid, rules, without)) for grid in worlds)


def test_what_is_conceivable_has_what_play_leads_to():
    rules = Rules("published")
    for seed in range(3):
        worlds = list(played(rules, seed))
        possible = conceivable(worlds[0])
        for grid in worlds:
            for variable, value in variables_of(grid).items():
                assert possible.get(variable, 1) & value
