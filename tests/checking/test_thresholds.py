"""Each limit follows from geometry, by the arithmetic that its docstring gives."""

import math
from dataclasses import asdict, replace

import pytest

from craftsim.checking.thresholds import impact_limit_n, thresholds_of
from craftsim.mjcf.machines import NOMINAL
from craftsim.mjcf.parameters import SmartcarParameters


def test_the_limits_of_the_nominal_machines():
    assert asdict(thresholds_of()) == pytest.approx(
        {
            "place_m": 0.00125,
            "turn_rad": 0.00125 / 0.16125,
            "seat_m": 2 * math.sqrt(2) * 0.0002,
            "way_m": (0.3225 - 0.220) / 2,
            "way_lean_rad": math.atan2(0.185, 2 * 0.3225) / 2,
            "contact_n": 0.8 * 10.3 * 9.81 / math.sqrt(2),
            "impact_n": 461.1,
            "duration_ratio": 10.0,
        },
        rel=1e-3,
    )


def test_two_neighbours_at_their_limits_fit_into_the_gap_between_them():
    """Boxes of 320 mm in cells of 322.5 mm: whatever takes all of one's reach leaves it in its half of the gap."""
    limits = thresholds_of()
    half_cell_m = 0.3225 / 2
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        heading = share * limits.turn_rad
        offset = limits.place_m - half_cell_m * heading
        corner = NOMINAL.block.side_m / 2 * (math.cos(heading) + math.sin(heading))
        assert offset + corner <= half_cell_m


def test_a_lighter_car_holds_less_and_a_wider_one_has_less_room():
    light = SmartcarParameters(wheel_mass_kg=0.65)
    wide = SmartcarParameters(wheel_y_m=0.092)
    nominal = thresholds_of()
    lighter = thresholds_of(replace(NOMINAL, cars=(light,)))
    assert lighter.contact_n == pytest.approx(nominal.contact_n * light.mass_kg / 10.3)
    assert lighter.impact_n < nominal.impact_n
    wider = thresholds_of(replace(NOMINAL, cars=(wide,)))
    assert wider.way_m == pytest.approx((0.3225 - 0.227) / 2)
    assert wider.place_m == nominal.place_m


def test_the_impact_limit_is_above_what_a_loaded_car_and_its_motors_do():
    assert 420 < impact_limit_n() < 500
