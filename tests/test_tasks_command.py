"""``craftsim tasks`` and ``craftsim episodes``: their reports, their exit status, and what they refuse."""

import json

import pytest
from craftsim.validation.jobs import episodes as episodes_module
from craftsim.validation.jobs import trials as job_trials

from craftsim import cli
from craftsim.commands import tasks as tasks_module
from craftsim.validation.campaign import local
from craftsim.validation.campaign.items import perform


@pytest.fixture(autouse=True)
def _a_screen_of_80_columns(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")


@pytest.fixture
def here(monkeypatch):
    """Let the work be done in this process, so that what is patched here is what is done."""

    class Here:
        def __init__(self, work):
            self.work = work

        def run(self, items, timeout_s):
            return perform(self.work, [item.job for item in items])

        def close(self):
            pass

    monkeypatch.setattr(local, "LocalWorker", Here)


def _report(out):
    return json.loads((out / "report.json").read_text(encoding="utf-8"))


def test_tasks_builds_a_task_and_writes_its_figures(tmp_path, capsys):
    words = ["tasks", "--task", "strip", "--seeds", "1", "--seed", "5", "--out", str(tmp_path)]
    assert cli.main(words) == 0
    report = _report(tmp_path)
    assert report["command"] == "tasks"
    assert report["seed"] == 5
    assert report["config"]["noise"] is True
    assert report["config"]["tasks"] == ["strip"]
    assert set(report["wall"]) == {"total_s", "workers", "engine"}
    strip = report["figures"]["tasks"]["strip"]
    assert set(strip) == {
        "built",
        "without_failure",
        "seeds",
        "max_car_error_mm",
        "max_heading_error_mrad",
        "max_placed_error_mm",
        "sequential_s",
        "concurrent_s",
        "makespan_ratio",
        "nominal_built",
    }
    assert (strip["built"], strip["without_failure"], strip["seeds"]) == (1, 1, 1)
    assert strip["nominal_built"] is True
    assert strip["makespan_ratio"] == pytest.approx(strip["concurrent_s"] / strip["sequential_s"])
    assert strip["makespan_ratio"] < 1.0
    (record,) = report["figures"]["records"]
    assert record["trial"] == {"task": "strip", "seed": 5, "order": "concurrent", "noise": True}
    assert 1e3 * record["car_error_m"] == pytest.approx(strip["max_car_error_mm"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "3 of 3 buildings reached their goal."
    assert max(len(line) for line in lines if "Report:" not in line) <= 80


def test_a_building_that_misses_its_goal_is_explained_and_ends_with_status_1(
    tmp_path, capsys, monkeypatch, here
):
    def broken(trial):
        return job_trials.JobRecord(trial, False, False, 2.0, 0.0, 0.0, 0.0, ("car 0 LIFT: load lost",))

    monkeypatch.setattr(job_trials, "run_job_trial", broken)
    assert cli.main(["tasks", "--task", "block", "--seeds", "1", "--out", str(tmp_path)]) == 1
    output = capsys.readouterr().out
    assert "block/0: car 0 LIFT: load lost" in output
    assert output.splitlines()[-1] == "0 of 3 buildings reached their goal."
    assert _report(tmp_path)["figures"]["tasks"]["block"]["built"] == 0


def test_a_building_without_an_end_is_an_error_and_none_that_was_built(tmp_path, capsys, monkeypatch, here):
    def raising(trial):
        if trial.order == "sequential":
            raise RuntimeError("out of bolts")
        return job_trials.JobRecord(trial, True, True, 2.0, 0.001, 0.0, 0.0, ())

    monkeypatch.setattr(job_trials, "run_job_trial", raising)
    assert cli.main(["tasks", "--task", "block", "--seeds", "1", "--out", str(tmp_path)]) == 1
    output = capsys.readouterr().out
    assert "block/nominal/sequential: RuntimeError: out of bolts" in output
    assert output.splitlines()[-1] == "2 of 3 buildings reached their goal."
    figures = _report(tmp_path)["figures"]
    assert figures["errors"] == {"RuntimeError: out of bolts": 1}
    block = figures["tasks"]["block"]
    assert (block["built"], block["nominal_built"], block["max_car_error_mm"]) == (1, False, 1.0)
    assert (block["sequential_s"], block["concurrent_s"], block["makespan_ratio"]) == (None, 2.0, None)


def test_all_means_the_six_tasks_of_the_paper(tmp_path, monkeypatch, here):
    asked = []

    def instant(trial):
        asked.append((trial.task, trial.order, trial.noise, trial.seed))
        return job_trials.JobRecord(trial, True, True, 2.0, 0.0, 0.0, 0.0, ())

    monkeypatch.setattr(job_trials, "run_job_trial", instant)
    assert cli.main(["tasks", "--seeds", "2", "--seed", "3", "--out", str(tmp_path)]) == 0
    from craftsim.discrete.tasks import TASK_NAMES

    assert set(_report(tmp_path)["figures"]["tasks"]) == set(TASK_NAMES)
    for name in TASK_NAMES:
        assert sorted(entry[1:] for entry in asked if entry[0] == name) == [
            ("concurrent", False, 3),
            ("concurrent", True, 3),
            ("concurrent", True, 4),
            ("sequential", False, 3),
        ]
    assert tasks_module.get_args(tasks_module.Task) == tuple(TASK_NAMES)


def test_episodes_writes_its_figures_equal_at_one_and_two_workers(tmp_path, capsys):
    words = ["episodes", "--episodes", "2", "--actions", "4", "--cars", "2", "--seed", "2"]
    assert cli.main([*words, "--out", str(tmp_path / "one")]) == 0
    assert cli.main([*words, "--workers", "2", "--out", str(tmp_path / "two")]) == 0
    one, two = _report(tmp_path / "one"), _report(tmp_path / "two")
    assert {key: one[key] for key in one if key != "wall"} == {key: two[key] for key in two if key != "wall"}
    assert one["command"] == "episodes"
    assert one["seed"] == 2
    assert set(one["figures"]) == {"set_down_mm", "records", "good", "errors"}
    assert one["figures"]["good"] == 2
    assert [record["trial"]["seed"] for record in one["figures"]["records"]] == [2, 3]
    assert set(one["figures"]["records"][0]) == {
        "trial",
        "n_actions",
        "disagreement",
        "early_error_m",
        "error_m",
        "worst_error_m",
        "car_error_m",
        "set_down",
    }
    assert set(one["figures"]["set_down_mm"]) == {"first", "middle", "last"}
    assert "2 of 2 episodes went as predicted to the end." in capsys.readouterr().out


def test_an_episode_that_goes_wrong_is_explained_and_ends_with_status_1(tmp_path, capsys, monkeypatch, here):
    def broken(trial):
        return episodes_module.EpisodeRecord(
            trial, 7, ("it fell",), 0.0, 0.0, 0.0, 0.0, ((4, 0.0003), (7, 0.0005))
        )

    monkeypatch.setattr(episodes_module, "run_episode", broken)
    assert cli.main(["episodes", "--episodes", "1", "--out", str(tmp_path)]) == 1
    output = capsys.readouterr().out
    assert "it fell" in output
    assert "first third: 2 things, median 0.40 mm, worst 0.50 mm" in " ".join(output.split())
    assert output.splitlines()[-1] == "0 of 1 episodes went as predicted to the end."


def test_an_episode_without_an_end_is_no_good_one_and_is_tried_again(tmp_path, capsys, monkeypatch, here):
    def raising(trial):
        if trial.seed == 1:
            raise RuntimeError("lost")
        return episodes_module.EpisodeRecord(trial, 7, (), 0.0, 0.0, 0.0, 0.0, ())

    words = ["episodes", "--episodes", "3", "--out", str(tmp_path)]
    with monkeypatch.context() as patched:
        patched.setattr(episodes_module, "run_episode", raising)
        assert cli.main(words) == 1
    output = capsys.readouterr().out
    assert "RuntimeError: lost" in output
    assert output.splitlines()[-1] == "2 of 3 episodes went as predicted to the end."
    figures = _report(tmp_path)["figures"]
    assert [record["trial"]["seed"] for record in figures["records"]] == [0, 2]
    assert (figures["good"], figures["errors"]) == (2, {"RuntimeError: lost": 1})
    done = []
    good = episodes_module.EpisodeRecord(episodes_module.EpisodeTrial(1), 7, (), 0.0, 0.0, 0.0, 0.0, ())
    monkeypatch.setattr(episodes_module, "run_episode", lambda trial: done.append(trial.seed) or good)
    assert cli.main([*words, "--resume"]) == 0
    assert done == [1]
    assert _report(tmp_path)["figures"]["good"] == 3


@pytest.mark.parametrize(
    "words",
    [
        ["tasks", "--seeds", "-1"],
        ["tasks", "--workers", "0"],
        ["tasks", "--task", "castle"],
        ["tasks", "--seeds", "many"],
        ["episodes", "--episodes", "0"],
        ["episodes", "--actions", "0"],
        ["episodes", "--cars", "0"],
        ["episodes", "--cars", "9"],
        ["episodes", "--workers", "0"],
    ],
    ids=" ".join,
)
def test_bad_arguments_end_with_status_2_and_write_nothing(words, tmp_path, capsys):
    out = tmp_path / "out"
    try:
        status = cli.main([*words, "--out", str(out)])
    except SystemExit as exit_:
        status = exit_.code
    assert status == 2
    assert not out.exists()
    assert words[1].removeprefix("--") in "".join(capsys.readouterr())
