"""Which drive cars have, by the door through which a world is made."""

from dataclasses import replace

import pytest

from craftsim.checking.setup import setup_of
from craftsim.envs import parallel_env
from craftsim.errors import InputError
from craftsim.mjcf.parameters import NOMINAL


def _setup(**options):
    env = parallel_env("strip", "physics", **options)
    env.reset(seed=0)
    return env.core.backend.setup


def test_environments_have_the_reduced_drive_unless_told_otherwise():
    assert (_setup().machines.drive, _setup().simulation.timestep_s) == ("reduced", 0.004)
    assert (_setup(drive="rollers").machines.drive, _setup(drive="rollers").simulation.timestep_s) == (
        "rollers",
        0.004,
    )
    assert _setup(machines=NOMINAL).machines.drive == "rollers"
    assert _setup(machines=NOMINAL, drive="reduced").machines.drive == "reduced"


def test_what_validates_has_rollers_unless_told_otherwise():
    assert setup_of().machines.drive == "rollers"
    reduced = setup_of(drive="reduced")
    assert (reduced.machines.drive, reduced.simulation.timestep_s) == ("reduced", 0.004)
    assert reduced.digests["machines"] != setup_of().digests["machines"]


def test_a_drive_that_there_is_not_is_one_message():
    with pytest.raises(InputError, match=r"Machines.drive: unknown value 'roller'; did you mean 'rollers'"):
        replace(NOMINAL, drive="roller")
    with pytest.raises(InputError, match="knows no 'drive'"):
        parallel_env("strip", "grid", drive="reduced")
