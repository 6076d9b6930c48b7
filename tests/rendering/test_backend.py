"""The backend is chosen by trying, and a user's choice is never replaced."""

import os
import subprocess
import sys

import pytest

from craftsim.rendering import backend

BROKEN = {"egl": "no EGL here", "osmesa": "no OSMesa here"}


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch):
    """A machine on which MuJoCo is not imported yet and the backends fail as told."""

    def set_up(failures: dict[str, str]) -> None:
        monkeypatch.delenv("MUJOCO_GL", raising=False)
        monkeypatch.delitem(sys.modules, "mujoco", raising=False)
        monkeypatch.setattr(backend, "failure", failures.get)

    return set_up


@pytest.mark.parametrize(("broken", "chosen"), [({}, "egl"), ({"egl": "no"}, "osmesa")])
def test_the_first_backend_that_renders_is_chosen(machine, broken, chosen):
    machine(broken)
    assert backend.choose_backend() == chosen
    assert os.environ["MUJOCO_GL"] == chosen


def test_without_any_the_message_gives_reasons_and_the_command(machine):
    machine(BROKEN)
    with pytest.raises(backend.RenderingUnavailable) as caught:
        backend.choose_backend()
    for part in (*BROKEN.values(), "apt-get install libegl1 libgl1-mesa-dri"):
        assert part in str(caught.value)
    assert "MUJOCO_GL" not in os.environ


def test_a_users_choice_is_kept_when_it_works_and_refused_when_not(machine, monkeypatch):
    machine({"egl": "no EGL here"})
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    assert backend.choose_backend() == "osmesa"
    monkeypatch.setenv("MUJOCO_GL", "egl")
    with pytest.raises(backend.RenderingUnavailable, match="MUJOCO_GL=egl does not render"):
        backend.choose_backend()
    assert os.environ["MUJOCO_GL"] == "egl"


def test_a_choice_after_mujoco_was_imported_is_refused(machine, monkeypatch):
    machine({})
    monkeypatch.setitem(sys.modules, "mujoco", object())
    with pytest.raises(backend.RenderingUnavailable, match="imported before"):
        backend.choose_backend()


def test_a_backend_that_cannot_load_fails_with_a_reason():
    assert "no_such_backend" in str(backend.failure("no_such_backend"))


def test_as_a_program_it_says_what_is_wrong():
    child = subprocess.run(
        [sys.executable, "-m", "craftsim.rendering.backend"],
        env={**os.environ, "MUJOCO_GL": "no_such_backend"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert child.returncode == 1
    assert "MUJOCO_GL=no_such_backend does not render" in child.stderr
