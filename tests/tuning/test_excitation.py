"""Identification drives go out and back, stay in their area, and put a load down where nobody drives."""

from dataclasses import replace

import numpy as np
import pytest

from craftsim import SmartcarParameters
from craftsim.checking.setup import Seed, setup_of
from craftsim.errors import InputError
from craftsim.tuning.excitation import Area, drive, excitation, free_area

CAR = SmartcarParameters()


def test_a_drive_comes_back_by_the_commands_that_it_went_out_with_and_begins_and_ends_at_rest():
    commands = excitation(60.0, Area(), CAR, 0.02)
    assert commands.shape == (3000, 6)
    assert np.abs(commands[:, :4].sum(axis=0)).max() < 1e-9
    assert np.abs(commands[:, :4]).max() <= CAR.wheel_speed_rad_s
    assert not commands[:50].any()
    assert not commands[-50:].any()


@pytest.mark.parametrize("area", [Area(), Area(1.0, 0.8), Area(3.0, 1.0)], ids=str)
def test_the_way_in_any_direction_keeps_clear_of_the_border(area):
    """Of ideal wheels; tests of the command and docs/reference/reports.md have those that slip."""
    commands = excitation(120.0, area, CAR, 0.02)
    x = y = heading = 0.0
    furthest = np.zeros(2)
    for fl, fr, rl, rr in commands[:, :4] * CAR.wheel_radius_m * 0.02 / 4:
        ahead, left = fl + fr + rl + rr, fr + rl - fl - rr
        x += ahead * np.cos(heading) - left * np.sin(heading)
        y += ahead * np.sin(heading) + left * np.cos(heading)
        heading += (fr + rr - fl - rl) / CAR.turn_radius_m
        furthest = np.maximum(furthest, np.abs([x, y]))
    assert (furthest <= np.array([area.length_m, area.width_m]) / 2 - 0.2).all()
    assert (furthest > 0.3 * (np.array([area.length_m, area.width_m]) / 2 - 0.25)).all()


def test_an_area_without_room_is_refused():
    with pytest.raises(InputError, match=r"0\.5 m by 2 m is too small"):
        Area(0.5, 2.0)


def test_a_load_is_lifted_carried_and_left_behind_the_area():
    commands = excitation(30.0, Area(), CAR, 0.02, True)
    log = drive(free_area(Area(), True), setup_of(drive="wheels"), Seed((0,)), commands).log
    force = log.board[:, 1]
    # Less what the screw's dry friction holds.
    assert np.median(force[110:200]) - np.median(force[-50:]) == pytest.approx(
        0.504 * 9.81, abs=1.0
    )
    out = Area().from_load_m
    assert log.pose[-1, 0] - log.pose[0, 0] == pytest.approx(out, abs=0.05)


def test_steps_in_which_the_solver_gives_up_are_counted():
    commands = excitation(10.0, Area(), CAR, 0.02)[:100]
    setup = setup_of(drive="wheels")
    few = replace(setup, simulation=replace(setup.simulation, solver_iterations=2))
    capped = [
        drive(free_area(Area()), one, Seed((0,)), commands).capped_steps for one in (setup, few)
    ]
    assert capped[0] == 0
    assert capped[1] > 0
