"""Learned rules: what a learner finds where rules replace physics, so that the truth is known."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest

from craftsim import cli
from craftsim.audit import examples as tried
from craftsim.audit import known_corrections, learning
from craftsim.audit.examples import Example, WorldAction, near_misses, surroundings_of
from craftsim.audit.induction import ExampleSet, Pattern, cautious, fit, similar
from craftsim.audit.known_corrections import KnownCorrections, correction_found
from craftsim.audit.learning_report import learning_report
from craftsim.audit.learning_result import run_learning
from craftsim.audit.queries import Option, unfamiliar
from craftsim.checking.attempt import Verdict
from craftsim.checking.setup import setup_of
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kernel import patterns as bits
from craftsim.discrete.kinds import Action
from craftsim.discrete.learned import (
    CAR_PROPERTIES,
    LearnedRule,
    LearnedRules,
    PatternCell,
    RulesOrigin,
    Verb,
    rules_text,
)
from craftsim.discrete.rules import Rules
from craftsim.errors import InputError
from craftsim.experiments.anytime import play_lower_bound
from craftsim.experiments.experiment import RunOptions
from craftsim.experiments.session import RUN_ALONE
from craftsim.mjcf.machines import Machines
from craftsim.mjcf.parameters import SmartcarParameters

FAULT = LearnedRule("fault", "LIFT", (PatternCell((1, 0, 0), ("block",)),))
"""A machine that cannot lift towards a block."""


_GAVE_UP = SimpleNamespace(agrees=False, result=Verdict.NUMERICS)


class _RulesInsteadOfPhysics:
    """Acts as the rules of a setup predict, where other rules, the truth, allow it."""

    def __init__(self, grid, setup, truth):
        self.grid = grid.copy()
        self.rules = Rules(setup.rules)
        self.truth = truth
        self.problems = ()

    def perform(self, car, action):
        agrees = self.truth.legal(self.grid, car, action)
        if agrees:
            self.grid = self.rules.apply(self.grid, car, action)
            self.grid.derive_marks()
        return SimpleNamespace(agrees=agrees, result="", reason="the truth forbids it")


def _learner(monkeypatch, truth):
    monkeypatch.setattr(
        tried, "_judge", lambda grid, setup, seed: _RulesInsteadOfPhysics(grid, setup, truth)
    )
    monkeypatch.setattr(learning, "_EPISODES", 16)
    monkeypatch.setattr(learning, "_POOL_WORLDS", 6)
    monkeypatch.setattr(learning, "_NEAR_MISSES", 10)
    monkeypatch.setattr(learning, "_UNFAMILIAR", 60)
    monkeypatch.setattr(known_corrections, "_WORLDS", 4)
    budget = learning.Budget(share=0.9, most_actions=4000, held_out=300)
    return learning.RuleLearner(
        setup_of(rules="published"), "published", 1, None, RUN_ALONE, budget
    )


def test_a_planted_fault_of_the_machine_is_learned_and_nothing_else(monkeypatch):
    learner = _learner(monkeypatch, Rules(LearnedRules("truth", rules=(FAULT,))))
    learner.is_cautious = False
    result = run_learning(learner, "mine", "published")
    assert {rule.action for rule in result.rules.rules} == {"LIFT"}
    (rule,) = result.rules.rules
    assert rule.cells == FAULT.cells
    assert rule.failures == rule.trials > 5
    assert result.reasons == ()
    assert result.forbidden == 0


def test_cautious_rules_forbid_beyond_a_fault_only_what_never_worked(monkeypatch):
    learner = _learner(monkeypatch, Rules(LearnedRules("truth", rules=(FAULT,))))
    learner.with_rows = False
    rules = learner.learn("mine")
    (rule,) = rules.rules
    (cell,) = rule.cells
    assert cell.at == FAULT.cells[0].at
    assert cell.allowed & FAULT.cells[0].allowed
    assert rule.failures == rule.trials > 5


def test_without_failures_nothing_is_learned(monkeypatch):
    learner = _learner(monkeypatch, Rules("published"))
    rules = learner.learn("mine")
    assert rules.rules == ()
    assert learner.rounds[-1].certain >= 0.9


def test_a_fault_that_is_gone_after_the_first_trials_is_not_learned(monkeypatch):
    """A rule that physics does not ask for is planted: what it forbids failed in the first round's play."""
    learner = _learner(monkeypatch, Rules("published"))
    monkeypatch.setattr(learning, "_EPISODES", 6)
    learner.with_rows = False
    truths = {True: Rules(LearnedRules("truth", rules=(FAULT,))), False: Rules("published")}
    monkeypatch.setattr(
        tried,
        "_judge",
        lambda grid, setup, seed: _RulesInsteadOfPhysics(
            grid, setup, truths[not learner.n_actions]
        ),
    )
    assert learner.learn("mine").rules == ()
    assert learner.rounds[0].failures > 2


