"""Plans: what is read, what every mistake says, and that the shipped one builds its building."""

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import make_schedule
from craftsim.errors import PlanError
from craftsim.planning.plan_file import plan_text, read_plan, write_plan
from craftsim.tasks import TASK_NAMES, make_task
from craftsim.tasks.episodes import Episodes
from craftsim.tasks.task import DEFAULT_MAX_STEPS

GOOD = "# two cars\n0 0 LIFT\n\n0 1 STOP # waits\n2 1 MOVE_LEFT\n"


def test_a_plan_keeps_ticks_and_the_order_of_its_lines(tmp_path):
    (tmp_path / "p.plan").write_text(GOOD)
    assert read_plan(tmp_path / "p.plan", 2).ticks == (
        ((0, Action.LIFT), (1, Action.STOP)),
        (),
        ((1, Action.MOVE_LEFT),),
    )


@pytest.mark.parametrize("name", TASK_NAMES)
def test_the_shipped_plans_finish_within_the_published_episodes(name):
    """By the published rules with the helper of the paper's protocol: an episode of 20 ticks is long enough."""
    task = make_task(name)
    episode = Episodes(task, np.random.default_rng(0), 1, "published", helper_depth=20)
    ticks = 0
    for tick in read_plan(shipped_plan(name), task.layout.n_cars).ticks:
        actions = np.full((1, task.layout.n_cars), Action.STOP)
        for car, action in tick:
            actions[0, car] = action
        acting = [car for car, _ in tick]
        waiting = [car for car in range(task.layout.n_cars) if car not in acting]
        steps = episode.step(actions, np.array([acting + waiting]))
        ticks += 1
        if steps.done[0]:
            break
    assert steps.success[0]
    assert ticks <= 15 < DEFAULT_MAX_STEPS + 2 == 20


MISTAKES = {
    "0 0 LIFTT": r":1: unknown action 'LIFTT'; did you mean 'LIFT'\?; allowed: LIFT, DROP",
    "0 2 LIFT": ":1: no car '2'; there are cars 0 to 1",
    "0 -1 LIFT": ":1: no car '-1'",
    "1 0 LIFT\n0 1 LIFT": ":2: tick 0 comes after tick 1; allowed: 1 or later",
    "0 0 LIFT\n0 0 STOP": ":2: car 0 acts twice in tick 0",
    "x 0 LIFT": ":1: tick 'x' must be a whole number",
    "999999999 0 LIFT": ":1: tick 999999999 is out of range",
    "0 0": ":1: 2 words, but a line is: tick car ACTION",
    "0 0 LIFT\n1 1 LIFT after": ":2: 'after' names no action",
    "0 0 LIFT\n1 1 LIFT after 0-0": ":2: after '0-0', but an action is named CAR:TICK",
    "0 0 LIFT\n1 1 LIFT after 0:1": ":2: after '0:1', but no line before this one is of car 0 in tick 1",
    "0 1 LIFT after 0:0\n0 0 LIFT": ":1: after '0:0', but no line before",
    "0 1 LIFT\n1 1 LIFT after 1:0": ":2: after '1:0', but car 1 waits for its own actions anyway",
    "0 0 LIFT\n1 1 LIFT after 0:0 0:0": ":2: after '0:0' stands twice; allowed: once",
    "# nothing": "no actions",
    "": "no actions",
}


def test_a_mistake_is_told_with_file_and_line(tmp_path):
    for text, message in MISTAKES.items():
        (tmp_path / "p.plan").write_text(text)
        with pytest.raises(PlanError, match=f"p.plan.*{message}"):
            read_plan(tmp_path / "p.plan", 2)


def test_the_shipped_plans_are_legal_throughout_and_build_what_they_should(rng):
    for name in TASK_NAMES:
        for rule_set in ("published", "physical"):
            task = make_task(name)
            grid = task.draw(rng)
            for tick in read_plan(shipped_plan(name), grid.n_cars).ticks:
                grid, applied = Rules(rule_set).tick(grid, tick)
                assert applied.all(), (name, rule_set, tick)
            assert task.succeeded(grid), (name, rule_set)


def test_order_constraints_are_read_and_written_again(tmp_path):
    text = "0 0 LIFT\n0 1 STOP after 0:0\n2 1 DROP\n2 2 DROP after 0:0 1:2\n"
    (tmp_path / "p.plan").write_text(text)
    plan = read_plan(tmp_path / "p.plan", 3)
    assert plan.after == {(0, 1): ((0, 0),), (2, 2): ((0, 0), (2, 1))}
    write_plan(plan, tmp_path / "again.plan")
    assert (tmp_path / "again.plan").read_text() == text
    assert plan_text(plan.ticks) == "0 0 LIFT\n0 1 STOP\n2 1 DROP\n2 2 DROP\n"


def _ancestors(schedule):
    """Return for each step all that have ended before it starts."""
    found = []
    for step in schedule.steps:
        found.append(set(step.waits_for).union(*(found[other] for other in step.waits_for)))
    return found


def test_a_written_schedule_is_kept_by_who_reads_the_plan(tmp_path, rng):
    for order in ("sequential", "concurrent", "at-once"):
        grid, rules = make_task("complex_two_story").draw(rng), Rules("physical")
        plan = read_plan(shipped_plan("complex_two_story"), grid.n_cars)
        asked, free = (make_schedule(grid, plan.ticks, rules, one) for one in (order, "concurrent"))
        write_plan(plan, tmp_path / "p.plan", asked)
        read = read_plan(tmp_path / "p.plan", grid.n_cars)
        kept = make_schedule(grid, read.ticks, rules, after=read.after)
        wanted = [a | b for a, b in zip(_ancestors(asked), _ancestors(free), strict=True)]
        assert all(want <= have for want, have in zip(wanted, _ancestors(kept), strict=True))
        if order != "at-once":
            assert _ancestors(kept) == _ancestors(asked)
        assert (order == "concurrent") == (_ancestors(kept) == _ancestors(free))


_WORDS = st.sampled_from(
    [
        "0",
        "1",
        "2",
        "LIFT",
        "STOP",
        "after",
        "0:0",
        "1:0",
        "0:1",
        "9:9",
        ":",
        "after:",
        "-1:0",
        "\u0660:0",
    ]
)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(st.lists(st.lists(_WORDS, max_size=6).map(" ".join), max_size=4).map("\n".join))
@example("0 0 LIFT\n0 1 LIFT after 0:0")
def test_any_lines_are_a_plan_or_a_mistake_with_its_file(tmp_path, text):
    path = tmp_path / "p.plan"
    path.write_text("0 0 STOP\n" + text, encoding="utf-8")
    plan, told = None, ""
    try:
        plan = read_plan(path, 2)
    except PlanError as error:
        told = str(error)
    if plan is None:
        assert told.startswith(f"{path}:")
        return
    places = {
        (tick, car): number
        for number, (tick, car) in enumerate(
            (t, c) for t, joint in enumerate(plan.ticks) for c, _ in joint
        )
    }
    for act, others in plan.after.items():
        assert others
        assert all(places[other] < places[act] and other[1] != act[1] for other in others)
