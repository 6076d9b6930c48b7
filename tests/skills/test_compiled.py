"""Skills are stepped in one compiled loop; a skill in Python and the uncompiled laws do the same to the last digits."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import craftsim
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.models.measuring import measurement_of, write_reading
from craftsim.models.sensing import measure
from craftsim.skills import library
from craftsim.skills.driving import Move, Rotate
from craftsim.skills.executor import Executor
from craftsim.skills.folding import Unfold
from craftsim.skills.gains import load_gains
from craftsim.skills.lifting import Lift
from craftsim.skills.outcome import Reason
from craftsim.skills.skill import Command, Skill

ACTIONS = {
    "move": (Action.MOVE_RIGHT, lambda setup: _in_python(Move)(setup, 0), []),
    "turn": (Action.ROTATE_LEFT, lambda setup: _in_python(Rotate)(setup, 1), []),
    "lift": (Action.LIFT, lambda setup: _in_python(Lift)(setup), [(Kind.BLOCK, (1, 1, 1))]),
    "unfold": (Action.UNFOLD, lambda setup: _in_python(Unfold)(setup), [(Kind.FSLOPE, (1, 1, 1), 2)]),
}


def _in_python(kind):
    """Return a subclass of a skill whose controller is its own."""

    class Own(kind):
        def _control(self, now):
            return super()._control(now)

    return Own


@pytest.mark.parametrize(("action", "own", "objects"), ACTIONS.values(), ids=ACTIONS)
def test_a_skill_that_is_stepped_in_python_does_what_the_compiled_loop_does(
    make_site, monkeypatch, action, own, objects
):
    def run():
        site = make_site((3, 3, 2), [(1, 1, 1, 0)], objects)
        executor = Executor(site)
        executor.begin(0, action)
        laws, ended = {int(executor._tasks[0]["law"])}, {}
        while not ended:
            ended = executor.advance()
        return laws, ended[0], site.data.qpos.copy()

    laws, outcome, qpos = run()
    monkeypatch.setitem(library.SKILLS, action, own)
    own_laws, own_outcome, own_qpos = run()
    assert laws.isdisjoint(own_laws)
    assert outcome.succeeded
    assert own_outcome == outcome
    np.testing.assert_array_equal(own_qpos, qpos)


class Nod(Skill):
    """Raise the board for a while; a skill of a user's own."""

    def _begin(self, now):
        self.seen = []

    def _control(self, now):
        self.seen.append(now)
        if self.elapsed_s > 0.2:
            self._fail(Reason.TIMEOUT, "enough")
        return Command(board=0.02)


def test_a_skill_of_ones_own_runs_beside_compiled_ones(make_site, monkeypatch):
    monkeypatch.setitem(library.SKILLS, Action.LIFT, Nod)
    site = make_site((3, 2, 1), [(0, 0, 1, 0), (0, 1, 1, 0)])
    executor = Executor(site, load_gains("fast"))
    outcomes = executor.run({0: Action.LIFT, 1: Action.MOVE_RIGHT})
    assert (outcomes[0].reason, outcomes[0].detail) == (Reason.TIMEOUT, "enough")
    assert outcomes[0].duration_s == pytest.approx(0.22)
    assert outcomes[1].succeeded
    assert 0.003 < measure(site, 0).board_m < 0.005


def test_a_skill_of_ones_own_is_stopped_on_nonsense(make_site, monkeypatch):
    monkeypatch.setitem(library.SKILLS, Action.LIFT, Nod)
    executor = Executor(make_site((1, 1, 1), [(0, 0, 1, 0)]))
    executor.begin(0, Action.LIFT)
    executor.advance()
    read = executor.fleet.read

    def nonsense():
        readings = read().copy()
        readings["pitch"] = np.nan
        return readings

    monkeypatch.setattr(executor.fleet, "read", nonsense)
    assert executor.advance()[0].reason is Reason.DIVERGED


@pytest.mark.parametrize("objects", [[], [(Kind.FSLOPE, (1, 1, 1), 2)]], ids=["alone", "docked"])
def test_a_measurement_survives_the_way_through_a_record(make_site, objects):
    executor = Executor(make_site((3, 3, 2), [(1, 1, 1, 0)], objects))
    now = executor._view(0)
    assert (now.slope is None) == (now.hinge_rad is None) == (not objects)
    readings = executor.fleet.read().copy()
    readings[:] = 7
    write_reading(now, readings)
    assert measurement_of(readings[0]) == now


PROGRAM = """
from craftsim import Action, Executor, Grid, SensorNoise, Sensors, Site
import numpy as np
noise = SensorNoise(0.001, 0.003, min_delay_s=0.02, max_delay_s=0.04, encoder_lag_s=0.01)
site = Site(Grid.empty((2, 1, 1), n_cars=1))
done = Executor(site, sensors=Sensors(site, noise, np.random.default_rng(0)), assumed=noise).run({0: Action.MOVE_RIGHT})
print(done[0], *site.data.qpos[:4].tolist())
"""


def test_without_the_compiler_the_laws_give_the_same():
    def run(**env):
        return subprocess.run(
            [sys.executable, "-c", PROGRAM],
            env={**os.environ, "PYTHONPATH": str(Path(craftsim.__file__).parents[1]), **env},
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()

    compiled, plain = run(NUMBA_DISABLE_JIT="0"), run(NUMBA_DISABLE_JIT="1")
    assert compiled[0] == plain[0] == "succeeded"
    # The hypotenuse of the C library and of Python differ in the last bit.
    np.testing.assert_allclose(np.array(plain[1:], float), np.array(compiled[1:], float), atol=1e-6)