def test_what_only_stands_beside_a_fault_is_not_learned(monkeypatch):
    """In the first round's play a block behind the car is there with each failure, and without one never."""
    learner = _learner(monkeypatch, Rules(LearnedRules("truth", rules=(FAULT,))))
    learner.with_rows = False
    learner.is_cautious = False
    monkeypatch.setattr(learning, "_EPISODES", 6)
    monkeypatch.setattr(learning, "_UNFAMILIAR", 0)
    play = learner._play

    def played(rules, number, stage):
        examples = play(rules, number, stage)
        if number > 0:
            return examples
        ahead, behind = (_bits_at(examples, (forward, 0, 0)) for forward in (1, -1))
        is_block = 1 << bits.BLOCK_BIT
        pairs = zip(examples, ahead & is_block, behind & is_block, strict=True)
        return [example for example, first, second in pairs if first == second]

    monkeypatch.setattr(learner, "_play", played)
    rules = learner.learn("mine")
    assert learner.rounds[0].failures > 0
    for rule in rules.rules:
        assert [cell.at for cell in rule.cells] == [(1, 0, 0)]


def _bits_at(examples, place):
    """Return (n,): the bits in the cell so far ahead, left and up."""
    number = _column(place, 0) // bits.N_BITS
    return np.array([example.surroundings[number] for example in examples])


def test_an_action_that_never_works_is_forbidden_everywhere(monkeypatch):
    never = LearnedRule("never", "LIFT", car={"load": CAR_PROPERTIES["load"]})
    learner = _learner(monkeypatch, Rules(LearnedRules("truth", rules=(never,))))
    learner.with_rows = False
    rules = learner.learn("mine")
    (rule,) = rules.rules
    assert (rule.action, rule.cells, len(rule.states)) == ("LIFT", (), bits.N_OWN)
    assert rule.failures == rule.trials > 5
    assert not Rules(rules).legal(_world(), 0, Action.LIFT)


def test_machines_of_which_there_is_no_world_are_refused_at_once():
    wheels = {"wheel_gain_nms_rad": 2000.0}
    setup = setup_of(rules="published", machines=Machines((SmartcarParameters(**wheels),)))
    learner = learning.RuleLearner(setup, "published", 1, None, RUN_ALONE)
    with pytest.raises(InputError, match="gain of 2000"):
        learner.learn("mine")
    with pytest.raises(InputError, match=r"no trial of held-out-.* has finished.*gain of 2000"):
        learner.held_out("published", "held-out")


def test_play_that_brings_no_action_ends(monkeypatch):
    learner = _learner(monkeypatch, Rules("published"))
    never = []
    for verb in get_args(Verb):
        name = verb.lower().replace("_", "-")
        never.append(LearnedRule(name, verb, car={"load": CAR_PROPERTIES["load"]}))
    assert learner.held_out(LearnedRules("never", rules=tuple(never)), "held-out") == []
    monkeypatch.setattr(tried, "_judge", lambda grid, setup, seed: None)
    with pytest.raises(InputError, match="none of them stands"):
        learner.learn("mine")


