"""Margins: a search finds what all trials stand and says truly how sure that is; every figure can grow."""

import json
import shutil
from dataclasses import fields, is_dataclass

import numpy as np
import pytest
from scipy.stats import binom

from craftsim import cli
from craftsim.audit.imperfections import imperfections, imperfections_of
from craftsim.audit.margins import (
    BASE,
    CHOSEN,
    PASSING_SHARE,
    RANKS,
    TRIALS_PER_LEVEL,
    MarginSearch,
    confidence,
    find_margin,
    scenarios,
    search,
)
from craftsim.checking.setup import setup_of
from craftsim.models.randomization import NONE

LEVELS = 40
BETWEEN = "move a block sideways between blocks"
"""A scenario that does not bear all biases of positions."""
NOMINAL = setup_of("none", drive="wheels")


@pytest.mark.parametrize("scenario", CHOSEN, ids=lambda one: one.name)
def test_every_scenario_is_legal_and_stood_without_imperfections(scenario):
    attempts, reason = MarginSearch(scenario, NOMINAL, 3, (), 1).attempt(0)
    assert attempts
    assert reason == ""


def test_a_margin_is_stood_and_the_level_next_to_it_is_not():
    (axis,) = imperfections_of(["position-bias"])
    one = MarginSearch(scenarios(BETWEEN)[0], NOMINAL, 0, (axis,), 7)
    found = find_margin(one).extra
    assert found["end"] == "edge"
    assert all(not one.attempt(number, [(axis, found["margin"])])[1] for number in range(7))
    assert one.attempt(found["trial"], [(axis, found["fails_at"])])[1] == found["reason"]


def test_an_imperfection_that_changes_nothing_has_no_effect():
    axes = imperfections_of(["hinge-bias"])
    found = find_margin(MarginSearch(scenarios("move unloaded")[0], NOMINAL, 0, axes, 7)).extra
    assert (found["end"], found["tried"]) == ("no effect", 6)


@pytest.fixture(scope="module")
def searched(tmp_path_factory, rendered_drawings):
    out = tmp_path_factory.mktemp("margins")
    words = ["audit", "margins", "--situations", BETWEEN, "--trials", "1", "--seed", "1"]
    words += ["--map", "position-bias", "mass", "--out", str(out)]
    assert cli.main([*words, "--workers", "2"]) == 0
    return out, words


def test_a_report_holds_margins_maps_and_bundles_that_replay(searched, capsys):
    out, _ = searched
    figures = json.loads((out / "report.json").read_text())["figures"]["margins"]
    bias, _ = figures["scenarios"]
    assert 0 < bias["margin"] < bias["fails_at"] == bias["upper"]
    (one,) = figures["maps"]
    assert [len(values) for values in one["values"]] == [len(one["stood"][0]), len(one["stood"])]
    # Along its edge a map shows what the search found.
    assert one["stood"][0] == [int(value <= bias["margin"]) for value in one["values"][0]]
    assert cli.main(["replay", str(out / bias["bundle"]), "--out", str(out / "again")]) == 0
    page = (out / "report.html").read_text()
    assert "position bias, mm" in page
    assert bias["reason"] in page


def test_a_finished_search_is_compared_with_an_earlier_one(searched, tmp_path, capsys):
    out, words = searched
    (shutil.copytree(out, tmp_path / "later") / "report.json").unlink()
    assert cli.main([*words[:-1], str(tmp_path / "later"), "--resume", "--baseline", str(out)]) == 0
    figures = json.loads((tmp_path / "later" / "report.json").read_text())["figures"]["margins"]
    assert all(one["before"]["margin"] == one["margin"] for one in figures["scenarios"])


def test_wrong_input_is_named(tmp_path, capsys):
    for words, message in {
        "lipage": "no imperfection 'lipage'; did you mean 'lippage'",
        "--situations fly*": "no scenario matches 'fly*'",
        "--map delay delay": "two different imperfections",
    }.items():
        assert cli.main(["audit", "margins", *words.split(), "--out", str(tmp_path)]) == 2
        assert message in capsys.readouterr().err


def _stands(critical):
    return lambda trial, level: level <= critical[trial]


def test_the_margin_is_what_the_weakest_trial_stands():
    critical = np.random.default_rng(1).integers(5, 60, TRIALS_PER_LEVEL)
    margin, upper, (trial, level) = search(_stands(critical), LEVELS, TRIALS_PER_LEVEL)
    assert margin == critical[trial] == min(critical)
    assert upper == sorted(critical[:16])[2] + 1
    assert level == margin + 1


def test_what_all_stand_has_no_edge_and_a_base_that_is_not_stood_ends_the_search():
    assert search(_stands([LEVELS] * 20), LEVELS, 20) == (LEVELS, None, None)
    assert search(_stands([7] * 19 + [-1]), LEVELS, 20) == (None, None, (19, BASE))


def test_at_the_margin_every_trial_stands_even_where_higher_levels_are_stood_and_lower_ones_not():
    """Trial 0 fails at levels 3 to 6 alone; another one leads the search down to level 6."""
    critical = [LEVELS, 6, *[LEVELS] * 5]

    def stands(trial, level):
        return not 3 <= level <= 6 if trial == 0 else level <= critical[trial]

    margin, _, edge = search(stands, LEVELS, 7)
    assert all(stands(trial, margin) for trial in range(7))
    assert not stands(*edge)


def test_59_trials_make_95_percent_of_95_percent_and_the_upper_end_is_one_by_the_binomial_distribution():
    """Were at most 5 % of all worlds to fail, so many of the first trials would with 5 % probability at most."""
    assert confidence(TRIALS_PER_LEVEL) >= 0.95 > confidence(TRIALS_PER_LEVEL - 1)
    for first, rank in RANKS:
        assert binom.sf(rank - 1, first, 1 - PASSING_SHARE) <= 0.05 + 1e-12


def test_margins_of_drawn_worlds_are_stood_by_95_percent_as_often_as_claimed():
    rng, held = np.random.default_rng(3), []
    for _ in range(100):
        critical = np.floor(rng.normal(20, 4, TRIALS_PER_LEVEL)).astype(int)
        margin, above, _ = search(_stands(critical), LEVELS, TRIALS_PER_LEVEL)
        lower = np.mean(np.floor(rng.normal(20, 4, 2000)) >= margin) >= 0.94
        upper = above is None or np.mean(np.floor(rng.normal(20, 4, 2000)) < above) >= 0.04
        held.append((lower, upper))
    assert np.all(np.mean(held, axis=0) >= 0.93)


def _numbers(part, prefix=""):
    for field in fields(part):
        name, value = f"{prefix}{field.name}", getattr(part, field.name)
        yield from _numbers(value, f"{name}.") if is_dataclass(value) else [(name, value)]


def test_every_figure_is_an_axis_or_says_how_another_one_looks():
    figures = [name for name, _ in _numbers(NONE)]
    missing = set(figures) - {axis.figure for axis in imperfections().values()}
    assert missing == {"floor.tile_m", "floor.wavelength_m", "sensors.min_delay_s"}
    assert len(imperfections()) == len(figures) - len(missing)


def test_an_axis_changes_its_figure_and_those_that_go_with_it_alone():
    before = dict(_numbers(NONE))
    for axis in imperfections().values():
        mine = {axis.figure, *(name for name, _ in axis.also)}
        assert list(axis.levels) == sorted(set(axis.levels))
        assert len(axis.levels) == 41
        for value in (axis.levels[0], axis.levels[-1]):
            after = dict(_numbers(axis.on(NONE, value)))
            assert after[axis.figure] == value
            assert {name for name in before if before[name] != after[name]} <= mine
