"""Plans: what is read, what every mistake says, and that the shipped one builds its building."""

from importlib.resources import files

import pytest

from craftsim.discrete.actions import Action
from craftsim.discrete.files.plan import read_plan
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks import make_task
from craftsim.errors import PlanError

GOOD = "# two cars\n0 0 LIFT\n\n0 1 STOP # waits\n2 1 MOVE_LEFT\n"


def test_a_plan_keeps_ticks_and_the_order_of_its_lines(tmp_path):
    (tmp_path / "p.plan").write_text(GOOD)
    assert read_plan(tmp_path / "p.plan", 2).ticks == (
        ((0, Action.LIFT), (1, Action.STOP)),
        (),
        ((1, Action.MOVE_LEFT),),
    )


MISTAKES = {
    "0 0 LIFTT": r":1: unknown action 'LIFTT'; did you mean 'LIFT'\?; allowed: LIFT, DROP",
    "0 0 lift": ":1: unknown action 'lift'",
    "0 2 LIFT": ":1: no car '2'; there are cars 0 to 1",
    "0 -1 LIFT": ":1: no car '-1'",
    "0 one LIFT": ":1: no car 'one'",
    "1 0 LIFT\n0 1 LIFT": ":2: tick 0 comes after tick 1; allowed: 1 or later",
    "0 0 LIFT\n0 0 STOP": ":2: car 0 acts twice in tick 0",
    "x 0 LIFT": ":1: tick 'x' must be a whole number",
    "1.5 0 LIFT": ":1: tick '1.5' must be a whole number",
    "999999999 0 LIFT": ":1: tick 999999999 is out of range",
    "0 0": ":1: 2 words, but a line is: tick car ACTION",
    "# nothing": "no actions",
    "": "no actions",
}


@pytest.mark.parametrize("text", MISTAKES)
def test_a_mistake_is_told_with_file_and_line(text, tmp_path):
    (tmp_path / "p.plan").write_text(text)
    with pytest.raises(PlanError, match=f"p.plan.*{MISTAKES[text]}"):
        read_plan(tmp_path / "p.plan", 2)


def test_a_missing_plan_is_told(tmp_path):
    with pytest.raises(PlanError, match=r"none\.plan: no such file"):
        read_plan(tmp_path / "none.plan", 2)


@pytest.mark.parametrize("rule_set", ["published", "physical"])
def test_the_shipped_plan_is_legal_throughout_and_builds_the_simple_two_story_building(rule_set, rng):
    task = make_task("simple_two_story")
    grid = task.draw(rng)
    plan = read_plan(str(files("craftsim") / "data" / "plans" / "simple_two_story.plan"), grid.n_cars)
    for tick in plan.ticks:
        grid, applied = Rules(rule_set).tick(grid, tick)
        assert applied.all(), tick
    assert task.succeeded(grid)
    assert task.design is not None
    assert task.design.satisfied(grid)