def test_a_resumed_stage_is_of_the_same_situations(monkeypatch, tmp_path):
    learner = _learner(monkeypatch, Rules("published"))
    learner.out = tmp_path
    learner.options = RunOptions(resume=True)
    # Neither is legal without a load, so that no physics is needed.
    turn = WorldAction(blueprint_text(_world()), 0, Action.DROP)
    learner._try([turn], "situations")
    with pytest.raises(InputError, match="jobs"):
        learner._try([turn._replace(action=Action.UNFOLD)], "situations")


def test_play_under_other_rules_is_another_stage(monkeypatch):
    learner = _learner(monkeypatch, Rules("published"))
    stages = {}

    def noted(stage, jobs):
        stages[stage] = learning.jobs_digest(jobs)
        return []

    monkeypatch.setattr(learner, "_run", noted)
    moves = LearnedRule("moves", "MOVE", car={"load": CAR_PROPERTIES["load"]})
    for rules in ("published", "physical", LearnedRules("stands", rules=(moves,))):
        learner.held_out(rules, "held-out")
    assert len(stages) == len(set(stages.values())) == 3


def _world(*blocks):
    grid = Grid.empty((7, 7, 2), n_cars=1)
    grid.cars[0, :4] = (3, 3, 1, 0)
    grid.kind[3, 3, 1] = Kind.BLOCK
    for cell in blocks:
        grid.kind[cell] = Kind.BLOCK
    grid.derive_marks()
    return grid


def _example(worked, *blocks):
    verb, around = surroundings_of(_world(*blocks), 0, Action.LIFT)
    return Example(verb, around, worked)


@pytest.mark.parametrize("both_sides", [True, False])
def test_patterns_are_minimal_and_cover_no_success(both_sides):
    rows = [
        _example(False, (4, 3, 1)),
        _example(False, (4, 3, 1), (1, 1, 1)),
        _example(False, (4, 3, 1), (3, 5, 1), (2, 3, 1)),
        _example(True, (1, 1, 1)),
        _example(True, (3, 5, 1), (2, 3, 1)),
        _example(True),
    ]
    examples = ExampleSet.of(1, rows, both_sides)
    patterns, uncovered = fit(examples, np.random.default_rng(0))
    assert not uncovered.any()
    (pattern,) = patterns
    matched = examples.matches(pattern.conditions)
    assert not examples.successes[matched].any()
    (cell,) = learning._pattern_cells(pattern)
    assert (cell.at, cell.has) == ((1, 0, 0), ("block",))


def _column(place, bit):
    """Return the column of a bit in the cell so far ahead, left and up."""
    levels = bits.HIGHEST - bits.LOWEST + 1
    forward, aside, up = place
    number = (forward + bits.REACH_CELLS) * bits.SIDE + aside + bits.REACH_CELLS
    return (number * levels + up - bits.LOWEST) * bits.N_BITS + bit


def test_a_rule_needs_all_conditions_of_its_pattern_on_one_cell(monkeypatch):
    learner = _learner(monkeypatch, Rules("published"))
    conditions = []
    for direction in (2, 3):
        conditions.append(frozenset({_column((1, 0, 0), bits.GEAR_BIT + direction)}))
    rules = Rules(learner._rules("mine", [Pattern(1, tuple(conditions))]))
    grid = _world()
    assert rules.legal(grid, 0, Action.LIFT)
    for forbidden, place, yaw in ((False, (5, 3, 1), 2), (True, (4, 4, 1), 3)):
        grid.kind[place] = Kind.FSLOPE
        grid.yaw[place] = yaw
        grid.derive_marks()
        assert Rules("published").legal(grid, 0, Action.LIFT)
        assert rules.legal(grid, 0, Action.LIFT) == (not forbidden)


def test_a_car_has_what_all_conditions_of_a_pattern_allow():
    first = bits.N_CELLS * bits.N_BITS
    loads = [frozenset({first + 1, first + 2}), frozenset({first + 2, first + 3})]
    assert Pattern(0, tuple(loads)).car == {"load": ("flag",)}


