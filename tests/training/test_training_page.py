"""The example of a trained policy on its page runs."""

import textwrap
from pathlib import Path

from craftsim.training.config import TrainConfig
from craftsim.training.trainer import Trainer

PAGE = Path(__file__).parents[2] / "docs/training.md"


def test_the_example_plays_a_trained_policy(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "out/train/strip"
    folder.mkdir(parents=True)
    Trainer(TrainConfig("strip", worlds=1, width=4)).save(folder)
    text = PAGE.read_text(encoding="utf-8")
    section = (
        text.split("rates highest:", 1)[1].split("\n## ", 1)[0].replace('"physics"', '"grid"')
    )  # quicker
    names: dict[str, object] = {}
    exec(compile(textwrap.dedent(section), "docs/training.md", "exec"), names)
    assert set(names["infos"]) == {"car_0", "car_1"}
