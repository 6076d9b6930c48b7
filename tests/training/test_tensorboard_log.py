"""What TensorBoard shows is the learning curve, also of a run that was interrupted."""

import pytest

from craftsim.cli import main
from craftsim.errors import InputError
from craftsim.training.curve import TENSORBOARD, CurvePoint, TensorboardLog


def _point(steps):
    return CurvePoint(10, steps // 100, 0.5, 12.0, 1, 0, 3, steps=steps)


def test_every_point_is_there_once_after_a_run_went_on(tmp_path):
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    curve = [_point(100)]
    TensorboardLog(tmp_path, []).write(curve[0])
    curve.append(_point(200))  # whose event was not written any more
    TensorboardLog(tmp_path, curve).write(_point(300))
    events = EventAccumulator(str(tmp_path / TENSORBOARD)).Reload()
    assert set(events.Tags()["scalars"]) == {"eval/success", "eval/return", "eval/ticks"}
    shown = [(event.step, event.value) for event in events.Scalars("eval/success")]
    assert shown == [(100, pytest.approx(0.1)), (200, pytest.approx(0.2)), (300, pytest.approx(0.3))]


def test_a_log_behind_a_link_is_left_alone(tmp_path):
    pytest.importorskip("tensorboard")
    precious = tmp_path / "elsewhere/events.out.tfevents.1"
    precious.parent.mkdir()
    precious.touch()
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / TENSORBOARD).symlink_to(precious.parent)
    with pytest.raises(InputError, match="is a link, and none is followed"):
        TensorboardLog(tmp_path / "run", [])
    assert [*precious.parent.iterdir()] == [precious]


def test_without_tensorboard_the_command_says_how_to_get_it(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("craftsim.training.curve.find_spec", lambda name: None)
    assert main(["train", "--tensorboard", "--out", str(tmp_path / "run")]) == 2
    assert "pip install tensorboard" in capsys.readouterr().err
