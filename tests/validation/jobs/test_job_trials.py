"""A quick sample of the tasks, built by many cars at once under noise and randomised physics."""

from dataclasses import replace

import pytest
from craftsim.validation.jobs import trials as job_trials
from craftsim.validation.jobs.job import read_job
from craftsim.validation.jobs.trials import JobTrial, do_job, items_of, run_job_trial

from craftsim.validation.campaign import Header, run_campaign


@pytest.mark.parametrize("task", ["strip", "simple_two_story"])
def test_a_task_reaches_its_goal_under_noise(task):
    record = run_job_trial(JobTrial(task, 11, "concurrent", noise=True))
    assert record.reached, record.failures
    assert record.agrees
    assert record.failures == ()
    # Three deviations of one localisation.
    assert record.car_error_m < 3e-3
    assert record.heading_error_rad < 9e-3
    assert record.placed_error_m < 5e-3


def test_without_noise_the_seed_changes_nothing_but_the_order_does():
    one, other = (run_job_trial(JobTrial("strip", seed, "concurrent", noise=False)) for seed in (0, 1))
    assert one == replace(other, trial=one.trial)
    sequential = run_job_trial(JobTrial("strip", 0, "sequential", noise=False))
    assert sequential.reached
    assert one.makespan_s < sequential.makespan_s


def test_records_are_equal_bit_for_bit_at_one_and_at_two_workers(tmp_path):
    items = items_of(["strip"], 2, 0, noise=True)[2:]
    header = Header("tasks", 0, {})
    alone, shared = (run_campaign(items, do_job, tmp_path / str(n), header, workers=n) for n in (1, 2))
    assert alone == shared
    one, other = (record["extra"] for record in alone)
    assert (one["trial"]["seed"], other["trial"]["seed"]) == (0, 1)
    assert one["makespan_s"] != other["makespan_s"] or one["car_error_m"] != other["car_error_m"]
    assert one["car_error_m"] == run_job_trial(JobTrial("strip", 0, "concurrent", noise=True)).car_error_m


def test_a_plan_that_does_not_build_the_goal_does_not_reach_it(monkeypatch):
    def short_job(task):
        job = read_job(task)
        return replace(job, plan=replace(job.plan, ticks=job.plan.ticks[:1]))

    monkeypatch.setattr(job_trials, "read_job", short_job)
    record = run_job_trial(JobTrial("strip", 0, "concurrent", noise=False))
    assert not record.reached
    assert not record.agrees
    assert record.failures == ()


def test_a_car_that_fails_is_named_with_the_steps_that_never_ran(monkeypatch):
    class Weak(job_trials.Executor):
        def __init__(self, site, *args, **kwargs):
            super().__init__(site, *args, **kwargs)
            site.model.actuator_forcerange[site.cars[0].wheel_actuators] = 0.0

    monkeypatch.setattr(job_trials, "Executor", Weak)
    record = run_job_trial(JobTrial("strip", 0, "concurrent", noise=False))
    assert not record.reached
    assert any(failure.startswith("car 0 MOVE") and "blocked" in failure for failure in record.failures)
    assert any(failure.startswith("not run: car 0") for failure in record.failures)
