"""The scripts for other trainers run, where their libraries are installed."""

import subprocess
import sys
from pathlib import Path

import pytest

TRAINERS = Path(__file__).parents[1] / "examples" / "trainers"
NEEDS = {
    "torchrl_rollout": "torchrl",
    "maskable_ppo": "sb3_contrib",
    "rllib": "ray.rllib.algorithms",
    "benchmarl_ippo": "benchmarl",
    "minari_dataset": "minari",
}
"""What each needs; some want other versions than craftsim's, and run in environments of their own only."""


def test_every_script_is_tested():
    assert {path.stem for path in TRAINERS.glob("*.py")} == set(NEEDS)


@pytest.mark.parametrize("name", NEEDS)
def test_a_script_runs(name, tmp_path):
    """In a process of its own, as its reader starts it: its folder comes first where modules are looked for."""
    pytest.importorskip(NEEDS[name])
    words = [sys.executable, TRAINERS / f"{name}.py"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
