"""Each row of the table of measurements is sampled from the right place, in its unit, and held against its limit."""

import math
from dataclasses import asdict, fields, replace

import numpy as np
import pytest
from discrete.drawn import draw

from craftsim.checking.attempt import AGREES, Verdict, attempt_of
from craftsim.checking.contacts import Contact
from craftsim.checking.measurements import (
    LABELLED,
    LIMITED,
    MEASUREMENTS,
    NUMBER,
    SUMMARIZED,
    Ending,
    Unit,
    sample_all,
)
from craftsim.checking.setup import Setup, compile_world
from craftsim.checking.thresholds import Thresholds, thresholds_of
from craftsim.checking.watched import Watched
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.readback import CellFit, read_grid
from craftsim.discrete.schedule import SITUATIONS, ScheduledAction, nominal_durations
from craftsim.models.composition import lift_m
from craftsim.skills.outcome import Outcome

CAR = CellFit((1, 0, 1), 0.001, -0.002, None, -0.003, 0.004, 0.0, 0.0)
BYSTANDER = CellFit((3, 0, 1), 0.021, 0.022, None, 0.023, 0.024, 0.025, 0.026)
NAMES = ("car 0", "car 1", "block 0", "block 1")
LOAD_ROW, BYSTANDER_ROW = 2, 3
DROP_S = float(nominal_durations()[Action.DROP, SITUATIONS.index("flat_loaded")])

SAMPLED = {
    "car_error_m": (0.001, "place_m"),
    "heading_error_rad": (0.002, "turn_rad"),
    "height_error_m": (0.003, "place_m"),
    "tilt_error_rad": (0.004, "turn_rad"),
    "board_height_m": (0.005, "place_m"),
    "way_m": (0.006, "way_m"),
    "way_lean_rad": (0.007, "way_lean_rad"),
    "placed_error_m": (0.011, ""),
    "seat_error_m": (0.011, "seat_m"),
    "thing_heading_rad": (0.012, "turn_rad"),
    "thing_tilt_rad": (0.015, "turn_rad"),
    "thing_height_m": (0.013, "place_m"),
    "reach_m": (0.016, "place_m"),
    "bystander_displacement_m": (0.031, "place_m"),
    "bystander_turn_rad": (0.032, "turn_rad"),
    "drift_m": (0.033, "place_m"),
    "drift_rad": (0.034, "turn_rad"),
    "bystander_reach_m": (0.026, "place_m"),
    "bystander_tilt_rad": (0.025, "turn_rad"),
    "contact_force_n": (20.0, "contact_n"),
    "duration_s": (1.234568, ""),
    "duration_ratio": (1.234568 / DROP_S, "duration_ratio"),
    "peak_force_n": (35.0, ""),
    "capped_steps": (4, ""),
    "tries": (2, ""),
}
"""The value of each row at the ending below, and the field of Thresholds that limits it."""
ELSEWHERE = {"impact_n"}
"""Limits of what the contact log sees, which are no rows."""
TEXTS = {
    "car_error_m": "the car is 1.00 mm off (allowed 0.10)",
    "bystander_turn_rad": "block 1 was turned by 32.00 mrad (allowed 0.10)",
}


