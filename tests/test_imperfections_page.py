"""docs/imperfections.md says what the presets draw, and how far the published machine clears what it passes below."""

import math
from dataclasses import asdict
from pathlib import Path

import pytest

from craftsim.checking.setup import RANDOMIZE, nominal_gains
from craftsim.mjcf.parameters import NOMINAL
from craftsim.models.floor import MOST_TILES

PAGE = (Path(__file__).parents[1] / "docs" / "imperfections.md").read_text(encoding="utf-8")
GRAVITY_M_S2 = 9.81
CAR, BLOCK, SLOPE = NOMINAL.cars[0], NOMINAL.block, NOMINAL.slope
BOARD_M, BOSS_M = CAR.board_rest_m, CAR.board_rest_m + CAR.boss_height_m


def _mm(metres: float) -> str:
    return f"{1e3 * metres:.1f} mm"


@pytest.mark.parametrize(
    "name", ["lippage_m", "tile_m", "joint_m", "joint_depth_m", "unevenness_m", "wavelength_m"]
)
def test_the_floors_of_the_presets_have_their_row(name):
    figures = (asdict(RANDOMIZE[preset][1].floor)[name] for preset in ("lab_floor", "workshop_floor"))
    assert f"| `{name}` | " + " | ".join(f"{1e3 * figure:g} mm" for figure in figures) + " |" in PAGE


def test_the_tolerances_of_the_workshop_are_those_of_the_page():
    making = asdict(RANDOMIZE["workshop_floor"][1].making)
    assert "making: {" + ", ".join(f"{name}: {value}" for name, value in making.items()) + "}" in PAGE


@pytest.mark.parametrize(
    ("what", "clearance_m", "reach_m"),
    [
        (
            "boss below the back bar of a slope's pads",
            SLOPE.underside_m + SLOPE.stop_back_rise_m - BOSS_M,
            CAR.boss_top_side_m / 2,
        ),
        ("board below a slope's rails", SLOPE.underside_m - BOARD_M, CAR.board_length_m / 2),
        ("boss below a block's frame", BLOCK.underside_m - BOSS_M, CAR.boss_top_side_m / 2),
        ("board below a block's frame", BLOCK.underside_m - BOARD_M, CAR.board_length_m / 2),
    ],
)
def test_clearances_and_the_lippage_that_takes_them(what, clearance_m, reach_m):
    """Two wheels on a tile that is higher by h raise what lies x before the middle by h / 2 + x h / wheelbase.

    A stiff wheel that meets a step of h at speed v goes on at right angles to its radius there, so upwards with
    v sqrt(2 h / R), and rises by v^2 h / (g R).
    """
    astride = clearance_m / (0.5 + reach_m / (2 * CAR.wheel_x_m))
    flown = nominal_gains().drive.max_speed ** 2 / (GRAVITY_M_S2 * CAR.wheel_radius_m)
    assert flown > 1
    cells = [clearance_m, clearance_m, astride, clearance_m / flown]
    assert f"| {what} | " + " | ".join(map(_mm, cells)) + " |" in PAGE


def test_the_most_tiles_are_those_of_the_page():
    assert f"at most {MOST_TILES:,} of them" in PAGE


def test_other_clearances():
    raised = BOARD_M + CAR.board_travel_m
    for phrase, figure in (
        ("| chassis above the floor | {} |", CAR.wheel_radius_m + CAR.chassis_bottom_m),
        ("clear of the floor by {} (block)", raised - BLOCK.underside_m),
        ("(block) and {} (slope)", raised - SLOPE.underside_m),
        ("a pocket that is off by up to {}.", (BLOCK.pocket_side_m - CAR.boss_top_side_m) / 2),
    ):
        assert phrase.format(_mm(figure)) in PAGE, phrase
    assert f"from {math.sqrt(GRAVITY_M_S2 * CAR.wheel_radius_m):.2f} m/s on" in PAGE


def test_what_holds_a_car_on_a_diagonal_of_its_wheels_on_an_incline():
    incline_rad, x, y = NOMINAL.slope.incline_rad, CAR.wheel_x_m, CAR.wheel_y_m
    along = math.sin(incline_rad) / math.sqrt(2)
    carried = along / CAR.roller_friction
    aside_m = 2 * x * y / math.hypot(x, y)
    for phrase, figure in (
        ("incline of {:.0f} degrees", math.degrees(incline_rad)),
        ("sqrt(2) = {:.2f} W", along),
        ("must carry {:.2f} W", carried),
        ("they are {:.0f} mm from the first diagonal", 1e3 * aside_m),
        ("centre of gravity is {:.0f} mm beside it", 1e3 * carried * aside_m),
    ):
        assert phrase.format(figure) in PAGE, phrase
