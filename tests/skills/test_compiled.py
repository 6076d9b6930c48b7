"""Laws are stepped in one compiled loop; uncompiled they do the same to the last digits."""

import inspect
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import craftsim
from craftsim import Action, Grid, Machines, PhysicsWorld, SensorNoise, Sensors
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


def move():
    """Return how a move under noise ends, and where."""
    noise = SensorNoise(0.001, 0.003, min_delay_s=0.02, max_delay_s=0.04, encoder_lag_s=0.01)
    physics = PhysicsWorld(Grid.empty((2, 1, 1), n_cars=1), machines=Machines(drive="wheels"))
    sensors = Sensors(physics, noise, np.random.default_rng(0))
    done = Executor(physics, sensors=sensors, assumed=noise).run({0: Action.MOVE_RIGHT})[0]
    return [str(done), *physics.data.qpos[:4].tolist()]


def test_without_the_compiler_the_laws_give_the_same():
    names = "Action, Executor, Grid, Machines, PhysicsWorld, SensorNoise, Sensors"
    program = (
        f"import numpy as np\nfrom craftsim import {names}\n{inspect.getsource(move)}print(*move())"
    )
    plain = subprocess.run(
        [sys.executable, "-c", program],
        env={
            **os.environ,
            "PYTHONPATH": str(Path(craftsim.__file__).parents[1]),
            "NUMBA_DISABLE_JIT": "1",
        },
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    compiled = move()
    assert compiled[0] == plain[0] == "succeeded"
    # The hypotenuse of the C library and of Python differ in the last bit.
    np.testing.assert_allclose(np.array(plain[1:], float), compiled[1:], atol=1e-6)
