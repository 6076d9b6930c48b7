"""The Python call ``craftsim.validate``: what it runs and returns, and when the world agrees."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from discrete.drawn import draw
from skills.disturbances import pushed

from craftsim.checking import setup
from craftsim.checking.attempt import Attempt
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.envs import parallel_env
from craftsim.errors import InputError
from craftsim.planning.plan_file import Plan
from craftsim.validation.validation import validate
from craftsim.validation.worlds import RandomWorlds

RIGHT = Action.MOVE_RIGHT
GRID = draw((4, 2, 2), [(Kind.BLOCK, (3, 1, 1))], [(0, 0, 1, 0), (0, 1, 1, 0)])


def _plan(*ticks) -> Plan:
    return Plan(Path("own.plan"), ticks)


MOVES = _plan(((0, RIGHT), (1, RIGHT)), ((0, RIGHT),))
ONCE = {"randomize": "none", "trials": 1, "order": "ticks", "drive": "wheels"}


def test_a_plan_in_a_world_of_ones_own_agrees_and_every_action_is_a_row():
    result = validate(GRID, plan=MOVES, **ONCE)
    assert result.agrees
    assert repr(result) == "Validation(1 of 1 runs agree, 3 of 3 actions as predicted)"
    frame = result.to_frame()
    assert list(
        frame[["world", "by", "tick", "car", "action", "result"]].itertuples(index=False)
    ) == [
        ("grid", "own", 0, 0, "MOVE_RIGHT", "as predicted"),
        ("grid", "own", 0, 1, "MOVE_RIGHT", "as predicted"),
        ("grid", "own", 1, 0, "MOVE_RIGHT", "as predicted"),
    ]
    assert all(isinstance(attempt, Attempt) and attempt.agrees for attempt in result.attempts)
    assert "3 of 3 actions as predicted" in result._repr_html_()


def test_a_function_plays_as_a_policy():
    def stay(observations):
        return {agent: int(Action.STOP) for agent in observations}

    result = validate("strip", policy=stay, trials=2, randomize="none", drive="wheels")
    assert result.agrees
    assert [record["group"] for record in result.records] == ["stay", "stay"]
    assert {attempt.action for attempt in result.attempts} == {"STOP"}
    assert not any(record["extra"]["physics_success"] for record in result.records)


def test_every_order_of_a_plan_leads_to_the_same_attempts_and_only_concurrency_saves_time():
    makespans = {}
    for order in ("sequential", "ticks", "concurrent"):
        (record,) = validate(GRID, plan=MOVES, **ONCE | {"order": order}).records
        assert record["agrees"]
        assert [(a["tick"], a["car"]) for a in record["attempts"]] == [(0, 0), (0, 1), (1, 0)]
        starts = [a["start_s"] for a in record["attempts"]]
        assert (starts[0] == starts[1]) is (order != "sequential")
        makespans[order] = record["extra"]["makespan_s"]
    assert max(makespans["ticks"], makespans["concurrent"]) < 0.8 * makespans["sequential"]


def test_a_bystander_that_moves_too_far_disagrees_whoever_asks(monkeypatch):
    monkeypatch.setattr(setup, "Executor", pushed(0, 0.004))
    result = validate(GRID, plan=_plan(((0, RIGHT),)), **ONCE)
    (attempt,) = result.attempts
    assert 0.001 < attempt.bystander_displacement_m < 0.025
    assert attempt.finding == "agrees", "the grid that is read is the predicted one"
    assert (attempt.result, attempt.agrees, result.agrees) == ("side effect", False, False)
    assert result.figures.matrix["legal"].side_effect == 1

    env = parallel_env("strip", "physics")
    env.reset(seed=0)
    infos = env.step({"car_0": int(Action.STOP), "car_1": int(Action.MOVE_LEFT)})[4]
    told = infos["car_1"]
    assert (told["result"], told["finding"]) == ("side effect", "agrees")
    assert told["reason"].startswith("block 0 was moved by")
    assert 0.001 < told["bystander_displacement_m"] < 0.025


def test_a_failing_car_stops_what_depends_on_it_and_nothing_else(monkeypatch):
    class Weak(setup.Executor):
        def __init__(self, physics, *args, **kwargs):
            super().__init__(physics, *args, **kwargs)
            physics.model.actuator_forcerange[physics.cars[0].wheel_actuators] = 0.0

    monkeypatch.setattr(setup, "Executor", Weak)
    result = validate(GRID, plan=MOVES, **ONCE | {"order": "concurrent", "drive": "rollers"})
    first, other, last = result.attempts
    assert (first.performed, first.agrees) == (True, False)
    assert other.agrees
    assert (last.performed, last.reason) == (False, "car 0 waits for an action that failed")


def test_gains_and_machines_of_ones_own_decide_and_are_part_of_the_configuration():
    from craftsim.mjcf.machines import Machines
    from craftsim.mjcf.parameters import SmartcarParameters
    from craftsim.skills.gains import load_gains

    gains = load_gains()
    slow = replace(gains, drive=replace(gains.drive, max_speed=gains.drive.max_speed / 2))
    heavy = Machines((SmartcarParameters(chassis_mass_kg=2.0),))
    plain, slower, heavier = (
        validate(GRID, plan=MOVES, **ONCE, **options)
        for options in ({}, {"gains": slow}, {"machines": heavy})
    )
    assert slower.attempts[0].duration_s > plain.attempts[0].duration_s
    digests = [result.config["digests"] for result in (plain, slower, heavier)]
    assert digests[0]["gains"] != digests[1]["gains"]
    assert digests[0]["machines"] == digests[1]["machines"] != digests[2]["machines"]
    assert heavier.attempts != plain.attempts


def test_records_in_a_folder_are_those_without_one(tmp_path):
    words = ONCE | {"randomize": "strong", "trials": 2, "seed": 3}
    here = validate(GRID, plan=MOVES, **words)
    there = validate(GRID, plan=MOVES, **words, out=tmp_path / "out", workers=2)
    assert there.attempts == here.attempts
    one, other = (record["attempts"] for record in here.records)
    assert one != other


def test_wrong_arguments_are_refused():
    for worlds, options, message in [
        (GRID, {"trials": 0}, "at least 1"),
        (GRID, {"plan": MOVES, "policy": "random"}, "--plan and --policy exclude each other"),
        (GRID, {"workers": 2}, "need the folder 'out'"),
        (GRID, {}, "there is no shipped plan for grid"),
        ([GRID, GRID], {"policy": "random"}, "two worlds are called 'grid'"),
        (["strip", "block"], {"plan": MOVES}, "plan needs the one world"),
    ]:
        with pytest.raises(InputError, match=message):
            validate(worlds, **options)


def test_an_observer_of_ones_own_sees_every_control_period_and_the_start_is_not_changed():
    before = GRID.copy()
    for options in ({"plan": MOVES}, {"policy": "random"}):
        times: list[float] = []
        world = GRID if "plan" in options else RandomWorlds(n_cars=1, n_blocks=0, max_steps=3)
        validate(world, observers=[lambda physics: times.append(physics.time_s)], **options, **ONCE)  # noqa: B023
        assert len(times) > 50
        assert all(later > earlier for earlier, later in pairwise(times))
    assert GRID.same_visible(before)
    np.testing.assert_array_equal(GRID.cars, before.cars)