@pytest.fixture(scope="module")
def ending():
    """The end of a DROP beside a block that was moved, turned and left leaning; all figures are made up."""
    grid = draw((4, 1, 2), [(Kind.BLOCK, (3, 0, 1))], [(1, 0, 1, 0, Kind.BLOCK), (0, 0, 1, 0)])
    physics = compile_world(grid, Setup())
    physics.reset_compiled()
    poses = physics.poses()
    reading = read_grid(poses, physics.size, physics.walls)
    assert [fit.carrier for fit in reading.objects] == [0, None]
    seat_m = lift_m(Kind.BLOCK, physics.machines.car(0), physics.machines)
    load = CellFit((1, 0, 1), 0.011, -0.012, 0, seat_m - 0.013, 0.014, 0.015, 0.016)
    start_rows = physics.data.qpos[physics.pose_places]
    rows = start_rows.copy()
    rows[BYSTANDER_ROW, 0] += 0.031
    rows[BYSTANDER_ROW, 3:] = math.cos(0.016), 0.0, 0.0, math.sin(0.016)
    furthest = np.zeros((4, 2))
    furthest[BYSTANDER_ROW] = 0.033, 0.034
    after = grid.copy()
    after.cars[0] = draw((4, 1, 2), [], [(1, 0, 1, 0)]).cars[0]
    action = Watched(
        ScheduledAction(0, 0, Action.DROP, grid, after),
        legal=True,
        start_s=0.0,
        capped_before=3,
        poses=start_rows,
        reading=reading,
        handled=[LOAD_ROW],
        names=("car 0", "block 0"),
        below=[],
        cars={0},
        movable={LOAD_ROW},
        outcome=Outcome(None, 1.23456789, tries=2),
        contacts=(Contact("block 0", "wall", 1.0, 20.0, False),),
    )
    reading = replace(reading, cars=(CAR, reading.cars[1]), objects=(load, BYSTANDER))
    reported = np.zeros((2, 2), bool)
    return Ending(
        action=action,
        machines=physics.machines,
        poses=poses,
        rows=rows,
        boards_m=np.array([0.005, 0.0]),
        reading=reading,
        furthest=furthest,
        way_m=0.006,
        way_lean_rad=0.007,
        reported=reported,
        excused={0, LOAD_ROW},
        capped_steps=7,
        peak_force_n=35.0,
    )


def test_each_row_is_sampled_from_its_place_in_its_unit(ending):
    values, bystanders = sample_all(ending, NAMES)
    assert values == pytest.approx({name: value for name, (value, _) in SAMPLED.items()})
    assert values["duration_s"] == SAMPLED["duration_s"][0], "to a microsecond"
    assert set(bystanders.values()) == {"block 1"}
    assert list(bystanders) == [row.name for row in LIMITED if row.of == "bystander"]


def test_what_is_excused_or_reported_is_no_bystander(ending):
    values, bystanders = sample_all(replace(ending, excused={0, LOAD_ROW, BYSTANDER_ROW}), NAMES)
    assert {values[name] for name in bystanders} == {0.0}
    assert set(bystanders.values()) <= {"car 1", ""}
    reported = replace(ending, reported=np.array([[False, False], [True, False]]))
    values, bystanders = sample_all(reported, NAMES)
    assert (values["bystander_reach_m"], bystanders["bystander_reach_m"]) == (0.0, "")
    assert values["bystander_tilt_rad"] == 0.025


def test_a_place_that_is_not_a_number_is_the_largest(ending):
    rows = ending.rows.copy()
    rows[1] = math.nan
    values, bystanders = sample_all(replace(ending, rows=rows), NAMES)
    assert math.isnan(values["bystander_displacement_m"])
    assert bystanders["bystander_displacement_m"] == "car 1"


def test_without_a_thing_or_an_outcome_there_is_nothing_of_them(ending):
    action = replace(ending.action, handled=[], outcome=None)
    values, _ = sample_all(replace(ending, action=action, excused={0}), NAMES)
    assert {values[row.name] for row in MEASUREMENTS.values() if row.of == "thing"} == {None}
    assert (values["duration_s"], values["tries"]) == (0.0, 0)


def test_what_the_car_goes_on_carrying_is_not_set_down(ending):
    step = replace(ending.action.step, after=ending.action.step.before)
    action = replace(ending.action, step=step)
    values, _ = sample_all(replace(ending, action=action, excused={0}), NAMES)
    assert values["placed_error_m"] is None
    assert values["seat_error_m"] == 0.011


@pytest.mark.parametrize("row", MEASUREMENTS.values(), ids=list(MEASUREMENTS))
def test_a_name_and_a_limit_say_the_unit(row):
    assert row.limit == SAMPLED[row.name][1]
    suffix = row.unit.suffix and f"_{row.unit.suffix}"
    assert row.name.endswith(suffix)
    assert row.limit.endswith(suffix) or row.unit is NUMBER or not row.limit
    assert row.excess.count("{}") == bool(row.limit)


