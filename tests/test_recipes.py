"""The recipes for other trainers run, where their libraries are installed."""

import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

DOCS = Path(__file__).parents[1] / "docs"
NEEDS = {
    "TorchRL": "torchrl",
    "Stable-Baselines3": "sb3_contrib",
    "RLlib": "ray.rllib.algorithms",
    "BenchMARL": "benchmarl",
    "Minari": "minari",
}
"""What each recipe needs; some want other versions than craftsim's, and run in environments of their own only."""


def _recipes() -> dict[str, str]:
    text = (DOCS / "recipes.md").read_text(encoding="utf-8")
    return dict(re.findall(r"^## (\S+)\n.*?```python\n(.*?)```", text, re.DOTALL | re.MULTILINE))


def test_every_recipe_is_tested():
    assert set(_recipes()) == set(NEEDS)


@pytest.mark.parametrize("name", NEEDS)
def test_a_recipe_runs(name, monkeypatch):
    pytest.importorskip(NEEDS[name])
    recipe = ModuleType("recipe")  # some libraries pickle its classes, by the name of their module
    monkeypatch.setitem(sys.modules, "recipe", recipe)
    exec(compile(_recipes()[name], "docs/recipes.md", "exec"), recipe.__dict__)
