"""Swept volumes follow from the machines' geometry, and find what is in the way on other levels, too."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from craftsim.audit.audit import AuditTrial, run_trial
from craftsim.audit.neighbours import (
    HOME,
    bare_situations,
    bodies_of,
    nearby,
    occupants,
    place_of,
    read_table,
    shift_of,
)
from craftsim.audit.situation import intended
from craftsim.audit.swept import sweep
from craftsim.checking.setup import setup_of
from craftsim.cli import main
from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint
from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.rules import Rules
from craftsim.mjcf.machines import NOMINAL, Machines
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.models.composition import placements

SITUATIONS = {one.id: one for one in bare_situations()}
OCCUPANTS = {one.name: one for one in occupants()}
ROLLERS = replace(NOMINAL, drive="rollers")
CENTRE = (HOME[0] + 0.5) * CELL_PITCH_M


def _clearance_mm(situation, occupant, at, machines=ROLLERS):
    volume = sweep(SITUATIONS[situation], machines)
    found = volume.clearance(bodies_of(OCCUPANTS[occupant], machines)[0], 0.05, shift_of(at))
    return None if found is None else found.distance_m * 1e3


def _corners(situation):
    return np.vstack([piece.points for piece in sweep(SITUATIONS[situation], NOMINAL).pieces])


def test_the_legs_of_a_turning_block_sweep_as_far_as_its_corners_are_from_its_middle():
    reach = np.linalg.norm(_corners("ROTATE_LEFT/load=block")[:, :2] - CENTRE, axis=1).max()
    assert (
        reach
        == pytest.approx(NOMINAL.block.side_m / np.sqrt(2), abs=1e-4)
        == pytest.approx(0.226, abs=5e-4)
    )


def test_the_lip_of_a_flap_goes_beyond_the_foots_cell():
    hinge = CENTRE - NOMINAL.slope.hinge_x_m
    lip = hinge - _corners("UNFOLD")[:, 0].min()
    assert lip == pytest.approx(0.334, abs=5e-4)
    assert lip > CELL_PITCH_M + 0.01


def test_a_bare_situation_is_legal_and_its_way_ends_where_the_predicted_car_stands():
    for name, one in SITUATIONS.items():
        assert all(one.legal(Rules(rules)) for rules in ("physical", "published")), name
        if not name.startswith(("MOVE", "ROTATE")):
            continue
        box = sweep(one, NOMINAL).box
        for world in (one.grid, intended(one.grid, 0, one.acts[0])):
            position = placements(world)[0].position
            assert (box[0] <= position + 1e-4).all(), name
            assert (position <= box[1]).all(), name
            # On the flat the wheels touch the floor below the car; on a ramp the lower axle is below its middle.
            assert position[2] - box[0, 2] < 0.36 * CELL_PITCH_M, name


def test_other_dimensions_sweep_other_volumes():
    for situation, axis, metres, car in (
        ("LIFT/load=block", 2, 0.004, SmartcarParameters(board_travel_m=0.049)),
        ("MOVE-forward/load=none", 0, 0.003, SmartcarParameters(chassis_length_m=0.226)),
    ):
        other, own = (
            sweep(SITUATIONS[situation], one).box[1] for one in (Machines(cars=(car,)), NOMINAL)
        )
        assert other[axis] == pytest.approx(own[axis] + metres)


def test_a_neighbour_is_as_near_as_the_machines_say_on_other_levels_too():
    for situation, occupant, at, least_mm, most_mm in [
        ("ROTATE_LEFT/load=block", "car+block-low-left", (1, 0, -1), -99.0, -20.0),
        ("ROTATE_LEFT/load=block", "car+fslope-forward", (1, 0, -1), -99.0, -9.9),
        ("UNFOLD", "car+block-low-right", (-2, 0, -1), -99.0, -4.5),
        ("ROTATE_LEFT/load=block", "wall", (1, 0, 1), -99.0, -10.0),
        ("MOVE-forward/load=block", "wall", (1, 0, 1), -99.0, -20.0),
        ("ROTATE_LEFT/load=block", "car-low-left", (1, 0, -1), -0.01, 99.0),
        ("ROTATE_LEFT/load=block", "car+block", (1, 0, -1), -0.01, 99.0),
        ("ROTATE_LEFT/load=slope", "car+fslope-left", (1, 0, -1), -0.01, 99.0),
        ("MOVE-forward/load=block", "block", (1, 1, 0), 2.49, 2.51),
    ]:
        found = _clearance_mm(situation, occupant, at)
        assert least_mm < (50.0 if found is None else found) < most_mm


def test_the_list_of_the_package_is_what_geometry_says():
    for one in read_table()[::120]:
        found = _clearance_mm(one["situation"], one["occupant"], place_of(one))
        if not one["clearance_mm"]:
            assert found is None or found > 2.3, one
        elif found > -20.0:
            assert found == pytest.approx(float(one["clearance_mm"]), abs=0.11), one
        else:
            assert float(one["clearance_mm"]) < -19.0, one


def test_the_command_lists_what_is_within_reach_and_fails_for_an_allowed_collision(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.setenv("COLUMNS", "200")
    status = main(
        ["audit", "clearance", "--actions", "DROP", "--rules", "published", "--out", str(tmp_path)]
    )
    assert status == 1
    said = capsys.readouterr().out
    assert "DROP/load=slope" in said
    found = "DROP/load=slope/near=fslope-right@(-1,1,0) -14.8 slope gear_right and slope gear_left"
    assert found in re.sub(" +", " ", said)
    rows = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))["figures"][
        "clearance"
    ]["rows"]
    assert all(row["clearance_mm"] is not None or not row["legal"] for row in rows)


def test_every_neighbourhood_is_drawn_as_the_rules_read_it():
    found = nearby("physical", ("UNFOLD",))
    assert len({near.row for near, _, _ in found}) == len(found) > 50
    for near, legal, _ in found:
        assert near.legal(Rules("physical")) == legal
        assert parse_blueprint(blueprint_text(near.grid), near.id)


def test_physics_meets_what_geometry_expects_in_the_way():
    (near,) = (
        near
        for near, _, _ in nearby("published", ("ROTATE_LEFT",))
        if near.id == "ROTATE_LEFT/load=block/near=wall@(-1,0,1)"
    )
    done = run_trial(AuditTrial(near, True, 0, 0, setup_of("none", "published")))
    assert near.clearance_mm < -10
    assert "wall touched block 0" in done.attempts[0].reason
