"""The recipes for other trainers run, and so does the example of a trained policy."""

import re
import textwrap
from pathlib import Path

import pytest

from craftsim.training.config import TrainConfig
from craftsim.training.trainer import Trainer

DOCUMENT = Path(__file__).parents[2] / "docs/training.md"
TEXT = DOCUMENT.read_text(encoding="utf-8")


@pytest.mark.parametrize("number", range(2))
def test_a_recipe_runs(number):
    exec(compile(re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)[number], str(DOCUMENT), "exec"), {})


def test_the_example_plays_a_trained_policy(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "out/train/strip"
    folder.mkdir(parents=True)
    Trainer(TrainConfig("strip", worlds=1, width=4)).save(folder)
    section = (
        TEXT.split("rates highest:", 1)[1].split("\n## ", 1)[0].replace('"physics"', '"grid"')
    )  # quicker
    names: dict[str, object] = {}
    exec(compile(textwrap.dedent(section), str(DOCUMENT), "exec"), names)
    assert set(names["infos"]) == {"car_0", "car_1"}
