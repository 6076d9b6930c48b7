"""The scripts for other trainers run, where their libraries are installed."""

import sys
from pathlib import Path
from types import ModuleType

import pytest

TRAINERS = Path(__file__).parents[1] / "examples" / "trainers"
NEEDS = {
    "torchrl_rollout": "torchrl",
    "stable_baselines3": "sb3_contrib",
    "rllib": "ray.rllib.algorithms",
    "benchmarl_ippo": "benchmarl",
    "minari_dataset": "minari",
}
"""What each needs; some want other versions than craftsim's, and run in environments of their own only."""


def test_every_script_is_tested():
    assert {path.stem for path in TRAINERS.glob("*.py")} == set(NEEDS)


@pytest.mark.parametrize("name", NEEDS)
def test_a_script_runs(name, monkeypatch):
    pytest.importorskip(NEEDS[name])
    module = ModuleType("trainer")  # some libraries pickle its classes, by the name of their module
    monkeypatch.setitem(sys.modules, "trainer", module)
    path = TRAINERS / f"{name}.py"
    exec(compile(path.read_text(encoding="utf-8"), str(path), "exec"), module.__dict__)
