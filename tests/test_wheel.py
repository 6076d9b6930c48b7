"""The wheel holds all that the package needs, and runs where there is no checkout."""

import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "craftsim"
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]

BUILD = "import sys, setuptools.build_meta; setuptools.build_meta.build_wheel(sys.argv[1])"
"""What pip does with a checkout, in one process instead of four."""

ACTION = """
from craftsim.discrete.kinds import Action
from craftsim.discrete.grid import Grid
from craftsim.models.world import PhysicsWorld
from craftsim.skills.executor import Executor

outcomes = Executor(PhysicsWorld(Grid.empty((2, 1, 1), n_cars=1))).run({0: Action.MOVE_RIGHT})
assert outcomes[0].succeeded, outcomes

import craftsim
craftsim.read_blueprint("strip")
print(craftsim.__file__)
"""

PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check")
PLAIN = ("--no-deps", "--no-index", "--no-compile")
OUTSIDE = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
"""The environment without a trace of the checkout; pip would take a craftsim on PYTHONPATH for an installed one."""


def _run(*words: object, cwd: Path | None = None) -> str:
    command = [str(word) for word in words]
    done = subprocess.run(
        command, cwd=cwd, env=OUTSIDE, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """Return a copy of what a checkout holds after use, caches included."""
    source = tmp_path_factory.mktemp("wheel") / "source"
    shutil.copytree(PACKAGE, source / "craftsim")
    for part in ("data", "mjcf"):
        (source / "craftsim" / part / "__pycache__").mkdir(exist_ok=True)
        (source / "craftsim" / part / "__pycache__" / "left.pyc").touch()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    return source


@pytest.fixture(scope="module")
def wheel(source):
    """Build the wheel."""
    _run(sys.executable, "-c", BUILD, source.parent, cwd=source)
    (path,) = source.parent.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def python(tmp_path_factory):
    """Make an environment that borrows the dependencies of this one and has cache files of an older copy; return its
    Python.
    """
    venv = tmp_path_factory.mktemp("installed") / "venv"
    _run(sys.executable, "-m", "venv", "--without-pip", venv)
    python = venv / "bin" / "python"
    physics = Path(
        _run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip()
    )
    # Folders named in a .pth file come last, and their own .pth files, an editable craftsim, are not read.
    paths = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    (physics / "dependencies.pth").write_text("".join(f"{path}\n" for path in sorted(paths)))
    # Files that pip did not install survive "pip uninstall" and what "pip install" does before it installs.
    (physics / "craftsim" / "discrete" / "__pycache__").mkdir(parents=True)
    (physics / "craftsim" / "discrete" / "__pycache__" / "grid.legal-1.py311.nbi").touch()
    return python


def test_every_file_of_the_package_is_in_the_wheel(wheel):
    files = {
        str(path.relative_to(ROOT))
        for path in PACKAGE.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    packed = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert packed == files
    for part in (
        "data/blueprints",
        "data/plans",
        "data/gains",
        "data/randomizations",
        "reports/template",
    ):
        assert any(name.startswith(f"craftsim/{part}/") for name in packed), part


def test_the_command_runs_and_a_car_moves_in_physics_and_then_an_editable_install_takes_its_place(
    python, wheel, source, tmp_path
):
    _run(*PIP, "--python", python, "install", *PLAIN, wheel)
    assert "level 1" in _run(python.with_name("craftsim"), "show", "strip", cwd=tmp_path)
    loaded_from = Path(_run(python, "-c", ACTION, cwd=tmp_path).strip())
    assert loaded_from.is_relative_to(python.parents[1]), "not what an older copy left behind"
    _run(*PIP, "--python", python, "install", *PLAIN, "--no-build-isolation", "--editable", source)
    assert _run(python.with_name("craftsim"), "--version", cwd=tmp_path) == f"craftsim {VERSION}\n"
    place = _run(python, "-c", "import craftsim; print(craftsim.__file__)", cwd=tmp_path).strip()
    assert Path(place).is_relative_to(source)
