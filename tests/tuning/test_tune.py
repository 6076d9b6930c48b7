"""Tuning finds the best, never writes what is worse, and comes to the same end whoever does the work and when."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import yaml
from tuning.analytic import BEST, opener, values_of
from validation.campaign.sessions import cut_off

from craftsim.checking.setup import setup_of
from craftsim.cli import main
from craftsim.errors import InputError
from craftsim.experiments.experiment import RunOptions
from craftsim.reports.html import write_html
from craftsim.skills.gains import SECTIONS, load_gains
from craftsim.tuning import tune as module
from craftsim.tuning.goal import TuningGoal
from craftsim.tuning.tunable import situations
from craftsim.tuning.tune import FINAL_BLOCKS, HELD_OUT_BLOCKS
from craftsim.tuning.tune_report import convergence, tune_report, write_gains


def _tune(monkeypatch, folder, goal=None, lose=lambda job: False, evaluations=120, other=None):
    made = []
    monkeypatch.setattr(module, "open_session", opener(made, lose, other))
    setup, goal = setup_of("mild", drive="wheels"), goal or TuningGoal.of(["time"])
    options = {"evaluations": evaluations, "trials": 2, "seed": 4, "options": RunOptions()}
    return module.tune("board", setup, folder, goal=goal, **options), made[0]


def test_it_finds_the_best_gains_with_seeds_of_search_finals_and_verdict_apart(
    monkeypatch, tmp_path
):
    tuned, rounds = _tune(monkeypatch, tmp_path)
    assert tuned.verdict.improved
    for gain in tuned.tunable:
        assert gain.of(tuned.gains) == pytest.approx(BEST[gain.name], rel=0.05)
    assert tuned.verdict.against_shipped.factor < 0.95
    # In this world each block takes longer than the one before, which a control arm shows.
    assert 1 < tuned.verdict.control.low < tuned.verdict.control.high < 1.01
    found = convergence(tuned)
    assert found[0] == 1
    assert found == sorted(found, reverse=True)
    blocks = {}
    for number, job in rounds.jobs.items():
        key = rounds.items[number].key
        if isinstance(job, module.PlanJob):
            continue
        phase = (
            "finalist"
            if key.startswith("finalist")
            else "held out"
            if "held out" in key
            else "search"
        )
        blocks.setdefault(phase, set()).update(job[-1])
    assert len(blocks["finalist"]) == FINAL_BLOCKS
    assert len(blocks["held out"]) == HELD_OUT_BLOCKS
    assert sum(map(len, blocks.values())) == len(set().union(*blocks.values()))


def test_what_fails_on_seeds_held_out_is_never_written(monkeypatch, tmp_path):
    start = load_gains()

    def lose(job):
        if isinstance(job, module.PlanJob):
            return False
        return min(job[-1]) >= 2 + FINAL_BLOCKS and values_of(job)["board.gain"] != start.board.gain

    tuned, _ = _tune(monkeypatch, tmp_path, lose=lose)
    assert not tuned.verdict.improved
    assert tuned.gains == start
    path = write_gains(tmp_path, tuned, "craftsim tune board")
    assert load_gains(path) == start
    assert "Nothing better than the start was found" in path.read_text(encoding="utf-8")


def test_a_front_has_no_finalist_that_another_dominates_and_is_chosen_from(monkeypatch, tmp_path):
    chosen = {}
    for choice in ("time", "margin", "knee"):
        tuned, _ = _tune(monkeypatch, tmp_path, TuningGoal.of((), ["time", "margin"], choice))
        values = [(score.values["time"], score.values["margin"]) for _, score in tuned.finalists]
        assert not [a for a in values for b in values if a != b and a[0] >= b[0] and a[1] >= b[1]]
        chosen[choice] = values[0]
        assert values[0] == (min(values) if choice == "time" else values[0])
    assert chosen["time"][0] < chosen["knee"][0] < chosen["margin"][0]
    assert chosen["time"][1] > chosen["knee"][1] > chosen["margin"][1]


def test_the_file_says_where_it_comes_from_and_can_be_read_by_gains(monkeypatch, tmp_path):
    tuned, _ = _tune(monkeypatch, tmp_path)
    path = write_gains(tmp_path, tuned, "craftsim tune board\n--out 'x'")
    text = path.read_text(encoding="utf-8")
    assert load_gains(path) == tuned.gains
    assert yaml.safe_load(text).keys() == SECTIONS.keys()
    for part in (
        "seed 4",
        'Command: "craftsim tune board\\n',
        "mujoco",
        "before and after",
        "Start:",
    ):
        assert part in text


def test_a_change_whose_interval_holds_none_is_not_called_better_and_each_failure_is_named(
    monkeypatch, tmp_path
):
    def lose(job):
        if isinstance(job, module.PlanJob):
            return False
        return min(job[-1]) == 2 + FINAL_BLOCKS

    tuned, _ = _tune(monkeypatch, tmp_path, lose=lose)
    ratio = replace(tuned.verdict.against_start, low=0.44, high=1.43, factor=0.69)
    tuned.verdict = replace(tuned.verdict, against_start=ratio, improved=True)
    report = tune_report(tuned, tmp_path / "gains.yaml", "craftsim tune board", 1)
    assert report.headline.badge == "Not shown to be better"
    assert "-31.0 %, 95 % interval -56.0 to +43.0 %" in report.headline.sentence
    assert "least detectable change is -56.9 %" in report.headline.sentence
    assert {name for name, _ in tuned.failures} == {"before", "after", "shipped"}
    page = write_html(tmp_path, report).read_text(encoding="utf-8")
    assert f"Failures: {len(tuned.failures)}" in page
    assert str(situations("board")[0]).partition("/")[0] in page


def test_the_page_holds_all_drawings_and_says_why_gains_are_kept(monkeypatch, tmp_path):
    tuned, _ = _tune(monkeypatch, tmp_path, TuningGoal.of((), ["time", "energy"]), evaluations=40)
    report = tune_report(tuned, tmp_path / "gains.yaml", "craftsim tune board", 1)
    text = write_html(tmp_path, report).read_text(encoding="utf-8")
    assert text.count("<svg role") == 3
    assert "drive.position_tolerance" in text
    assert "the front of time, energy" in text


def test_the_coordinate_search_finds_what_the_sensitivities_would_show(monkeypatch, tmp_path):
    """With hardly a generation of the other search, no gain turned by a tenth does much better than the result."""
    monkeypatch.setattr(module, "COORDINATE_SHARE", 0.8)
    monkeypatch.setattr(module, "COORDINATE_ROUNDS", 10)
    tuned, _ = _tune(monkeypatch, tmp_path, evaluations=50)
    assert tuned.n_coordinate == 40
    before = min(
        score.log_cost(tuned.goal.weights) for _, score in tuned.searched[: -tuned.n_coordinate]
    )
    after = min(
        score.log_cost(tuned.goal.weights) for _, score in tuned.searched[-tuned.n_coordinate :]
    )
    assert after < before
    assert min(factor for factors in tuned.sensitivity.values() for factor in factors) > 0.96


def test_a_finalist_that_breaks_a_plan_is_refused_and_the_next_one_is_taken(monkeypatch, tmp_path):
    broken = []

    def lose(job):
        if not isinstance(job, module.PlanJob) or job.plan != "strip":
            return False
        values = tuple(values_of(job).values())
        first = not broken and job.setup.gains != load_gains()
        if first:
            broken.append(values)
        return values in broken

    tuned, _ = _tune(monkeypatch, tmp_path, lose=lose)
    start, first, second, _ = tuned.plans
    assert start.failed == ()
    assert first.failed == ("strip",)
    assert second.failed == ()
    assert tuned.refused == [first]
    assert tuned.verdict.improved
    assert {gain.name: gain.of(tuned.gains) for gain in tuned.tunable} == second.values


def test_where_every_finalist_breaks_a_plan_the_start_stays_and_the_report_says_so(
    monkeypatch, tmp_path
):
    start = load_gains()

    def lose(job):
        return isinstance(job, module.PlanJob) and job.setup.gains.board != start.board

    tuned, _ = _tune(monkeypatch, tmp_path, lose=lose)
    assert not tuned.verdict.improved
    assert tuned.gains == start
    report = tune_report(tuned, tmp_path / "gains.yaml", "craftsim tune board", 1)
    assert report.headline.badge == "Not better"
    assert "3 finalists failed in whole plans" in report.headline.sentence
    text = write_html(tmp_path, report).read_text(encoding="utf-8")
    assert "0 of 6" in text


def test_what_will_be_tried_is_said_before_and_too_few_candidates_are_warned_of():
    setup = setup_of("mild", drive="wheels")
    few = module.Tuning("drive", setup, TuningGoal.of(), 40, 2, 0)
    outlook, warning = few.outlook()
    n_gains = len(few.tunable)
    assert outlook.startswith(f"{n_gains} gains; {few.n_search} candidates")
    assert f"{len(few.items())} evaluations in all" in outlook
    assert f"needs about {20 * n_gains} candidates" in warning
    assert len(module.Tuning("drive", setup, TuningGoal.of(), 20 * n_gains, 2, 0).outlook()) == 1
    assert few.n_search <= 1.3 * 40
    assert few.n_coordinate == 20


ARGUMENTS = [
    "tune",
    "board",
    "--evaluations",
    "6",
    "--trials",
    "1",
    "--seed",
    "3",
    "--drive",
    "wheels",
]


def test_a_tuning_that_was_cut_off_goes_on_and_ends_as_one_of_two_workers_does(
    tmp_path, monkeypatch
):
    for name, few in (
        ("FINALISTS", 2),
        ("FINAL_BLOCKS", 1),
        ("HELD_OUT_BLOCKS", 4),
        ("PLANS", ("block",)),
    ):
        monkeypatch.setattr(module, name, few)
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    assert main([*ARGUMENTS, "--workers", "2", "--out", str(whole)]) in (0, 1)
    shutil.copytree(whole, cut)
    cut_off(cut, range(14))
    assert main([*ARGUMENTS, "--resume", "--out", str(cut)]) in (0, 1)
    for name in ("trials.jsonl", "gains.yaml", "report.html"):
        assert (whole / name).read_bytes() == (cut / name).read_bytes(), name
    reports = [json.loads((folder / "report.json").read_bytes()) for folder in (whole, cut)]
    assert all(report.pop("wall") for report in reports)
    assert reports[0] == reports[1]


def test_evaluations_of_other_gains_are_not_taken_for_those_of_the_search(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="tried other gains than it would now"):
        _tune(monkeypatch, tmp_path, other={"board.gain": 3.0}, evaluations=10)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["drive", "--weights", "tme=1"], "unknown objective 'tme'; did you mean 'time'?"),
        (["drive", "--gains", "fsat"], "unknown gains 'fsat'; did you mean 'fast'?"),
        (["drive", "--evaluations", "0"], "--evaluations is 0; allowed: 1 to 1000000"),
    ],
)
def test_wrong_options_end_with_status_2_before_anything_is_tried(tmp_path, capsys, words, message):
    assert main(["tune", *words, "--out", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_candidates_depend_on_the_generator_alone_and_stay_within_bounds():
    def asked(seed):
        search, found = (
            module.cma_es(
                [(-1.0, 1.0), (-1.0, 0.0)], [0.0, 0.0], 0.25, np.random.default_rng(seed)
            ),
            [],
        )
        for _ in range(6):
            positions = search.ask()
            found += [x.copy() for x in positions]
            search.tell(positions, [float((x**2).sum()) for x in positions])
        assert len(found) == 6 * module.population(2)
        return np.array(found)

    first = asked(5)
    assert ((first >= -1) & (first <= [1, 0])).all()
    np.random.seed(3)  # noqa: NPY002
    state = np.random.get_state()[1].copy()  # noqa: NPY002
    assert (asked(5) == first).all()
    assert (np.random.get_state()[1] == state).all()  # noqa: NPY002
    assert (asked(6) != first).any()


def test_without_its_library_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setattr("craftsim.storage.extras.find_spec", lambda name: None)
    with pytest.raises(
        InputError, match=r"tuning needs cma, not installed here; .*-m pip install 'cma>="
    ):
        module.need_cma()
