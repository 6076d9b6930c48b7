"""Margins in physics: the scenarios exist, a margin is stood and the level next to it is not, whoever searches."""

import json
import shutil

import pytest

from craftsim import cli
from craftsim.checking.setup import setup_of
from craftsim.validation.margins.axes import axes_of
from craftsim.validation.margins.finding import MarginSearch, find
from craftsim.validation.margins.scenarios import CHOSEN, scenarios
from craftsim.validation.margins.trial import Rig

BASE = setup_of("none", drive="reduced")


@pytest.mark.parametrize("scenario", CHOSEN, ids=lambda one: one.name)
def test_every_scenario_is_legal_and_stood_without_imperfections(scenario):
    result = Rig(scenario, BASE, 3).attempt(0)
    assert result.attempts
    assert result.reason == ""


def test_names_of_scenarios_are_their_own():
    assert len({one.name for one in CHOSEN}) == len({one.row for one in CHOSEN}) == len(CHOSEN)
    assert {one.action for one in scenarios(quick=True)} == {one.action for one in CHOSEN}


def test_a_margin_is_stood_and_the_level_next_to_it_is_not():
    rig, (axis,) = Rig(scenarios("lift a block")[0], BASE, 0), axes_of(["position-bias"])
    found = find(MarginSearch(rig, axis, 7)).extra
    assert found["end"] == "edge"
    assert all(not rig.attempt(number, [(axis, found["margin"])]).reason for number in range(7))
    assert rig.attempt(found["trial"], [(axis, found["fails_at"])]).reason == found["reason"]


def test_an_imperfection_that_changes_nothing_has_no_effect():
    rig = Rig(scenarios("move unloaded")[0], BASE, 0)
    found = find(MarginSearch(rig, axes_of(["hinge-bias"])[0], 7)).extra
    assert (found["end"], found["tried"]) == ("no effect", 6)


@pytest.fixture(scope="module")
def searched(tmp_path_factory):
    out = tmp_path_factory.mktemp("margins")
    words = [
        "margins",
        "--situations",
        "lift a block",
        "--trials",
        "1",
        "--seed",
        "2",
        "--map",
        "position-bias",
        "mass",
    ]
    words += ["--out", str(out)]
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


def test_a_search_finds_the_same_in_any_process(searched):
    out, _ = searched
    first = json.loads((out / "trials.jsonl").read_text().splitlines()[0])
    (axis,) = axes_of(["position-bias"])
    assert find(MarginSearch(Rig(scenarios("lift a block")[0], BASE, 2), axis, 1)).extra == first["extra"]


def test_a_finished_search_is_compared_with_an_earlier_one(searched, tmp_path, capsys):
    out, words = searched
    (shutil.copytree(out, tmp_path / "later") / "report.json").unlink()
    assert cli.main([*words[:-1], str(tmp_path / "later"), "--resume", "--baseline", str(out)]) == 0
    figures = json.loads((tmp_path / "later" / "report.json").read_text())["figures"]["margins"]
    assert all(one["before"]["margin"] == one["margin"] for one in figures["scenarios"])


def test_wrong_input_is_named(tmp_path, capsys):
    assert cli.main(["margins", "--axes", "lipage", "--out", str(tmp_path)]) == 2
    assert "did you mean 'lippage'" in capsys.readouterr().err
    assert cli.main(["margins", "--situations", "fly*", "--out", str(tmp_path)]) == 2
    assert "no scenario matches 'fly*'" in capsys.readouterr().err
    assert cli.main(["margins", "--map", "delay", "delay", "--out", str(tmp_path)]) == 2
    assert "two different imperfections" in capsys.readouterr().err
