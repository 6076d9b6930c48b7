"""Importing the package, or asking for help, loads nothing heavy; ``make importtime`` measures how long it takes."""

import subprocess
import sys

import pytest

HEAVY = (
    *("mujoco", "cv2", "matplotlib", "numba", "av", "trimesh", "gymnasium", "pettingzoo", "rich", "tyro"),
    *("numpy", "scipy", "statsmodels", "pandas", "jinja2", "pydantic", "torch", "ray", "cma"),
)


@pytest.mark.parametrize(
    "statement",
    [
        "import craftsim",
        "import craftsim; dir(craftsim)",
        "import craftsim.cli; craftsim.cli.main(['--help'])",
        "import craftsim.rendering.backend",
    ],
)
def test_nothing_heavy_is_loaded(statement):
    code = f"{statement}\nimport sys\nprint('loaded:', *(name for name in {HEAVY!r} if name in sys.modules))"
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert child.stdout.splitlines()[-1] == "loaded:"
