"""Importing the package, or asking for help, loads nothing heavy; ``scripts/import_time.py`` measures it."""

import subprocess
import sys

import pytest

from craftsim.cli.commands import COMMANDS

HEAVY = (
    *(
        "mujoco",
        "cv2",
        "matplotlib",
        "numba",
        "av",
        "trimesh",
        "gymnasium",
        "pettingzoo",
        "rich",
        "cyclopts",
    ),
    *("numpy", "scipy", "statsmodels", "pandas", "jinja2", "pydantic", "torch", "ray", "cma"),
)


@pytest.mark.parametrize(
    "statement",
    [
        "import craftsim",
        "import craftsim; dir(craftsim)",
        "import craftsim.cli; craftsim.cli.main(['--help'])",
        "import craftsim.rendering.offscreen",
    ],
)
def test_nothing_heavy_is_loaded(statement):
    assert _loaded(statement, HEAVY) == "loaded:"


def test_the_help_of_a_command_loads_nothing_heavy():
    """0.2 s of CPU time on the machine where it was measured; parsing and formatting are most of it."""
    others = tuple(module for module in HEAVY if module not in ("cyclopts", "rich"))
    asked = f"for name in {list(COMMANDS)}: craftsim.cli.main([name, '--help'])"
    assert _loaded(f"import craftsim.cli\n{asked}", others) == "loaded:"


def _loaded(statement: str, names: tuple[str, ...]) -> str:
    code = f"{statement}\nimport sys\nprint('loaded:', *(name for name in {names!r} if name in sys.modules))"
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return child.stdout.splitlines()[-1]