def test_a_turn_to_the_right_is_the_mirror_image_of_one_to_the_left():
    grid = _world((3, 4, 1), (4, 5, 1))
    grid.cars[0, 4] = Kind.BLOCK
    grid.kind[3, 3, 1] = Kind.AIR
    image = grid.copy()
    image.cells[:] = grid.cells[:, ::-1]
    left = surroundings_of(grid, 0, Action.ROTATE_LEFT)
    right = surroundings_of(image, 0, Action.ROTATE_RIGHT)
    assert left[0] == right[0] == bits.VERBS.index("ROTATE_LEFT")
    assert np.array_equal(left[1], right[1])


def test_rows_of_an_audit_are_situations_that_the_base_allows():
    rules = Rules("published")
    situations = learning.audit_situations("published")
    assert len(situations) > 300
    for situation in situations[::40]:
        assert rules.legal(situation.grid, situation.car, situation.action)


def test_traces_say_what_was_around_a_car():
    (line,) = tried.trace_lines([_example(False, (4, 3, 1))])
    trace = json.loads(line)
    assert trace["action"] == "LIFT"
    assert trace["car"]["load"] == "none"
    assert trace["worked"] is False
    assert trace["cells"]["1,0,0"] == trace["cells"]["0,0,0"] == ["block"]
    assert trace["cells"]["0,0,-1"] == ["ground"]
    assert "2,0,0" not in trace["cells"]


def test_near_misses_are_worlds_without_one_thing_each():
    grid = _world((4, 3, 1), (4, 3, 2), (0, 3, 1))
    misses = near_misses(WorldAction(blueprint_text(grid), 0, Action.LIFT))
    gone = set()
    for miss in misses:
        missing = np.argwhere(miss.grid.kind != grid.kind)
        assert len(missing) == 1
        gone.add(tuple(missing[0].tolist()))
    # A block below another one is not taken: that would float.
    assert gone == {(4, 3, 2), (0, 3, 1), (3, 3, 1)}


