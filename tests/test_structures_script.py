"""scripts/structures.py plans and builds a set, and says what share of it."""

import pytest
import structures
from structures import BLOCK_MM3, SETS, Job, Structures, attempt, figures_of


@pytest.fixture
def tiny(monkeypatch):
    monkeypatch.setitem(SETS, "tiny", Structures("wall", (3, 1, 1), 2))


def test_a_structure_is_planned_and_built_in_physics(tiny):
    done = attempt(Job("tiny", 0, "wheels"))
    assert done.agrees
    assert done.extra["agree"] == done.extra["actions"]
    figures = figures_of([done.extra], 2, "wheels")
    assert figures["built"].rate == figures["planned"].rate == 1
    assert figures["blocks"] == [3, 3, 3]
    rate = 3 * 3600 / done.extra["executed_s"]
    assert figures["blocks_per_hour"] == pytest.approx(rate)
    assert figures["mm3_per_minute_per_car"] == pytest.approx(rate * BLOCK_MM3 / 120)


def test_a_plan_that_takes_too_long_does_not_count(tiny, monkeypatch):
    monkeypatch.setattr(structures, "LIMIT_S", 0.0)
    done = attempt(Job("tiny", 0, None))
    assert not done.agrees
    figures = figures_of([done.extra], 2, None)
    assert figures["planned"].successes == 0
    assert figures["makespan_s"] == []
    assert figures["blocks_per_hour"] is None


def test_random_sets_hold_different_structures_that_a_seed_gives_again():
    sets = SETS["7x7x3"]
    first, again, other = (sets.start(seed) for seed in (0, 0, 1))
    assert first.design.targets == again.design.targets != other.design.targets
    assert first.grid.same_visible(again.grid)
