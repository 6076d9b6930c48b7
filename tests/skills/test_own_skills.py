"""Skills of a user's own: in place of built-in ones, for all cars or for one, and what is said of wrong ones."""

import json
import math
import pickle

import numpy as np
import pytest

import craftsim
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.errors import InputError
from craftsim.experiments.bundle import read_bundle, replay
from craftsim.models.sensing import measure
from craftsim.skills.executor import Executor
from craftsim.skills.gains import load_gains
from craftsim.skills.library import begin_of, own_skills, performers
from craftsim.skills.outcome import Reason
from craftsim.skills.skill import Command, LawSkill, Skill


class Nod(Skill):
    """Raise the board for a while."""

    def step(self, now):
        if self.elapsed_s > 0.2:
            self.fail(Reason.BLOCKED, "enough")
        return Command(board=0.02)


class Again(Skill):
    """What is built in for an action, stepped in Python."""

    action = Action.MOVE_RIGHT

    def start(self, now):
        self.law = LawSkill(self.setup, begin_of(self.action))
        self.law.start(now)
        self.outcome = self.law.outcome

    def step(self, now):
        command = self.law.step(now)
        self.outcome = self.law.outcome
        return command


class Lift(Again):
    action = Action.LIFT


class Unfold(Again):
    action = Action.UNFOLD


class Says(Skill):
    said = Command()

    def step(self, now):
        return self.said


class Endless(Says):
    time_limit_s = 0.3


class Nonsense(Says):
    said = Command(board=math.nan)


class Wordy(Says):
    said = "up"


class Few(Says):
    said = Command(wheels=(1.0, 2.0))


class Ended(Skill):
    def step(self, now):
        self.outcome = True
        return Command()


class Careless(Skill):
    def __init__(self, setup):
        pass

    def step(self, now):
        return Command()


class Stepless(Skill):
    pass


CHOICE = {Action.LIFT: Nod}
FAST = load_gains("fast")
ACTIONS = {
    "move": (Action.MOVE_RIGHT, Again, []),
    "lift": (Action.LIFT, Lift, [(Kind.BLOCK, (1, 1, 1))]),
    "unfold": (Action.UNFOLD, Unfold, [(Kind.FSLOPE, (1, 1, 1), 2)]),
}


@pytest.mark.parametrize(("action", "own", "objects"), ACTIONS.values(), ids=ACTIONS)
def test_a_skill_that_is_stepped_in_python_does_what_the_compiled_loop_does(
    make_site, action, own, objects
):
    def run(skills):
        physics = make_site((3, 3, 2), [(1, 1, 1, 0)], objects)
        outcome = Executor(physics, skills=skills).run({0: action})[0]
        return outcome, physics.data.qpos.copy()

    outcome, qpos = run(None)
    own_outcome, own_qpos = run({action: own})
    assert outcome.succeeded
    assert own_outcome == outcome
    np.testing.assert_array_equal(own_qpos, qpos)


def test_a_skill_of_ones_own_runs_beside_compiled_ones_and_one_car_may_have_another(make_site):
    physics = make_site((3, 3, 1), [(0, 0, 1, 0), (0, 1, 1, 0), (0, 2, 1, 0)])
    executor = Executor(physics, FAST, skills={Action.LIFT: Endless, 2: CHOICE})
    outcomes = executor.run({0: Action.LIFT, 1: Action.MOVE_RIGHT, 2: Action.LIFT})
    assert outcomes[0].reason is Reason.TIMEOUT
    assert "within 0.3 s" in outcomes[0].detail
    assert outcomes[1].succeeded
    assert (outcomes[2].reason, outcomes[2].detail) == (Reason.BLOCKED, "enough")
    assert outcomes[2].duration_s == pytest.approx(0.22)
    assert 0.003 < measure(physics, 2).board_m < 0.005


def test_a_skill_of_ones_own_is_undone_and_tried_again(make_site):
    outcome = Executor(make_site((1, 1, 1), [(0, 0, 1, 0)]), skills=CHOICE).run({0: Action.LIFT})[0]
    assert (outcome.reason, outcome.tries) == (Reason.BLOCKED, 2)


def test_a_skill_of_ones_own_is_stopped_on_nonsense(make_site, monkeypatch):
    executor = Executor(make_site((1, 1, 1), [(0, 0, 1, 0)]), skills=CHOICE)
    executor.begin(0, Action.LIFT)
    executor.advance()
    read = executor.fleet.read

    def nonsense():
        readings = read().copy()
        readings["pitch"] = np.nan
        return readings

    monkeypatch.setattr(executor.fleet, "read", nonsense)
    assert executor.advance()[0].reason is Reason.DIVERGED