@pytest.mark.parametrize(
    "option",
    [
        "--actions LIFT",
        "--situations lift*",
        "--only legal",
        "--quick",
        "--no-stop",
        "--record trajectory",
        "--minimize",
        "--trials 3",
    ],
)
def test_what_learning_does_not_read_is_refused(option, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = option.split()
    assert cli.main(["audit", "--learn", "mine.yaml", *words]) == 2
    assert f"leave {words[0]} out" in capsys.readouterr().err
    assert cli.main(["audit", "--compare", "physical"]) == 2
    assert "are for --learn" in capsys.readouterr().err


def test_a_file_of_something_else_is_not_replaced_by_rules(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    path = Path("mine.yaml")
    path.write_text("smartcar: {chassis_mass_kg: 2.0}\n")
    words = ["audit", "--learn", "mine.yaml", "--machines", "mine.yaml"]
    assert cli.main(words) == 2
    assert "mine.yaml is there already; choose another name" in capsys.readouterr().err
    assert cli.main([*words, "--resume"]) == 2
    assert "mine.yaml" in capsys.readouterr().err
    assert path.read_text() == "smartcar: {chassis_mass_kg: 2.0}\n"
    path.write_text(rules_text(LearnedRules("mine", origin=RulesOrigin(seed=1))))
    assert cli.main(["audit", "--learn", "mine.yaml", "--resume"]) == 2
    assert "of other machines or of another seed" in capsys.readouterr().err
    assert cli.main(["audit", "--learn", "mine.yaml/rules.yaml"]) == 2
    assert "cannot make the output directory mine.yaml" in capsys.readouterr().err
    assert cli.main(["audit", "--learn", "out/audit/config.yaml"]) == 2
    assert "is the run's own file of options" in capsys.readouterr().err
    assert cli.main(["audit", "--learn", f"{'x' * 81}.yaml"]) == 2
    assert "--learn: the file's name is that of the rules" in capsys.readouterr().err


def test_every_situation_has_a_seed_of_its_own(monkeypatch):
    seeds = []

    def noted(grid, setup, seed):
        seeds.append(seed)

    worlds = [_world((x, y, 1)) for x in (0, 2) for y in range(7)]
    situations = [WorldAction(blueprint_text(world), 0, Action.LIFT) for world in worlds]
    for seed in (1, 2):
        learner = _learner(monkeypatch, Rules("published"))
        monkeypatch.setattr(tried, "_judge", noted)
        learner.seed = seed
        for stage in ("round-00-near", "round-01-near"):
            learner.tried.clear()
            learner._try(situations, stage)
    assert len(seeds) == len(set(seeds)) == 4 * len(situations)


def test_uncovered_are_the_failures_that_no_rule_forbids(monkeypatch):
    learner = _learner(monkeypatch, Rules("published"))
    # Four of seven fail in the same surroundings, so that nothing tells them from the others; one fails of three.
    for n_failures, n_successes, blocks in ((4, 3, [(4, 3, 1)]), (1, 2, [(3, 5, 1)])):
        learner.examples += [_example(False, *blocks)] * n_failures
        learner.examples += [_example(True, *blocks)] * n_successes
    patterns, n_uncovered = learner._fitted(0)
    assert (patterns, n_uncovered) == ([], 5)


def test_a_pattern_like_another_one_is_of_a_cell_beside_it():
    cell = (1, 0, bits.HIGHEST)
    pattern = Pattern(1, (frozenset({_column(cell, bits.BLOCK_BIT)}),))
    beside = set()
    for conjecture in similar([pattern]):
        ((_, allowed),) = conjecture.cells
        if allowed == 1 << bits.BLOCK_BIT:
            (place,) = learning._pattern_cells(conjecture)
            beside.add(place.at)
    assert beside == {(2, 0, 2), (0, 0, 2), (1, 1, 2), (1, -1, 2), (1, 0, 1)}


def test_what_is_certain_counts_episodes_and_every_rule_set_that_was_tried(monkeypatch):
    assert tried.episodes_of([]) == ([], [])
    of_two = []
    for trial, worked in (("a", True), ("b", True), ("a", False)):
        of_two.append(_example(worked)._replace(trial=trial))
    assert tried.episodes_of(of_two) == ([2, 1], [True, False])
    certain = []
    for truth in (Rules("published"), Rules(LearnedRules("truth", rules=(FAULT,)))):
        learner = _learner(monkeypatch, truth)
        learner.with_rows = False
        learner.learn("mine")
        certain.append([this_round.certain for this_round in learner.rounds])
    n_actions = [80] * 16
    assert certain[0][0] < 1 - 0.05 / 80
    first = play_lower_bound(n_actions, [False] * 16, 0.975)
    assert abs(certain[0][0] - first) < 0.002
    # After one rule set has failed the next one needs more evidence.
    assert certain[1][0] == 0 < certain[1][1] < certain[0][0]


def test_a_report_bounds_held_out_play_by_its_worlds(monkeypatch):
    learner = _learner(monkeypatch, Rules("published"))
    learner.with_rows = False
    result = run_learning(learner, "mine", None)
    assert result.episodes < result.held_out / 10
    assert result.bounds[1] == 1 > result.bounds[0] > 0.99
    report = learning_report(result, "craftsim audit", 0.9)
    text = report.headline.sentence
    assert f"actions in {result.episodes} worlds never seen 100.00% as predicted" in text
    assert list(report.notes) == []
    lossy = replace(result, unfinished=1, unsolved=2)
    trial, actions = learning_report(lossy, "craftsim audit", 0.9).notes
    assert trial.startswith("1 trial did not finish")
    assert "gave up in 2 actions" in actions


def test_an_action_in_which_the_solver_gives_up_is_no_example_and_is_counted(monkeypatch):
    judge = SimpleNamespace(grid=_world(), perform=lambda car, action: _GAVE_UP, problems=())
    monkeypatch.setattr(tried, "_judge", lambda grid, setup, seed: judge)
    situation = WorldAction(blueprint_text(_world()), 0, Action.LIFT)
    job = tried.ActionsJob((0,), (situation,), setup_of(rules="published"))
    done = tried.try_actions(job)
    records = [{"key": "a", "extra": done.extra}]
    assert (done.agrees, tried.unsolved_in(records)) == (True, 1)
    assert list(tried.examples_of(records)) == []


def _option(*blocks):
    grid = _world(*blocks)
    return Option(grid, 0, Action.LIFT, *surroundings_of(grid, 0, Action.LIFT))


def test_unfamiliar_is_what_no_action_that_worked_had_together():
    worked = [_example(True, (4, 3, 1)), _example(True, (3, 4, 1))]
    together = _option((4, 3, 1), (3, 4, 1))
    elsewhere = _option((2, 3, 1))
    known = _option((4, 3, 1))
    far = _option((6, 3, 1))
    options = [known, far, together, elsewhere]
    assert unfamiliar([], worked, options, 5) == [elsewhere.situation, together.situation]
    assert unfamiliar([], worked, options, 1) == [elsewhere.situation]
    # A failure tells nothing of what works.
    failed = [_example(False, (2, 3, 1))]
    assert elsewhere.situation in unfamiliar([], [*worked, *failed], options, 1)
    forbidding = Pattern(1, (frozenset({_column((-1, 0, 0), bits.BLOCK_BIT)}),))
    assert unfamiliar([forbidding], worked, options, 5) == [together.situation]


def test_a_cautious_pattern_allows_what_worked():
    examples = ExampleSet.of(
        1, [_example(False, (4, 3, 1)), _example(True, (5, 3, 1)), _example(True)]
    )
    pattern = cautious(examples, Pattern(1, (frozenset({_column((1, 0, 0), bits.BLOCK_BIT)}),)))
    ((_, allowed),) = pattern.cells
    assert allowed == bits.THING_BITS & ~7
    assert not examples.successes[examples.covers(pattern.conditions)].any()


def test_a_correction_is_found_again_where_rules_forbid_its_failures():
    known = KnownCorrections("published")
    grid = _world()
    grid.cars[0, 4] = Kind.BLOCK
    grid.kind[3, 3, 1] = Kind.AIR
    assert known.of(grid, 0, Action.ROTATE_LEFT) == []
    grid.kind[3, 4, 2] = Kind.WALL
    assert known.of(grid, 0, Action.ROTATE_LEFT) == ["overhead_wall"]
    worlds = [_world((4, 3, 1)), _world((4, 3, 1), (1, 1, 1)), _world((2, 3, 1))]
    failed = []
    for world in worlds:
        situation = WorldAction(blueprint_text(world), 0, Action.LIFT)
        failed.append(_example(False)._replace(situation=situation))
    tried_ones = [*failed, _example(True)]
    found = correction_found(tried_ones, {"lift-1": failed[:2], "lift-2": failed[2:], "lift-3": []})
    assert (found.tried, found.failures, found.forbidden) == (4, 3, 3)
    assert found.rules == ("lift-1", "lift-2")
    assert found.is_found
    assert not correction_found(tried_ones, {"lift-1": failed[:2]}).is_found
    assert not correction_found([_example(True)], {}).is_found


def test_rare_corrections_have_situations_of_audit_rows_that_were_not_tried(monkeypatch):
    monkeypatch.setattr(known_corrections, "_WORLDS", 0)
    monkeypatch.setattr(known_corrections, "_MOST_EACH", 2)
    known = KnownCorrections("published")
    rng = np.random.default_rng(0)
    listed = known.situations(rng, ())
    assert len(listed["second_ramp"]) == len(listed["own_ramp"]) == 2
    for name, situations in listed.items():
        for situation in situations:
            assert known.of(situation.grid, situation.car, situation.action) == [name]
    others = known.situations(rng, listed["own_ramp"])
    assert not set(others["own_ramp"]) & set(listed["own_ramp"])
