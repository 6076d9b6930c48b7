"""A carried slope stays on its board when the car drives onto a ramp, with the step that the reduced drive takes."""

from dataclasses import replace
from pathlib import Path

from craftsim.checking.episode import Recipe, do, start
from craftsim.checking.setup import setup_of
from craftsim.storage import limits
from craftsim.storage.records import read_json_record

BUILDING = Path(__file__).parents[1] / "data" / "carried_slope.json"
"""The first 48 ticks of a building in which, with steps of 5 ms, car 0 and the slope that it carries onto a ramp in the
last tick hit each other with 676 N, where finer steps find 16 N (docs/explanation/drives.md)."""


def test_a_carried_slope_is_not_thrown_off_its_board_at_the_foot_of_a_ramp():
    recipe = read_json_record(BUILDING, Recipe, limits.BUNDLE)
    recipe = replace(recipe, setup=setup_of("mild", drive="reduced"))
    attempts = do(start(recipe), recipe.steps[-1])
    assert any(a.car == 0 and a.tick == 47 and a.load == "fslope" and a.slope for a in attempts)
    assert not [str(attempt) for attempt in attempts if not attempt.agrees]
