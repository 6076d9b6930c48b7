"""scripts/paper.py: each run is done once, whatever is killed; the page says of each cell what was done."""

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import paper
import paper_table
import pytest
import released
from paper import Plan, Run

from craftsim.cli.app import bind
from craftsim.learning.config import RELEASED_STEPS, protocol
from craftsim.tasks import make_task
from craftsim.tasks.episodes import Episodes

SCRIPTS = Path(paper.__file__).parent
TRAINING = """
import json, os, sys, time
words = sys.argv[1:]
out = words[words.index("--out") + 1]
os.makedirs(out, exist_ok=True)
steps = os.path.join(out, "steps.txt")
done = len(open(steps).read().split()) if os.path.exists(steps) else 0
for step in range(done, 30):
    with open(steps, "a") as file:
        file.write(f"{step}\\n")
    time.sleep(0.03)
point = {"steps": 30, "successes": 5, "episodes": 20, "mean_return": 3.5}
figures = {"training_versions": {"torch": "2"}, "last_fifth": 0.25, "mean_return": 3.5, "learning_curve": [point]}
with open(os.path.join(out, "part"), "w") as file:
    json.dump({"figures": figures, "wall": {"training_cpu_s": 1.2}}, file)
os.rename(file.name, os.path.join(out, "report.json"))
"""
"""Stands for a training that saves after each step, and goes on from what it has saved."""
FILLING = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv.pop(1))
import paper
training, stored = sys.argv.pop(1), sys.argv.pop(1)
paper.command_of = lambda run, out: [
    sys.executable, "-c", training, "train", run.task, "--algo", run.algo, "--out", str(out)
]
paper.STORED = Path(stored)
sys.exit(paper.main(sys.argv[1:]))
"""


@pytest.fixture
def filling(tmp_path):
    """Return a function that starts the script on four runs, whose training is quick."""
    stored = tmp_path / "stored.json"
    stored.write_text('{"runs": []}')
    processes = []

    def start(*words):
        command = [sys.executable, "-c", FILLING, str(SCRIPTS), TRAINING, str(stored), *words]
        options = ["--protocol", "paper", "--folder", str(tmp_path / "out")]
        process = subprocess.Popen([*command, *options], stdout=subprocess.PIPE, text=True)
        processes.append(process)
        return process

    yield start
    for process in processes:
        process.kill()
        process.wait()


def _steps(folder):
    return {path.parent.name: path.read_text().split() for path in folder.glob("*/steps.txt")}


def _until(happens, timeout_s=60.0):
    end_s = time.monotonic() + timeout_s
    while not happens():
        assert time.monotonic() < end_s
        time.sleep(0.02)


def test_two_processes_share_the_runs_and_what_is_killed_goes_on_without_doing_anything_twice(
    filling, tmp_path
):
    out = tmp_path / "out"
    words = ("train", "strip/vdn", "block/iql", "--seeds", "2")
    first, second = filling(*words), filling(*words)
    _until(lambda: len(_steps(out)) == 2)
    first.kill()
    second.kill()
    # Their trainings are left, and have their runs.
    left = filling(*words)
    assert left.wait(60) == 0
    _until(lambda: len([*out.glob("*/report.json")]) == 4)
    expected = [str(step) for step in range(30)]
    assert set(map(tuple, _steps(out).values())) == {tuple(expected)}
    assert filling(*words).wait(60) == 0
    assert set(map(tuple, _steps(out).values())) == {tuple(expected)}
    collecting = filling("collect")
    assert collecting.wait(60) == 0
    runs = paper_table.read_runs(tmp_path / "stored.json")
    assert [(run["task"], run["seed"]) for run in runs] == [
        ("block", 0),
        ("block", 1),
        ("strip", 0),
        ("strip", 1),
    ]
    assert runs[0]["curve"] == [[30, 0.25, 3.5]]
    assert runs[0]["cpu_s"] == 1


def test_an_interrupt_ends_the_training_too_and_it_goes_on(filling, tmp_path):
    out = tmp_path / "out"
    process = filling("train", "strip/vdn", "--seeds", "1")
    _until(lambda: _steps(out))
    process.send_signal(signal.SIGTERM)
    assert process.wait(60) == paper.INTERRUPTED
    ((_, so_far),) = _steps(out).items()
    time.sleep(0.3)
    assert [*_steps(out).values()] == [so_far]
    asked = filling("status", "strip/vdn", "--seeds", "2")
    text = asked.communicate(timeout=60)[0]
    assert "interrupted, nothing is evaluated yet" in text
    assert "not run" in text
    assert filling("train", "strip/vdn", "--seeds", "1").wait(60) == 0
    assert len(next(iter(_steps(out).values()))) == 30


def test_cells_that_decide_come_first_a_seed_each_and_longer_episodes_where_nothing_succeeded():
    plan = Plan(range(2), protocol="paper")
    runs = plan.runs([])
    assert [run.seed for run in runs[:18]] == [0] * 9 + [1] * 9
    assert runs[0] == Run("free_building", "qmix", 18, "paper", 1_000_500, 0)
    assert {run.max_steps for run in runs} == {18}
    assert len(runs) == len(set(runs)) == 2 * 36
    nothing = []
    for run in runs[:18]:
        rate = 0.5 if (run.task, run.seed) == ("breaking_barrier", 1) else 0.0
        nothing.append({**vars(run), "last_fifth": rate})
    longer = [run for run in plan.runs(nothing) if run.max_steps == 28]
    assert {run.task for run in longer} == {"free_building", "complex_two_story"}
    assert len(longer) == 12
    assert [run for run in plan.runs(nothing[:9]) if run.max_steps > 18] == []


@pytest.mark.parametrize("algo", paper_table.SIX)
def test_the_command_of_a_run_is_understood_and_has_the_reward_of_its_protocol(algo, tmp_path):
    (run,) = Plan(range(3, 4), (f"strip/{algo}/28",)).runs([])
    _, _, _, _, *words = paper.command_of(run, tmp_path)
    _, bound = bind(words)
    assert bound.arguments["algo"] == algo
    assert (bound.arguments["chance"].seed, bound.arguments["learning"].max_steps) == (3, 28)
    preset = bound.arguments["preset"]
    reward = bound.arguments["learning"].reward
    if preset == "fork":
        reward = protocol(preset, "strip", algo).settings["reward"]
    assert (reward == "published_code") == (run.protocol in paper_table.WITH_RELEASED_REWARD)


@pytest.mark.parametrize("words", ["strips/vdn", "strip/ppo", "strip", "strip/vdn/x"])
def test_a_cell_that_is_none_is_refused(words):
    with pytest.raises(SystemExit, match="no cell"):
        Plan(range(1), (words,)).runs([])


def _record(run, last_fifth, curve):
    stored = {"revision": "0123abcd", "versions": {}, "cpu_s": 60, "mean_return": 2.0}
    return {**vars(run), **stored, "last_fifth": last_fifth, "curve": curve}


def test_a_row_says_how_many_seeds_learned_both_measures_and_what_is_not_run():
    run = Run("simple_two_story", "vdn", 18, "fork", 2_000_000, 0)
    curve = [[1_000_000, 1.0, 13.0], [1_600_000, 0.0, 3.0], [2_000_000, 1.0, 13.0]]
    runs = [_record(run, 0.5, curve)]
    head, row, *missing = paper_table.table_rows(runs, {"simple_two_story": 2_000_000})
    cells = dict(zip(head, row, strict=True))
    assert cells["published"] == "0.71"
    assert cells["seeds"] == "0/1"
    assert cells["success (95 %)"].startswith("0.50 (0.0")
    assert (cells["by return"], cells["nothing built"]) == ("1.00", "0.50")
    (others,) = missing
    assert others[1:5] == ("`iql`, `coma`, `qmix`, `qtran`, `mappo`", "≤ 0.71", "20", "not run")
    verdicts = paper_table.verdict_rows(runs, RELEASED_STEPS)
    assert verdicts[3][:3] == ("`simple_two_story`", "`vdn`", "0.71")
    assert verdicts[3][3].startswith("undecided: 0.50 (0.0")
    assert verdicts[3][3].endswith("), 1x2000k, `fork`")
    assert paper_table.by_return("free_building", runs) == ("-", "-")
    other_reward = replace(run, protocol="paper")
    assert paper_table.by_return("strip", [_record(other_reward, 0.5, curve)]) == ("-", "-")


@pytest.mark.parametrize(
    ("rates", "steps", "verdict"),
    [
        ([1.0] * 200, 2_000_000, "yes: 1.00"),
        ([1.0], 150_000, "compatible: 1.00 (0.02-1.00), 1x150k of 2000k steps, `fork`"),
        ([0.0], 2_000_000, "undecided: 0.00"),
        ([0.0] * 20, 2_000_000, "no: 0.00"),
    ],
)
def test_a_verdict_on_a_published_figure_is_one_of_its_interval(rates, steps, verdict):
    runs = []
    for seed, rate in enumerate(rates):
        run = Run("simple_two_story", "vdn", 18, "fork", steps, seed)
        runs.append(_record(run, rate, [[steps, rate, 13.0]]))
    assert paper_table.verdict_rows(runs, RELEASED_STEPS)[3][3].startswith(verdict)


def test_a_published_rate_of_0_is_reproduced_by_nothing_alone():
    for rate, words in ((0.0, "nothing, as published: 0.00"), (0.9, "more than published: 0.90")):
        run = Run("breaking_barrier", "mappo", 18, "coded", 1_000_500, 0)
        runs = [_record(run, rate, [[1_000_500, rate, 13.0]])]
        assert paper_table.verdict_rows(runs, RELEASED_STEPS)[-1][3].startswith(words)


def test_craftenvs_threshold_counts_a_slope_that_was_unfolded_where_it_stands():
    _, *rows = paper_table.rule_rows()
    assert rows[2] == ("`simple_two_story`", "3", "13", "0", "3")
    assert rows[3][1:4] == ("20", "20", "20")
    # Played: cars that act at random do so, and have built nothing.
    task = make_task("simple_two_story", reward="published_code")
    rng = np.random.default_rng(0)
    worlds = Episodes(task, rng, 100, "published", 20)
    returns = np.zeros(100)
    successes = np.zeros(100, bool)
    for _ in range(task.max_steps + 2):
        offered = worlds.offered()
        steps = worlds.step((rng.random(offered.shape) * offered).argmax(-1))
        returns += steps.reward
        successes |= steps.success
    assert steps.done.all()
    assert (returns >= 3).sum() > 0
    assert not successes.any()


def test_held_out_seeds_are_compared_with_those_of_their_cell(tmp_path, monkeypatch, capsys):
    stored = tmp_path / "stored.json"
    run = Run("strip", "coma", 18, "paper", 1_000_500, 0)
    runs = [_record(replace(run, seed=seed), 1.0, [[10, 1.0, 8.0]]) for seed in range(5)]
    paper_table.write_runs(stored, runs)
    held_out = replace(run, seed=100)
    rates = [1.0]

    class Trained(paper.Folder):
        def finished(self, run):
            return True

        def records(self):
            return [_record(held_out, rate, []) for rate in rates]

    monkeypatch.setattr(paper, "STORED", stored)
    monkeypatch.setattr(paper, "HELD_OUT", tmp_path / "held_out.json")
    monkeypatch.setattr(paper, "Folder", Trained)
    words = ["held-out", "strip/coma", "--folder", str(tmp_path)]
    assert paper.main(words) == 0
    assert "strip/coma: +0.00 (-0.98 to +0.56), no difference seen" in capsys.readouterr().out
    (cell,) = json.loads((tmp_path / "held_out.json").read_text())
    assert (cell["seeds"], cell["low"] > 0.4) == ([100], True)
    rates = [0.0] * 5
    assert paper.main(words) == 1
    _, row = paper_table.held_out_rows(json.loads((tmp_path / "held_out.json").read_text()))
    assert row[3:-1] == ("0.00 (0.00-0.56)", "-1.00 (-1.00 to -0.21)", "yes")
    with pytest.raises(SystemExit, match="take others"):
        paper.main([*words, "--first", "4"])
    with pytest.raises(SystemExit, match="the page has no cell"):
        paper.main(["held-out", "strip/coma/28"])


def test_tasks_after_exploration_have_their_seeds_that_learned_and_when():
    runs = []
    for seed, first in enumerate((20, 40)):
        curve = [[steps, float(steps >= first)] for steps in (20, 40)]
        runs.append({"task": "strip", "key": f"strip/ippo/{seed}", "curve": curve})
    row = {"task": "strip", "by_seed": [1.0, 0.5], "median_steps": 40_000}
    figures = {"rows": [row], "runs": runs}
    report = {"figures": figures, "wall": {"cpu_s": {"strip/ippo/0": 60, "strip/ippo/1": 120}}}
    head, cells = paper_table.explored_rows(report)
    named = dict(zip(head, cells, strict=True))
    assert (named["best published"], named["seeds"], named["CPU min"]) == ("0.92", "1/2", "3")
    assert named["first success at, k"] == "0, 0"
    assert named["success (95 %)"].startswith("0.75 (")


def test_curves_of_the_other_implementation_stand_beside_those_of_the_preset(tmp_path, monkeypatch):
    points = [{"t": 60_000, "won": 0.0, "test_return": 4.0}]
    run = {"args": {"task": "free_building", "seed": 3}, "curve": points}
    (tmp_path / "a.json").write_text(json.dumps(run))
    monkeypatch.setattr(released, "INDEPENDENT", tmp_path / "out" / "stored.json")
    (tmp_path / "out").mkdir()
    assert released.collect_independent(tmp_path) == 0
    ours = [{"task": "free_building", "change": "none", "curve": [[60_000, 0.0, 5.0]]}]
    _, *rows = released.beside_rows(ours, released.read_independent())
    assert [row[1:4] for row in rows] == [("preset fork", "", "5.0"), ("written apart", "", "4.0")]


def test_stored_runs_stay_when_a_folder_without_them_is_stored(tmp_path, monkeypatch):
    stored = tmp_path / "stored.json"
    record = {"task": "free_building", "change": "none", "seed": 0, "steps": 200_000}
    stored.write_text(json.dumps({"runs": [record]}))
    monkeypatch.setattr(released, "STORED", stored)
    assert released.collect(tmp_path) == 0
    assert released.read_runs() == [record]
    # A fourth seed is stored, too, and a longer run in place of a shorter one.
    fourth = record | {"seed": 3}
    longer = record | {"steps": 400_000}
    for run in (fourth, longer):
        folder = tmp_path / str(run["seed"])
        folder.mkdir()
        (folder / "record.json").write_text(json.dumps(run))
    assert released.collect(tmp_path) == 0
    assert released.read_runs() == [longer, fourth]
