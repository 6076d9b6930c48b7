"""The comparison of speed with CraftEnv, which is estimated from a calibration."""

from types import SimpleNamespace

import calibration
import pytest
import reference
from reference import compare

from craftsim.cli import bench


@pytest.mark.parametrize("unit_s", [0.0005, 0.003])
def test_a_ratio_to_the_reference_does_not_depend_on_how_fast_the_machine_is(monkeypatch, unit_s):
    """Both sides slow down together: work of the reference's own kind has one ratio, however long a unit takes."""
    clock = SimpleNamespace(now_s=0.0, process_time=lambda: clock.now_s)

    def unit(seed=0):
        clock.now_s += unit_s

    def slowed(times):
        return lambda: [unit(seed) for seed in range(times)] and None

    monkeypatch.setattr(bench, "time", clock)
    one = compare(slowed(1), 1, unit, 2.0, 0.3)
    assert one["per_unit"] == pytest.approx(1.0)
    assert one["times"] == pytest.approx(1 / 2.0)
    two = compare(slowed(2), 1, unit, 2.0, 0.3)
    assert two["per_unit"] == pytest.approx(0.5)


def test_the_calibration_does_the_same_work_each_time():
    assert calibration.unit(3) == calibration.unit(3) > 0


@pytest.mark.parametrize("subject", ["rules", "env"])
def test_each_case_is_compared_with_the_estimate_of_its_kind(subject):
    rates = reference.rates_of(subject, "simple_two_story", 0.02, None, worlds=20)
    with_helper = calibration.REFERENCE_PER_UNIT["simple_two_story"]
    alone = with_helper * calibration.PRIMITIVE_TIMES_HELPER["simple_two_story"]
    for name, rate in rates.items():
        assert rate["times"] == pytest.approx(rate["steps_a_second"] / rate["reference_a_second"])
        per_unit = alone if name.startswith("primitive") else with_helper
        assert rate["reference_a_second"] == pytest.approx(rate["units_a_second"] * per_unit)


def test_a_folder_without_craftenv_is_refused(tmp_path):
    with pytest.raises(SystemExit, match="is no checkout of CraftEnv"):
        reference.reference_play(tmp_path, "simple_two_story")
