"""Rules as PDDL: what is applicable in it is what the rules allow and do, and stock planners build with it."""

import re
import subprocess
import sys
from collections import Counter

import numpy as np
import pytest

import craftsim
from craftsim.discrete.grid import Piece, grid_of
from craftsim.discrete.kinds import MOVE_DIRECTION, Action, CarField, Kind
from craftsim.discrete.learned import LearnedRule, LearnedRules, PatternCell
from craftsim.discrete.rules import Rules
from craftsim.errors import InputError
from craftsim.planning import undecided
from craftsim.planning.pddl import PddlExport, plan_of_pddl, write_pddl
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
        LearnedRule(
            "climb", "MOVE", (PatternCell((1, 0, 0), ("foot-back",)),), {"load": ("block",)}
        ),
        LearnedRule("lean", "MOVE", (PatternCell((0, 1, 0), ("leaning-load", "gear-right")),)),
    ),
)
RULE_SETS = {"published": "published", "physical": "physical", "learned": LEARNED}


def small_world():
    """Return a world of few cells with all that rules know: a slope before a block, a block, a flag, and cars."""
    pieces = [
        Piece(Kind.BLOCK, (3, 0, 1)),
        Piece(Kind.FSLOPE, (2, 0, 1), 2),
        Piece(Kind.BLOCK, (2, 1, 1)),
        Piece(Kind.FLAG, (3, 1, 1)),
    ]
    return grid_of(pieces, [(3, 0, 1, 0, 0, 0, 0), (0, 0, 1, 0, 0, 0, 0)], (4, 2, 2))


def things(grid):
    """Return how many blocks, flags and slopes there are."""
    counts = Counter(grid.kind.ravel().tolist()) + Counter(grid.cars[:, CarField.LOAD].tolist())
    n_slopes = counts[Kind.FSLOPE] + counts[Kind.BODY]
    return counts[Kind.BLOCK], counts[Kind.FLAG], n_slopes


def is_left_out(before, after):
    """Return whether cars share a cell, or a thing is gone: the published rules allow what is not written."""
    cells = set(map(tuple, after.cars[:, : CarField.YAW].tolist()))
    has_whole_ramps = (after.kind == Kind.FOOT).sum() == (after.kind == Kind.BODY).sum()
    return len(cells) < after.n_cars or things(before) != things(after) or not has_whole_ramps


class Pddl:
    """Actions of files, as any planner reads them."""

    def __init__(self, domain):
        self.actions = {}
        pattern = (
            r"\(:action (\S+)\s+:parameters \(\?c - car\)\s+:precondition \(and (.*)\)\s+"
            r":effect \(and (.*)\)\)"
        )
        for name, needs, effects in re.findall(pattern, domain):
            facts = re.findall(r"\((not )?\(?([^()]+)\)", effects)
            self.actions[name] = (re.findall(r"\(([^()]+)\)", needs), facts)

    def applicable(self, facts, car):
        for name, (needs, _) in self.actions.items():
            if all(need.replace("?c", f"car-{car}") in facts for need in needs):
                yield name

    def apply(self, facts, name, car):
        changes = self.actions[name][1]
        gone = {fact.replace("?c", f"car-{car}") for negative, fact in changes if negative}
        new = {fact.replace("?c", f"car-{car}") for negative, fact in changes if not negative}
        return facts - gone | new


def facts_of(export, grid):
    return {fact.strip("()") for fact in export.facts(grid)}


def differences(export, pddl, rules, grid):
    """Yield how actions in a world differ from what rules allow and do."""
    facts = facts_of(export, grid)
    for car in range(grid.n_cars):
        by_action = {}
        for name in pddl.applicable(facts, car):
            ((_, action),) = plan_of_pddl([f"({name} car-{car})"])[0]
            by_action.setdefault(action, []).append(name)
        for action in Action:
            if action == Action.STOP:
                continue
            after = rules.apply(grid, car, action)
            legal = rules.legal(grid, car, action) and not is_left_out(grid, after)
            names = by_action.get(action, [])
            if len(names) != int(legal):
                yield f"{action.name} of car {car}: {names}, {legal}"
            elif legal and pddl.apply(facts, names[0], car) != facts_of(export, after):
                yield f"{names[0]} of car {car} has other effects"


