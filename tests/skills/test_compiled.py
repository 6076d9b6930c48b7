"""Laws are stepped in one compiled loop; uncompiled they do the same to the last digits."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import craftsim
from craftsim.discrete.grid import Kind
from craftsim.models.measuring import write_reading
from craftsim.models.sensing import measurement_of
from craftsim.skills.executor import Executor


@pytest.mark.parametrize("objects", [[], [(Kind.FSLOPE, (1, 1, 1), 2)]], ids=["alone", "docked"])
def test_a_measurement_survives_the_way_through_a_record(make_site, objects):
    executor = Executor(make_site((3, 3, 2), [(1, 1, 1, 0)], objects))
    now = measurement_of(executor.readings()[0])
    assert (now.slope is None) == (now.hinge_rad is None) == (not objects)
    readings = executor.fleet.read().copy()
    readings[:] = 7
    write_reading(now, readings)
    assert measurement_of(readings[0]) == now


PROGRAM = """
from craftsim import Action, Executor, Grid, Machines, SensorNoise, Sensors, PhysicsWorld
import numpy as np
noise = SensorNoise(0.001, 0.003, min_delay_s=0.02, max_delay_s=0.04, encoder_lag_s=0.01)
site = PhysicsWorld(Grid.empty((2, 1, 1), n_cars=1), machines=Machines(drive="reduced"))
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
