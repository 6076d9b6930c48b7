"""What it costs to have work done by other processes: a campaign's trials, and joint steps."""

import os
import time
from contextlib import closing
from importlib.util import find_spec

import numpy as np
import pytest

from craftsim.discrete.kinds import Action
from craftsim.envs.physics_vector import PhysicsVectorEnv
from craftsim.experiments.experiment import Experiment, Result, RunOptions, Trial
from craftsim.experiments.session import open_session
from craftsim.validation.validation import validate

FEW, MANY = 200, 1200
ENGINES = ["local", *(["ray"] if find_spec("ray") and "RAY_ADDRESS" in os.environ else [])]
"""Actors of Ray are measured where there is a cluster."""


def nothing(job):
    return Result(True)


@pytest.mark.benchmark(timer="processes")
@pytest.mark.parametrize("trials", [FEW, MANY])
@pytest.mark.parametrize("engine", ENGINES)
def test_a_campaign_of_empty_trials(benchmark, tmp_path, engine, trials):
    """CPU of all processes; the difference of both, over that of their trials, is what a trial costs."""
    items = [Trial(f"item {i}", "all", i, i) for i in range(trials)]
    experiment = Experiment("bench", 0, {}, items, nothing)

    def run():
        with open_session(experiment, tmp_path, RunOptions(engine=engine)) as session:
            session.run()

    benchmark.pedantic(run, rounds=1)


@pytest.mark.benchmark(timer=time.perf_counter)
@pytest.mark.parametrize("workers", [1, 2])
def test_building_a_strip_twelve_times(benchmark, tmp_path, workers):
    """By the clock, the start of the workers included."""
    benchmark.pedantic(
        validate,
        args=("strip",),
        kwargs={"randomize": "mild", "trials": 12, "workers": workers, "out": tmp_path},
        rounds=1,
    )


@pytest.mark.benchmark(timer="processes")
@pytest.mark.parametrize("engine", ENGINES)
def test_a_hundred_joint_steps(benchmark, engine):
    """All cars stand, so that little but handing over to one worker is done."""
    with closing(PhysicsVectorEnv("simple_two_story", 1, workers=1, engine=engine)) as envs:
        envs.reset(seed=0)
        still = np.full((1, 2), Action.STOP)
        benchmark.pedantic(
            lambda: [envs.step(still) for _ in range(100)], rounds=5, warmup_rounds=1
        )