def played(rules, seed, n_steps=40):
    """Yield worlds of random play; lifts, drops and folds are rare among moves, and are preferred."""
    rng = np.random.default_rng(seed)
    grid = small_world()
    if seed % 2:
        for action in (Action.MOVE_LEFT, Action.UNFOLD, Action.MOVE_RIGHT):
            assert rules.legal(grid, 0, action)
            grid = rules.apply(grid, 0, action)
    for _ in range(n_steps):
        yield grid
        options = np.argwhere(rules.mask(grid))
        options = options[options[:, 1] != Action.STOP]
        for rare in ((Action.FOLD, Action.UNFOLD), (Action.LIFT, Action.DROP)):
            chosen = options[np.isin(options[:, 1], rare)]
            if len(chosen) and rng.random() < 0.5:
                options = chosen
        for car, action in rng.permutation(options).tolist():
            after = rules.apply(grid, car, action)
            if not is_left_out(grid, after):
                grid = after
                break


@pytest.fixture(scope="module", params=RULE_SETS)
def exported(request):
    """Rules, and what is written of a small world under them."""
    rules = Rules(RULE_SETS[request.param])
    return rules, PddlExport(small_world(), rules)


def test_what_is_applicable_and_follows_is_what_the_rules_say(exported):
    rules, export = exported
    pddl = Pddl(export.domain())
    done = Counter()
    for seed in range(6):
        for grid in played(rules, seed):
            assert list(differences(export, pddl, rules, grid)) == []
            done.update(np.argwhere(rules.mask(grid))[:, 1].tolist())
            done["above"] += int((grid.cars[:, CarField.Z] > 1).any())
    folded = done[Action.FOLD] + done[Action.UNFOLD]
    assert folded
    assert all(done[action] for action in (Action.LIFT, Action.DROP, *MOVE_DIRECTION))
    assert done["above"] > 5


@pytest.mark.parametrize("exported", ["published"], indirect=True)
def test_planted_differences_are_found(exported):
    rules, export = exported
    worlds = [*played(rules, 0), *played(rules, 1)]
    text = export.domain()
    changed = [
        re.sub(r"(:action drop.*\n.*\n.*)\(carries-[^()]*\)", r"\1", text),
        re.sub(r"(:action lift.*\n.*\n.*\n.*)\(air [^()]*\)", r"\1", text),
    ]
    for other_text in changed:
        assert other_text != text
        assert any(list(differences(export, Pddl(other_text), rules, grid)) for grid in worlds)
    no_folding = LearnedRule("no", "FOLD", car={"level": ("floor",)})
    stricter = Rules(LearnedRules("mine", "published", rules=(no_folding,)))
    assert any(list(differences(export, Pddl(text), stricter, grid)) for grid in worlds)


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


def test_a_goal_with_a_ramp_is_written(tmp_path):
    two_story = make_task("simple_two_story")
    # Nothing may stand above the floor, or else on a slope: so there is little to write.
    low = tuple(
        LearnedRule(verb.lower(), verb, car={"load": ("block",)}) for verb in ("DROP", "MOVE")
    )
    with pytest.raises(InputError, match="nothing can bring to"):
        write_pddl(two_story, Rules(LearnedRules("low", "published", rules=low)), tmp_path)


def test_patterns_that_split_an_action_without_end_are_refused(monkeypatch):
    """The published rules alone ask 136 times at most in this world; four patterns of two cells make it 198."""
    monkeypatch.setattr(undecided, "_MOST_ANSWERS", 150)
    patterns = []
    for number, aside in enumerate((-1, 1, -2, 2)):
        near = PatternCell((0, aside, 0), ("block",))
        far = PatternCell((1, aside, 0), ("block",))
        patterns.append(LearnedRule(f"two-{number}", "MOVE", (near, far), sides="one"))
    rules = Rules(LearnedRules("split", "published", rules=tuple(patterns)))
    with pytest.raises(InputError, match="leave too many cases to MOVE"):
        PddlExport(small_world(), rules)


def test_what_cannot_be_written_is_said(tmp_path):
    with pytest.raises(InputError, match="there is nothing to plan for"):
        write_pddl(make_task("free_building"), Rules("published"), tmp_path)
    grid = small_world()
    grid.cars[0, CarField.LOAD] = Kind.BLOCK
    with pytest.raises(InputError, match="no load below a thing"):
        PddlExport(grid, Rules("published"))
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