def test_a_skill_that_commands_nan_has_failed(make_site):
    physics = make_site((1, 1, 1), [(0, 0, 1, 0)])
    outcome = Executor(physics, FAST, skills={Action.LIFT: Nonsense}).run({0: Action.LIFT})[0]
    assert outcome.reason is Reason.DIVERGED
    assert "not finite" in outcome.detail
    assert np.isfinite(physics.data.ctrl).all()


def test_a_skill_that_is_no_skill_at_run_time_is_named(make_site):
    for kind, says in (
        (Wordy, "returned 'up'"),
        (Few, "four wheel speeds"),
        (Ended, "outcome is True"),
        (Careless, "super().__init__"),
    ):
        with pytest.raises(InputError, match=kind.__name__) as error:
            Executor(make_site((1, 1, 1), [(0, 0, 1, 0)]), skills={Action.LIFT: kind}).run(
                {0: Action.LIFT}
            )
        assert says in str(error.value)


class _Inside:
    class Deep(Nod):
        pass


def _local():
    class Local(Nod):
        pass

    return Local


def test_what_is_no_choice_of_skills_is_refused_before_anything_runs(make_site):
    for given, says in (
        ({Action.LIFT: Stepless}, "Stepless has no step()"),
        ({Action.LIFT: int}, "no subclass of craftsim.Skill"),
        ({Action.LIFT: _local()}, "at the top of a module"),
        ({"HOP": Nod}, "'HOP' is no action"),
        ({Action.MOVE_FORWARD_LEFT: Nod}, "no skill performs MOVE_FORWARD_LEFT"),
        ({7: {Action.LIFT: Nod}}, "there is no car 7"),
        ("nowhere", "module:NAME"),
        ("no_such_module_at_all:X", "cannot import"),
        (
            {Action.LIFT: Nod, int(Action.LIFT): {Action.DROP: Nod}},
            "LIFT and the car 0 are one key",
        ),
        ("math:pi", "module:NAME"),
    ):
        with pytest.raises(InputError) as error:
            Executor(make_site((1, 1, 1), [(0, 0, 1, 0)]), skills=given)
        assert says in str(error.value)


def test_skills_travel_by_name(make_site):
    own = own_skills(f"{__name__}:CHOICE")
    assert own == own_skills(CHOICE) == pickle.loads(pickle.dumps(own))
    assert own[0].skill == f"{__name__}:Nod"
    assert performers(own, 1)[0][Action.LIFT] is Nod
    assert own_skills({Action.LIFT: _Inside.Deep})[0].skill.endswith("_Inside.Deep")


def test_an_environment_and_the_judge_take_skills_of_ones_own():
    env = craftsim.parallel_env("strip", backend="physics", skills=CHOICE)
    env.reset(seed=0)
    assert env.unwrapped.core.backend.judge.executor._performers[0][Action.LIFT] is Nod
    with pytest.raises(InputError, match="grid backend"):
        craftsim.parallel_env("strip", backend="grid", skills=CHOICE)
    with pytest.raises(InputError, match="no car 5"):
        craftsim.parallel_env("strip", backend="physics", skills={5: CHOICE})
    grid = craftsim.Grid.empty((1, 1, 2), 1)
    grid.kind[0, 0, 1] = Kind.BLOCK
    grid.derive_marks()
    attempt = craftsim.perform(
        craftsim.PhysicsWorld(grid), 0, Action.LIFT, gains=FAST, skills=CHOICE
    )
    assert not attempt.agrees
    assert "enough" in attempt.reason


def test_a_validation_in_worker_processes_names_the_skill_in_its_report_and_its_bundle(tmp_path):
    result = craftsim.validate(
        "strip",
        gains="fast",
        skills=CHOICE,
        trials=1,
        workers=2,
        drive="wheels",
        out=tmp_path,
        randomize="none",
        order="ticks",
    )
    assert not result.agrees
    report = json.loads((tmp_path / "report.json").read_text("utf-8"))
    skills = [{"action": "LIFT", "car": None, "skill": f"{__name__}:Nod"}]
    assert report["config"]["setup"]["skills"] == skills
    folder = next((tmp_path / "bundles").iterdir())
    assert replay(read_bundle(folder)).reproduced
    text = folder / "bundle.json"
    text.write_text(
        text.read_text("utf-8").replace(f"{__name__}:Nod", "no_module_yet:Nod"), "utf-8"
    )
    with pytest.raises(InputError, match="--skills"):
        read_bundle(folder)
