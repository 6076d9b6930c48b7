"""``craftsim train``: what it writes, how it goes on, and what it refuses."""

import csv
import importlib.util
import json
import os
import signal
import subprocess
import sys

import pytest

from craftsim.cli import main
from craftsim.errors import InputError
from craftsim.learning import starts, trainer
from craftsim.learning.config import NEVER, TrainConfig, protocol, settings_of
from craftsim.learning.curve import TENSORBOARD, CurvePoint, TrackedCurve, last_fifth
from craftsim.learning.policy import load_policy
from craftsim.learning.settings import QSettings
from craftsim.learning.trainer import Trainer
from craftsim.tasks import make_task
from craftsim.workers import interrupts


def _train(out, *words):
    task = [] if "--task" in words else ["strip"]
    return main(["train", *task, "--episodes", "5", "--worlds", "10", "--out", str(out), *words])


def test_it_writes_a_policy_a_curve_and_a_report_and_goes_on(tmp_path, capsys, rendered_drawings):
    short, whole = tmp_path / "short", tmp_path / "whole"
    often = ("--evaluate-every", "400")
    assert _train(short, "--steps", "200", *often) == 0
    assert _train(short, "--steps", "600", *often, "--resume") == 0
    assert _train(whole, "--steps", "600", *often) == 0
    assert "from its one start" in capsys.readouterr().out
    reports = [json.loads((folder / "report.json").read_text()) for folder in (short, whole)]
    assert {key: value for key, value in reports[0].items() if key != "wall"} == {
        key: value for key, value in reports[1].items() if key != "wall"
    }
    figures = reports[0]["figures"]
    assert figures["steps"] == 600
    asked = {
        "task": "strip",
        "algo": "ippo",
        "steps": 600,
        "until": 0.99,
        "starts": None,
        "episodes": 5,
    }
    assert reports[0]["config"].items() >= asked.items()
    assert figures["success"]["trials"] == 5
    assert (figures["success"]["wilson_low"], figures["starts"]["distinct"]) == (None, 1)
    with open(short / "curve.csv", newline="") as file:
        assert [int(row["steps"]) for row in csv.DictReader(file)] == [400]
    assert (short / "curve.png").read_bytes().startswith(b"\x89PNG")
    assert load_policy(short).config.task == "strip"
    assert load_policy(short).identity.name == "strip"
    assert reports[0]["config"]["task_digest"] == make_task("strip").digest


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--novelty", "nan"], "--novelty is nan; allowed: 0 to 1000"),
        (["--novelty", "inf"], "--novelty"),
        (["--width", "1000000000"], "--width is 1000000000; allowed: 1 to 4096"),
        (["--starts", "no_such.plan"], "no_such.plan"),
        (
            ["--starts", "some.plan", "--preset", "paper"],
            "learns from nothing; leave starts, imitate and pretrained out",
        ),
        (["--explore", "-1"], "--explore is -1; allowed: 0 to 10000000"),
        (["--helper-depth", "5", "--backend", "physics"], "or train on the grid"),
        (["--workers", "2"], "workers is for physics"),
        (["--engine", "ray"], "engine is for physics"),
        (["--engine", "rays", "--backend", "physics"], 'Invalid value "rays" for --engine'),
        (["--drive", "rollers"], "drive is for physics"),
        (["--device", "tpu"], 'Invalid value "tpu" for --device'),
        (["--device", "[1]"], 'Invalid value "[1]" for --device'),
        (["--randomize", "mild"], "randomize is for physics"),
        (["--record", "trajectory"], "record is for physics"),
        (["--recurrent"], "ippo has no recurrent policy; leave recurrent out"),
        (
            ["--batch", "64"],
            "ippo has no --batch, which is for iql, vdn, qmix, qtran; ippo has --gamma, --learning",
        ),
        (
            ["--algo", "vdn", "--gae-lambda", "0.9"],
            "vdn has no --gae-lambda, which is for ippo, mappo; vdn has",
        ),
        (
            ["--algo", "coma", "--target-rate", "1"],
            "key 'target_rate': 1.0 is out of range, allowed: 0.0001 to 0.999",
        ),
        (
            ["--algo", "vdn", "--epsilon-end", "1"],
            "epsilon_end is 1.0; allowed: at most epsilon_start, 0.5",
        ),
        (["--task", "strap"], "strip"),
    ],
)
def test_wrong_input_gives_one_message(words, message, tmp_path, capsys):
    assert _train(tmp_path, *words) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_a_run_that_was_cut_off_before_its_first_save_begins_again(tmp_path, capsys):
    cut, whole = tmp_path / "cut", tmp_path / "whole"
    cut.mkdir()
    (cut / ".partial-0-run.safetensors").write_bytes(b"of a save that was cut off")
    assert _train(cut, "--steps", "20", "--resume") == 0
    assert f"Nothing is saved in {cut} yet" in capsys.readouterr().out
    assert _train(whole, "--steps", "20") == 0
    figures = [
        json.loads((folder / "report.json").read_text())["figures"] for folder in (cut, whole)
    ]
    assert figures[0] == figures[1]


