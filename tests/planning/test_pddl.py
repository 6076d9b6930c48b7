"""Rules as PDDL: what is applicable in it is what the rules allow, and stock planners solve the strip with it."""

import re
import subprocess
import sys

import numpy as np
import pytest

import craftsim
from craftsim.discrete.kinds import Action
from craftsim.discrete.learned import LearnedRule, LearnedRules, PatternCell
from craftsim.discrete.rules import Rules
from craftsim.errors import InputError
from craftsim.planning.pddl import plan_of_pddl, write_pddl
from craftsim.tasks import make_task

LOADED = {"load": ("block", "flag", "fslope")}
LEARNED = LearnedRules(
    "my car",
    rules=(
        LearnedRule("turn", "ROTATE_LEFT", (PatternCell((1, 0, 0), ("car",)),), LOADED),
        LearnedRule("edge", "LIFT", (PatternCell((-2, 0, 0), ("outside", "flag")),)),
        LearnedRule(
            "aside",
            "MOVE",
            (PatternCell((1, 1, 0), ("block", "car+block")), PatternCell((1, -1, 0), ("air",))),
            {"load": ("block",), "heading": ("left", "right", "back")},
        ),
    ),
)


class _Pddl:
    """Actions and facts of files, as any planner reads them."""

    def __init__(self, domain, problem):
        self.actions = {}
        pattern = (
            r"\(:action (\S+)\s+:parameters \(\?c - car\)\s+:precondition \(and (.*)\)\s+"
            r":effect \(and (.*)\)\)"
        )
        for name, needs, effects in re.findall(pattern, domain.read_text()):
            facts = re.findall(r"\((not )?\(?([^()]+)\)", effects)
            self.actions[name] = (re.findall(r"\(([^()]+)\)", needs), facts)
        text = problem.read_text()
        self.facts = set(re.findall(r"\(([^()]+)\)", text.split("(:init")[1].split("(:goal")[0]))

    def applicable(self, car):
        names = []
        for name, (needs, _) in self.actions.items():
            if all(need.replace("?c", f"car-{car}") in self.facts for need in needs):
                names.append(name)
        return names

    def apply(self, name, car):
        for negative, fact in self.actions[name][1]:
            if negative:
                self.facts.discard(fact.replace("?c", f"car-{car}"))
        for negative, fact in self.actions[name][1]:
            if not negative:
                self.facts.add(fact.replace("?c", f"car-{car}"))


@pytest.mark.parametrize("rule_set", ["published", LEARNED], ids=["published", "learned"])
def test_what_is_applicable_is_what_the_rules_allow(tmp_path, rule_set):
    task = make_task("strip")
    rules = Rules(rule_set)
    pddl = _Pddl(*write_pddl(task, rules, tmp_path))
    rng = np.random.default_rng(0)
    grid = task.draw(rng)
    forbidden = 0
    for _ in range(60):
        mask = rules.mask(grid)
        forbidden += int((Rules("published").mask(grid) & ~mask).sum())
        mask[:, Action.STOP] = False
        options = []
        for car in range(grid.n_cars):
            applicable = pddl.applicable(car)
            actions = {}
            for name in applicable:
                ((_, action),) = plan_of_pddl([f"({name} car-{car})"])[0]
                actions[action] = name
            assert sorted(actions) == np.flatnonzero(mask[car]).tolist()
            options += [(car, action, name) for action, name in actions.items()]
        # Lifts and drops are rare among the moves.
        rare = [option for option in options if option[1] in (Action.LIFT, Action.DROP)]
        chosen = rare if rare and rng.random() < 0.5 else options
        car, action, name = chosen[int(rng.integers(len(chosen)))]
        grid = rules.apply(grid, car, action)
        grid.derive_marks()
        pddl.apply(name, car)
    assert (forbidden > 0) == (rule_set != "published")


def test_a_stock_planner_builds_the_strip(tmp_path):
    pytest.importorskip("pyperplan")
    task = make_task("strip")
    rules = Rules(LEARNED)
    domain, problem = write_pddl(task, rules, tmp_path)
    command = [sys.executable, "-m", "pyperplan", "-s", "gbf", "-H", "hff", domain, problem]
    subprocess.run(command, check=True, capture_output=True, timeout=300)
    plan = plan_of_pddl((tmp_path / "problem.pddl.soln").read_text().splitlines())
    grid = task.draw(np.random.default_rng(0))
    for tick in plan:
        grid, legal = rules.tick(grid, tick)
        assert legal.all()
    assert task.succeeded(grid)


def test_what_cannot_be_written_is_said(tmp_path):
    with pytest.raises(InputError, match="has slopes"):
        write_pddl(make_task("simple_two_story"), Rules("published"), tmp_path)
    with pytest.raises(InputError, match="corrections of physical"):
        write_pddl(make_task("strip"), Rules("physical"), tmp_path)
    with pytest.raises(InputError, match="line 1 of the solution"):
        plan_of_pddl(["(fly car-0)"])


def test_the_planner_plans_with_learned_rules():
    task = make_task("strip")
    rules = Rules(LearnedRules("my car", rules=LEARNED.rules[:1]))
    grid = task.draw(np.random.default_rng(0))
    planned = craftsim.plan(grid, task, rules=rules, rounds=3)
    for tick in planned.ticks:
        grid, legal = rules.tick(grid, tick)
        assert legal.all()
    assert task.succeeded(grid)
