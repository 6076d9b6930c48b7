"""The tables of docs/training.md are those of the studies whose reports lie beside it."""

import json
from pathlib import Path

import pytest

from craftsim.studies.report import conclusions, runs_table
from craftsim.studies.study import read_study

DOCS = Path(__file__).parents[2] / "docs"
STUDIES = ("paper_ippo", "paper", "random", "random_complex", "designs")
PHYSICS = sorted(path.stem for path in (DOCS / "training").glob("physics_*.json"))
EVALUATIONS = ("designs_greedy", "designs_cars3", "designs_cars4", "designs_zero")


@pytest.mark.parametrize("name", STUDIES)
def test_the_page_has_what_the_stored_report_holds(name):
    report = json.loads((DOCS / f"training/{name}.json").read_text(encoding="utf-8"))
    page = (DOCS / "training.md").read_text(encoding="utf-8")
    table = runs_table(read_study(name), report["figures"]).as_markdown()
    for line in table.splitlines()[2:]:
        assert line in page
    for line in conclusions(report["figures"]):
        assert line in page or line.startswith("A run of")


@pytest.mark.parametrize("name", STUDIES)
def test_the_stored_report_is_of_the_shipped_study(name):
    report = json.loads((DOCS / f"training/{name}.json").read_text(encoding="utf-8"))
    study, asked = read_study(name), report["config"]["study"]
    assert (asked["tasks"], asked["seeds"], asked["steps"]) == ([*study.tasks], study.seeds, study.steps)
    assert [run["key"] for run in report["figures"]["runs"]] == [run.key for run in study.runs]


def _cpu_s(name):
    report = json.loads((DOCS / f"training/{name}.json").read_text(encoding="utf-8"))
    steps = {run["key"]: run["steps"] for run in report["figures"]["runs"]}
    return {key: (steps[key], found) for key, found in report["wall"]["cpu_s"].items() if found is not None}


@pytest.mark.parametrize("name", STUDIES)
def test_no_time_is_that_of_a_call_that_had_nothing_left_to_train(name):
    """The fastest runs learn 8,000 steps a second."""
    for key, (steps, cpu_s) in _cpu_s(name).items():
        assert cpu_s > steps / 20_000, key


@pytest.mark.parametrize(
    ("name", "task", "says", "unit_s"),
    [
        ("paper_ippo", "", "A run takes {} to {} s of CPU time", 1),
        ("paper_ippo", "complex_two_story", "and {} to {} s on complex two-story", 1),
        ("random", "", "A run takes {} to {} minutes of CPU time", 60),
        ("random_complex", "", "One takes {} to {} minutes of CPU time, planning included", 60),
        ("designs", "", "One takes {} to {} minutes of CPU time:", 60),
    ],
)
def test_the_page_has_the_times_of_the_stored_report(name, task, says, unit_s):
    page = (DOCS / "training.md").read_text(encoding="utf-8")
    times = [
        cpu_s
        for key, (_, cpu_s) in _cpu_s(name).items()
        if key.startswith(task) and (task or not key.startswith("complex_two_story"))
    ]
    assert says.format(round(min(times) / unit_s), round(max(times) / unit_s)) in page


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_page_has_what_the_mixer_as_it_is_now_came_to(seed):
    report = json.loads((DOCS / f"training/qmix_strip_{seed}.json").read_text(encoding="utf-8"))
    config, found = report["config"], report["figures"]
    assert (config["algo"], config["task"], config["seed"], config["steps"]) == (
        "qmix",
        "strip",
        seed,
        500_000,
    )
    assert (config["explore"], config["rules"], config["helper_depth"]) == (1_000_000, "published", 20)
    line = f"| {seed} | {found['success']['rate']:.3f} | {found['steps'] // 1000} k |"
    assert line in (DOCS / "training.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", EVALUATIONS)
def test_the_page_has_what_each_stored_evaluation_holds(name):
    report = json.loads((DOCS / f"training/{name}.json").read_text(encoding="utf-8"))
    page = (DOCS / "training.md").read_text(encoding="utf-8")
    for row in report["figures"]["evaluations"]:
        found, starts = row["success"], row["starts"]["distinct"]
        interval = f"{found['wilson_low']:.3f}-{found['wilson_high']:.3f}"
        line = f"| {row['acting']} | {found['rate']:.3f} | {interval} | {starts} | {row['mean_ticks']:.1f} |"
        assert any(row["task"] in text and line in text for text in page.splitlines())


@pytest.mark.parametrize("name", PHYSICS)
def test_the_page_has_what_each_stored_validation_holds(name):
    report = json.loads((DOCS / f"training/{name}.json").read_text(encoding="utf-8"))
    page = (DOCS / "training.md").read_text(encoding="utf-8")
    found = report["figures"]["validation"]
    for policy in found["policies"]:
        actions = found["by_group"][policy["policy"]]["actions"]
        built = [f"{round(policy[where] * policy['episodes'])}" for where in ("grid", "physics")]
        good = f"{actions['successes']:,} of {actions['trials']:,}"
        drawn = report["config"]["randomize"]
        line = " | ".join([policy["policy"], drawn, str(policy["episodes"]), *built, good])
        assert f"| {line} |" in page


def test_there_are_stored_validations():
    assert len(PHYSICS) > 5