@pytest.mark.parametrize("resume", [(), ("--resume",)])
def test_a_policy_without_its_run_is_not_begun_again_silently(resume, tmp_path, capsys):
    (tmp_path / "policy.safetensors").write_bytes(b"of a run that somebody has moved")
    assert _train(tmp_path, "--steps", "20", *resume) == 2
    said = capsys.readouterr().err
    assert "holds a policy.safetensors, but no run.safetensors" in said
    assert "--pretrained " in said
    assert (tmp_path / "policy.safetensors").read_bytes() == b"of a run that somebody has moved"


def test_plans_made_before_an_interrupt_are_kept_and_not_made_again(
    tmp_path, monkeypatch, capsys, rendered_drawings
):
    usual, planned = starts.plan_building, list[int]()

    def plan(*arguments, **options):
        planned.append(options["seed"])
        if len(planned) == 3:
            os.kill(os.getpid(), signal.SIGTERM)
        return usual(*arguments, **options)

    cut, whole = tmp_path / "cut", tmp_path / "whole"
    of_plans = (
        "--task",
        "random_strip",
        "--imitate",
        "6",
        "--network",
        "relative",
        "--steps",
        "220",
    )
    assert _train(whole, *of_plans) == 0
    monkeypatch.setattr(starts, "plan_building", plan)
    assert _train(cut, *of_plans) == 130
    assert "Interrupted; --resume goes on" in capsys.readouterr().out
    assert _train(cut, *of_plans, "--resume") == 0
    assert len(planned) == 7  # six, of which the third was cut off
    assert planned[2] == planned[3]
    reports = [
        json.loads((folder / "report.json").read_text())["figures"] for folder in (cut, whole)
    ]
    assert reports[0] == reports[1]
    assert _train(cut, *of_plans, "--resume") == 0
    assert len(planned) == 7


def test_a_second_interrupt_cuts_an_iteration_off_and_saves_nothing_of_it(
    tmp_path, monkeypatch, capsys
):
    assert _train(tmp_path, "--steps", "20") == 0
    before = (tmp_path / "run.safetensors").read_bytes()
    monkeypatch.setattr(interrupts, "_SAME_S", 0.0)
    monkeypatch.setattr(
        Trainer, "_iterate", lambda self: [signal.raise_signal(signal.SIGINT) for _ in range(2)]
    )
    assert _train(tmp_path, "--steps", "2000", "--resume") == 130
    assert f"goes on from what was saved before in {tmp_path}" in capsys.readouterr().out
    assert (tmp_path / "run.safetensors").read_bytes() == before


def test_a_run_is_saved_now_and_then_though_nothing_is_evaluated(tmp_path, monkeypatch):
    monkeypatch.setattr(trainer, "SAVE_EVERY_S", 0.0)
    run = Trainer(TrainConfig("strip", worlds=2, width=4, evaluate_every=10**9))
    iterations = run.run_and_save(tmp_path, 10**9, 2.0)
    for number in (1, 2):
        assert next(iterations) is False
        assert Trainer.resume(tmp_path).iteration == number


def test_a_task_and_a_stage_that_code_makes_are_trained_on_and_gone_on_with(
    tmp_path, monkeypatch, capsys
):
    (tmp_path / "corners.py").write_text(
        "import craftsim\n\ndef corner():\n    return craftsim.make_task('strip')\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    words = [
        "--task",
        "corners:corner",
        "--stages",
        "corners:corner",
        "--stage-steps",
        "5",
        "--steps",
        "1",
    ]
    assert _train(tmp_path / "out", *words) == 0
    assert _train(tmp_path / "out", *words, "--resume") == 0
    evaluate = ["--policy", "out", "--backend", "grid", "--trials", "1", "--out", "played"]
    assert main(["validate", *evaluate]) == 2
    error = capsys.readouterr().err
    assert "out: the task that it was trained on is not there: task 'corners:corner'" in error
    assert "name one" in error
    assert main(["validate", "corners:corner", *evaluate]) == 0
    sys.modules.pop("corners")


