"""The set-up scripts say what is missing and which command mends it; nothing is installed here."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[1] / "scripts"
NO_ENSUREPIP = f"""case "$2" in *ensurepip*) exit 1 ;; esac
exec {sys.executable} "$@"
"""


@pytest.fixture
def run(tmp_path):
    """Run a script with some programs replaced by shell scripts of the test."""

    def run_with(script: str, *words: str, programs: dict[str, str], **environment: str):
        folder = tmp_path / "bin"
        folder.mkdir()
        for name, body in programs.items():
            (folder / name).write_text(f"#!/bin/sh\n{body}")
            (folder / name).chmod(0o755)
        return subprocess.run(
            [SCRIPTS / script, *words],
            env={**os.environ, "PATH": f"{folder}:{os.environ['PATH']}", **environment},
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )

    return run_with


def test_a_python_that_is_too_old_is_refused(run, tmp_path):
    result = run("make-venv", "venv", programs={"python3": "exit 1"}, PYTHON="python3")
    assert result.returncode == 1
    assert "needs Python 3.11 or newer" in result.stderr
    assert not (tmp_path / "venv").exists()


def test_without_ensurepip_a_user_gets_the_command(run):
    result = run(
        "make-venv", "venv", programs={"python3": NO_ENSUREPIP, "id": "echo 1000"}, PYTHON="python3"
    )
    assert result.returncode == 1
    assert f"sudo apt-get install python3.{sys.version_info.minor}-venv" in result.stderr


def test_without_ensurepip_root_installs_it(run, tmp_path):
    apt = 'echo "$@" >> apt.log; case "$1" in install) exit 7 ;; esac'
    result = run(
        "make-venv",
        "venv",
        programs={"python3": NO_ENSUREPIP, "id": "echo 0", "apt-get": apt},
        PYTHON="python3",
    )
    assert f"python3.{sys.version_info.minor}-venv" in (tmp_path / "apt.log").read_text()
    assert result.returncode == 7, "a failed installation stops the script"


BACKEND = """case "$2" in
    craftsim.rendering.offscreen) [ -e installed ] || { echo "nothing renders" >&2; exit 1; } ;;
    *) echo libone libtwo ;;
esac
"""


@pytest.mark.parametrize(
    ("user", "said", "called"),
    [(0, "", ["update", "install"]), (1000, "nothing renders", []), (None, "", [])],
)
def test_missing_rendering_libraries_are_installed_by_root_alone(run, tmp_path, user, said, called):
    if user is None:
        (tmp_path / "installed").touch()
    apt = 'echo "$@" >> apt.log; case "$1" in install) touch installed ;; esac'
    programs = {"python": BACKEND, "id": f"echo {user}", "apt-get": apt}
    result = run("system-libraries", "python", programs=programs)
    assert (result.returncode, bool(result.stdout)) == (0, bool(called))
    assert said in result.stderr
    assert ("Going on without films." in result.stderr) is bool(said)
    log = (tmp_path / "apt.log").read_text().splitlines() if called else []
    assert [line.split()[0] for line in log] == called
    assert not called or log[1].endswith("libone libtwo")
