"""Every figure of a DomainRandomization is an axis, whatever is added to it."""

from dataclasses import fields, is_dataclass

import pytest

from craftsim.checking.attempt import Thresholds
from craftsim.checking.setup import RANDOMIZE, Setup, imperfect, setup_of
from craftsim.errors import InputError
from craftsim.models.randomization import NONE, DomainRandomization
from craftsim.validation.margins.axes import axes, axes_of


def _numbers(part, prefix=""):
    for field in fields(part):
        value = getattr(part, field.name)
        yield from (
            _numbers(value, f"{prefix}{field.name}.")
            if is_dataclass(value)
            else [(prefix + field.name, value)]
        )


def test_every_figure_is_an_axis_or_says_how_another_one_looks():
    figures = [name for name, _ in _numbers(NONE)]
    missing = set(figures) - {axis.figure for axis in axes().values()}
    assert missing == {"floor.tile_m", "floor.wavelength_m", "sensors.min_delay_s"}
    assert len(axes()) == len(figures) - len(missing)


@pytest.mark.parametrize("axis", axes().values(), ids=lambda axis: axis.name)
def test_an_axis_changes_its_figure_and_those_that_go_with_it_alone(axis):
    mine = {axis.figure, *(name for name, _ in axis.also)}
    assert list(axis.levels) == sorted(set(axis.levels))
    assert len(axis.levels) == 41
    for value in (axis.levels[0], axis.levels[-1]):
        before, after = dict(_numbers(NONE)), dict(_numbers(axis.on(NONE, value)))
        assert after[axis.figure] == value
        assert {name for name in before if before[name] != after[name]} <= mine


def test_values_are_preferred_numbers_with_units():
    (axis,) = axes_of(["position-bias"])
    assert [axis.text(value) for value in axis.levels[:4]] == ["0.2 mm", "0.224 mm", "0.25 mm", "0.28 mm"]
    assert axis.text(axis.levels[-1]) == "20 mm"


def test_an_unknown_axis_is_named_with_a_suggestion():
    with pytest.raises(InputError, match="no imperfection 'lipage'; did you mean 'lippage'"):
        axes_of(["lipage"])


@pytest.mark.parametrize("preset", RANDOMIZE)
def test_limits_widen_for_the_world_alone_and_not_twice(preset):
    """The limits of a setup that is made imperfect are those of one that was so from the beginning."""
    setup = setup_of(preset)
    there, back = imperfect(setup, NONE), imperfect(imperfect(setup, NONE), setup.randomization)
    assert there.thresholds.car_m == pytest.approx(RANDOMIZE[preset][0].car_m)
    assert back.thresholds.height_m == pytest.approx(setup.thresholds.height_m)
    (bias,) = axes_of(["position-bias"])
    biased = imperfect(Setup(), bias.on(DomainRandomization(), 0.006))
    assert biased.thresholds.placed_m == pytest.approx(Thresholds().placed_m + 0.006)