@pytest.mark.parametrize("task", ["strip", "complex_two_story"])
@pytest.mark.parametrize("algo", ["qmix", "coma", "ippo"])
def test_the_presets_are_the_papers_with_and_without_exploration(task, algo):
    run, plus = protocol("paper", task, algo), protocol("paper_plus", task, algo)
    assert run.steps == (1_000_500 if task == "strip" else 2_000_000)
    assert run.until == NEVER > 1
    epsilons = {
        name: n for name, n in run.settings["hyperparameters"].items() if name.startswith("epsilon")
    }
    expected = {"epsilon_start": 0.21, "epsilon_end": 0.2, "epsilon_ticks": 50_000}
    assert epsilons == (expected if algo == "qmix" else {})
    assert "explore" not in run.settings
    assert run.settings["shows_hidden"]
    decay = protocol("paper", task, algo, 5_000).settings["hyperparameters"].get("decay_ticks")
    assert decay == (None if algo == "ippo" else 5_000)
    assert plus.settings == {**run.settings, "explore": 1_000_000 if task == "strip" else 5_000_000}


@pytest.mark.parametrize("algo", ["iql", "vdn", "qmix"])
@pytest.mark.parametrize("max_steps", [18, 48])
def test_the_preset_fork_is_the_released_learner(algo, max_steps):
    """As PyMARL/src of CraftEnv has it; an episode has two ticks more than its limit."""
    run = protocol("fork", "free_building", algo, max_steps=max_steps)
    config = TrainConfig("free_building", algo, max_steps=max_steps, **run.settings)
    settings, ticks = settings_of(algo, config.hyperparameters), max_steps + 2
    assert (run.steps, run.until) == (1_000_500, NEVER)
    assert (config.rules, config.helper_depth, config.queue_survives) == ("published", 20, True)
    assert (config.network, config.width) == ("linear", 64)
    assert (config.recurrent, config.last_action) == (True, True)
    assert (config.evaluate_every, config.evaluation_episodes) == (10_000, 20)
    assert settings == QSettings(
        gamma=0.99,
        td_lambda=0.0,
        limit_ends=1,
        batch=32 * ticks,
        buffer=5000 * ticks,
        replays=32.0,
        target_rate=1.0,
        target_ticks=200 * ticks,
        rmsprop=1,
        learning_rate=5e-4,
        decay_ticks=0,
        max_gradient=10.0,
        epsilon_start=0.21,
        epsilon_end=0.2,
        epsilon_ticks=1,
    )
    task = config.find_task("breaking_barrier")
    assert (task.ends_on_success, task.max_steps) == (False, max_steps)
    assert "tick" not in task.reward.terms
    with pytest.raises(InputError, match="released learner of iql, vdn and qmix; mappo is another"):
        protocol("fork", "strip", "mappo")


def test_the_replay_memory_of_the_preset_fork_stays_within_its_range_in_long_episodes():
    run = protocol("fork", "strip", "qmix", max_steps=300)
    config = TrainConfig("strip", "qmix", max_steps=300, **run.settings)
    assert settings_of("qmix", config.hyperparameters).buffer == 1_000_000


def test_only_the_paper_s_tasks_have_its_code_s_reward():
    config = TrainConfig("random_strip", "vdn", reward="published_code")
    with pytest.raises(InputError, match="unknown task 'random_strip'"):
        config.find_task(config.task)


def test_a_preset_of_the_command_is_what_its_protocol_settles(tmp_path):
    assert _train(tmp_path, "--preset", "paper", "--steps", "1") == 0
    asked = json.loads((tmp_path / "report.json").read_text())["config"]
    settled = protocol("paper", "strip", "ippo", 1).settings
    assert asked | {**settled, "explore": 0, "until": NEVER} == asked
    assert load_policy(tmp_path).identity.rules == "published"


def test_the_last_fifth_of_a_curve_is_at_least_its_last_evaluation():
    assert last_fifth([]) == 0
    assert last_fifth([0.0, 1.0]) == 1
    assert last_fifth([1.0] * 8 + [0.0, 0.5]) == 0.25


def test_a_run_goes_on_as_it_began_only_and_is_never_overwritten(tmp_path, capsys):
    plan, other = tmp_path / "short.plan", tmp_path / "other.plan"
    plan.write_text("0 0 MOVE_RIGHT\n1 0 LIFT\n2 0 MOVE_RIGHT\n")
    other.write_text("0 0 MOVE_RIGHT\n1 0 LIFT\n2 0 DROP\n3 0 MOVE_LEFT\n")
    first = ["--steps", "1", "--starts", str(plan)]
    assert _train(tmp_path / "run", *first) == 0
    assert _train(tmp_path / "run", *first, "--resume") == 0
    capsys.readouterr()
    for words in (["--starts", str(other)], []):
        assert _train(tmp_path / "run", "--steps", "1", *words, "--resume") == 2
        assert "give those of then with --starts" in capsys.readouterr().err
    assert _train(tmp_path / "plain", "--steps", "1") == 0
    assert _train(tmp_path / "plain", *first, "--resume") == 2
    assert "begun with no other starts" in capsys.readouterr().err
    assert _train(tmp_path / "plain", "--steps", "1") == 2
    assert "--resume goes on with it" in capsys.readouterr().err
    assert _train(tmp_path / "plain", "--steps", "1", "--seed", "1", "--resume") == 2
    assert "begun with" in capsys.readouterr().err