def test_every_limit_is_that_of_a_row():
    limits = {row.limit for row in LIMITED}
    assert limits | ELSEWHERE == {field.name for field in fields(Thresholds)}


def _judged(ending, name, value, limits):
    """Return the attempt whose only excess, if any, is of one row."""
    measured = dict.fromkeys(MEASUREMENTS, 0.0) | {name: value}
    bystanders = dict.fromkeys(MEASUREMENTS, "block 1")
    watched = replace(ending.action, measured=measured, bystanders=bystanders, contacts=())
    return attempt_of(watched, AGREES, limits)


@pytest.mark.parametrize("row", LIMITED, ids=lambda row: row.name)
def test_a_value_is_held_against_its_own_limit_and_the_reason_names_both(row, ending):
    limit = SAMPLED[row.name][1]
    over = Verdict.SIDE_EFFECT if row.of in ("bystander", "contact") else Verdict.FAILED
    limits = Thresholds(**dict.fromkeys(asdict(thresholds_of()), 1.0) | {limit: 0.0001})
    assert _judged(ending, row.name, 0.0001, limits).result == Verdict.AS_PREDICTED
    for value in (0.00011, math.nan):
        attempt = _judged(ending, row.name, value, limits)
        assert attempt.result == over
        assert row.unit.text(value) in attempt.reason
        assert attempt.reason.endswith(f" (allowed {row.unit.factor * 0.0001:.2f})")
        assert attempt.reason.startswith("block 1 ") == (row.of == "bystander")
    if row.name in TEXTS:
        assert _judged(ending, row.name, SAMPLED[row.name][0], limits).reason == TEXTS[row.name]


def test_a_reason_names_one_distance_and_one_angle_of_a_bystander_first_those_of_the_action(ending):
    measured = dict.fromkeys(MEASUREMENTS, 0.0)
    measured |= dict.fromkeys(("bystander_displacement_m", "drift_m", "bystander_reach_m"), 0.5)
    measured |= dict.fromkeys(("drift_rad", "bystander_tilt_rad"), 0.25)
    bystanders = dict.fromkeys(MEASUREMENTS, "block 1")
    limits = Thresholds(**dict.fromkeys(asdict(thresholds_of()), 0.001))
    moved = "block 1 was moved by 500.00 mm (allowed 1.00)"
    turned = "block 1 was turned 250.00 mrad away from how it was left (allowed 1.00)"
    watched = replace(ending.action, measured=measured, bystanders=bystanders, contacts=())
    assert attempt_of(watched, AGREES, limits).reason == f"{moved}; {turned}"
    bystanders["drift_m"] = "car 1"
    left = "car 1 was 500.00 mm away from where it was left (allowed 1.00)"
    assert attempt_of(watched, AGREES, limits).reason == f"{moved}; {left}"
    measured["height_error_m"] = 0.002
    high = "the car's height is 2.00 mm off (allowed 1.00)"
    assert attempt_of(watched, AGREES, limits).reason == f"{high}; {moved}; {left}"


def test_labels_and_columns_are_of_one_row_each():
    labels = [row.shown_label for row in LABELLED]
    assert len(set(labels)) == len(labels)
    columns = [row.column for row in SUMMARIZED]
    assert len(set(columns)) == len(columns)


def test_a_unit_shows_values_as_reports_do():
    assert Unit("m", "mm", 1e3).text(0.00123) == "1.23 mm"
    assert Unit("", "").text(2) == "2.00"
    names = [MEASUREMENTS[name] for name in ("car_error_m", "heading_error_rad", "tries")]
    assert [row.shown_name for row in names] == ["car_error_mm", "heading_error_mrad", "tries"]
    assert names[1].shown_label == "car's heading, mrad"
    assert names[1].largest_name == "max_car_heading_error_mrad"
