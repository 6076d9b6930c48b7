"""No file that merely lies in the working folder is imported, and no network asked, by commands, their workers, or
anything they start."""

import os
import re
import subprocess
import sys
from importlib.machinery import PathFinder
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

import craftsim
from craftsim.workers.actor import spawn_context
from craftsim.workers.modules import import_user_module

pytestmark = pytest.mark.usefixtures("spawned")
PACKAGE = Path(craftsim.__file__).parent
CRAFTSIM = [str(Path(sys.executable).with_name("craftsim"))]


def _python(code):
    """Return what a fresh interpreter prints, as words: what this one has imported may have changed its path."""
    done = subprocess.run(
        [sys.executable, "-I", "-c", code], capture_output=True, text=True, check=True
    )
    return done.stdout.split("\n")[:-1]


PLACES = _python("import sys; print(*sys.path, sep='\\n')")
MODULES = {
    name
    for name in {*sys.stdlib_module_names, *packages_distributions()} - {"craftsim"}
    if name.isidentifier()
    and (spec := PathFinder.find_spec(name, PLACES)) is not None
    and spec.origin is not None
}
"""Those that are there; a folder without an __init__.py comes after all else, wherever it lies."""
PLANTED = "import sys\nwith open({!r}, 'a') as file:\n    print(__name__, sys.argv, file=file)\nraise SystemExit(9)\n"
SHUT = """
import socket

def shut(*words, **options):
    raise SystemExit(f"asked the network: {words} {options}")

for name in ("connect", "connect_ex", "bind", "sendto"):
    setattr(socket.socket, name, shut)
for name in ("getaddrinfo", "gethostbyname", "gethostbyaddr", "create_connection"):
    setattr(socket, name, shut)
"""
POLICY = "def stop(observations):\n    return dict.fromkeys(observations, 14)\n"


@pytest.fixture
def folder(tmp_path):
    """A working folder with a module for every one of Python and of what is installed; each says when it is run.

    Every process shuts its sockets first.
    """
    ran = tmp_path / "ran"
    here = tmp_path / "here"
    here.mkdir()
    for name in MODULES:
        (here / f"{name}.py").write_text(PLANTED.format(str(ran)))
    (here / "own.py").write_text(POLICY)
    (tmp_path / "shut").mkdir()
    (tmp_path / "shut" / "sitecustomize.py").write_text(SHUT)
    return here


def _environment(folder):
    # Where nobody has chosen how MuJoCo draws it imports glfw, which starts a Python of its own.
    inherited = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    path = [folder.with_name("shut"), PACKAGE.parent]
    return {**inherited, "PYTHONPATH": os.pathsep.join(map(str, path))}


def _run(folder, *words):
    done = subprocess.run(
        [str(word) for word in words],
        cwd=folder,
        env=_environment(folder),
        capture_output=True,
        text=True,
        check=False,
    )
    ran = folder.with_name("ran")
    assert not ran.exists(), ran.read_text()
    assert "asked the network" not in done.stdout + done.stderr
    return done


COMMANDS = f"""\
from craftsim.cli import main

def look(physics):
    physics.seen = True

if __name__ == "__main__":
    for words in (
        "train --steps 1 --episodes 1 --worlds 2 --out out/train",
        "doctor --out out/doctor",
        "show strip --out out",
        "conformance {PACKAGE.parent}/tests/data/plans.jsonl.gz --out out/conformance",
    ):
        assert main(words.split()) == 0, words

    from craftsim import make_task, vector_env

    envs = vector_env(make_task("strip"), 1, "physics", drive="wheels", workers=1, observers=[look])
    envs.reset(seed=0)
    envs.close()
    print("played")
"""
"""A user's script, whose functions a worker finds though it looks for nothing in the folder."""
VALIDATE = "validate strip --policy own:stop --drive wheels --max-steps 1 --trials 1 --workers 1 --video all"
"""A worker of a campaign, with a policy of the folder, and of films, where those can be made."""


def test_commands_run_nothing_that_lies_in_the_working_folder(folder, tmp_path):
    assert _run(folder, *CRAFTSIM, "--version").returncode == 0
    script = tmp_path / "script.py"
    script.write_text(COMMANDS)
    done = _run(folder, sys.executable, script)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("played\n")


def test_started_with_m_it_looks_there_for_nothing_either(folder):
    # What Python and the first lines of ours import has been looked up before the folder is left out.
    for name in _python(
        "import __future__, runpy, sys, craftsim.workers.modules; print(*sys.modules, sep='\\n')"
    ):
        (folder / f"{name}.py").unlink(missing_ok=True)
    done = _run(folder, sys.executable, "-m", "craftsim", *VALIDATE.split())
    # Cars that only stop do nothing that could be judged.
    assert done.returncode == 1, done.stderr
    assert "No action was judged" in done.stdout
    assert not (folder / "MUJOCO_LOG.TXT").exists()


def test_the_shut_sockets_are_noticed(folder):
    asks = "import urllib.request as r; r.urlopen('http://127.0.0.1:9')"
    done = subprocess.run(
        [sys.executable, "-P", "-c", asks],
        env=_environment(folder),
        capture_output=True,
        check=False,
    )
    assert b"asked the network" in done.stderr


def test_a_module_of_python_or_an_installed_one_comes_before_one_of_the_working_folder(
    folder, monkeypatch
):
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "path", sys.path[:])
    for name in ("this_is_own", "pettingzoo", "wave"):
        (folder / f"{name}.py").write_text("mine = True\n")
        monkeypatch.delitem(sys.modules, name, raising=False)
    found = {
        name: hasattr(import_user_module(name), "mine")
        for name in ("this_is_own", "pettingzoo", "wave")
    }
    assert found == {"this_is_own": True, "pettingzoo": False, "wave": False}


def test_a_process_leaves_the_environment_as_it_was(monkeypatch):
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    for value in (None, ""):
        if value is not None:
            monkeypatch.setenv("PYTHONSAFEPATH", value)
        context = spawn_context()
        answer = context.SimpleQueue()
        process = context.Process(target=_say_it, args=(answer,))
        process.start()
        assert os.environ.get("PYTHONSAFEPATH") == answer.get() == value
        process.join()


def _say_it(answer):
    answer.put(os.environ.get("PYTHONSAFEPATH"))


FORKS = r"(?<!`)\bget_context\(|\bos\.(fork|exec|system|spawn)|\bfrom os import"
OWN = r"\b(SpawnContext|spawn_context|ProcessPoolExecutor)\b"


def test_processes_are_started_in_one_way():
    """All by workers/actor.py, or with -P; and one module alone adds the working folder to the path."""
    for path in PACKAGE.rglob("*.py"):
        text, place = path.read_text(encoding="utf-8"), str(path.relative_to(PACKAGE))
        assert not re.search(FORKS, text), place
        assert not re.search(OWN, text) or place == "workers/actor.py", place
        assert not re.search(r"\[\s*sys\.executable,(?!\s*\"-P\")", text), place
        assert (
            not re.search(r"\bsys\.path\.(insert|append)\b", text) or place == "workers/modules.py"
        ), place