def test_without_a_terminal_it_says_now_and_then_how_far_it_is(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("craftsim.cli.train.LINE_EVERY_S", 0.001)
    assert _train(tmp_path, "--steps", "600") == 0
    assert "strip, ippo: 400 of at most 600 steps, success -, return -," in capsys.readouterr().out


def test_without_an_extra_it_says_how_to_install_it(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("craftsim.learning.curve.find_spec", lambda name: None)
    assert _train(tmp_path / "run", "--tracker", "tensorboard") == 2
    assert "pip install tensorboard" in capsys.readouterr().err
    find = importlib.util.find_spec
    monkeypatch.setattr(
        "craftsim.storage.extras.find_spec", lambda name: None if name == "torch" else find(name)
    )
    assert _train(tmp_path) == 2
    error = capsys.readouterr().err
    assert "training needs torch, not installed here" in error
    assert f"{sys.executable} -m pip install 'torch>=" in error
    assert "craftsim[train]" not in error, "the name on the package index belongs to somebody else"


@pytest.mark.parametrize("module", ["craftsim.cli.train", "craftsim.learning.policy"])
def test_the_command_is_there_without_torch(module):
    code = f"import sys, {module}; print('torch' in sys.modules)"
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert child.stdout == "False\n"


def _point(steps):
    return CurvePoint(10, steps // 100, 0.5, 12.0, 1, 0, 3, steps=steps)


def test_every_point_is_there_once_after_a_run_went_on(tmp_path):
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    curve = [_point(100)]
    TrackedCurve(TENSORBOARD, tmp_path, []).add(curve[0])
    curve.append(_point(200))  # whose event was not written any more
    TrackedCurve(TENSORBOARD, tmp_path, curve).add(_point(300))
    events = EventAccumulator(str(tmp_path / TENSORBOARD)).Reload()
    assert set(events.Tags()["scalars"]) == {"eval/success", "eval/return", "eval/ticks"}
    shown = [(event.step, event.value) for event in events.Scalars("eval/success")]
    assert shown == [
        (100, pytest.approx(0.1)),
        (200, pytest.approx(0.2)),
        (300, pytest.approx(0.3)),
    ]


def test_a_log_behind_a_link_is_left_alone(tmp_path):
    pytest.importorskip("tensorboard")
    precious = tmp_path / "elsewhere/events.out.tfevents.1"
    precious.parent.mkdir()
    precious.touch()
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / TENSORBOARD).symlink_to(precious.parent)
    with pytest.raises(InputError, match="is a link, and none is followed"):
        TrackedCurve(TENSORBOARD, tmp_path / "run", [])
    assert [*precious.parent.iterdir()] == [precious]


TRACKER = """\
calls = []


def track(values, steps):
    calls.append((steps, sorted(values)))


def fail(values, steps):
    raise ConnectionError("no such host")


NUMBER = 3
"""
NAMES = ["eval/return", "eval/success", "eval/ticks"]


def test_a_tracker_of_ones_own_gets_each_point_and_the_earlier_ones_of_a_run_that_goes_on(
    tmp_path, monkeypatch, capsys, rendered_drawings
):
    (tmp_path / "tracked.py").write_text(TRACKER)
    monkeypatch.chdir(tmp_path)
    for steps in (1600, 2400):
        words = ["--steps", str(steps), "--tracker", "tracked:track", "--resume"]
        assert _train(tmp_path / "run", "--evaluate-every", "800", *words) == 0
    calls = sys.modules.pop("tracked").calls
    assert calls == [(steps, NAMES) for steps in (800, 1600, 800, 1600, 2400)]
    more = ["--evaluate-every", "800", "--resume", "--steps", "3200"]
    assert _train(tmp_path / "run", *more, "--tracker", "tracked:fail") == 2
    said = "tracker 'tracked:fail' raised ConnectionError: no such host; --resume goes on"
    assert said in capsys.readouterr().err
    for name, message in (
        ("tracked:NUMBER", "is a int, not a function"),
        ("wandb", "must be module:function"),
        ("tracked:trak", "did you mean 'track'"),
    ):
        assert _train(tmp_path / "run", *more, "--tracker", name) == 2
        assert message in capsys.readouterr().err
