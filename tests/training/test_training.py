"""A run goes on as if it had never stopped; policies obey masks."""

import os
import signal
from dataclasses import replace

import numpy as np
import pytest
import torch
from platforms import platform

from craftsim.discrete.grid import Grid
from craftsim.discrete.tasks import as_task, make_task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.discrete.tasks.starts import save_starts
from craftsim.envs import parallel_env
from craftsim.errors import InputError
from craftsim.training.checkpoint import POLICY_FILE, RUN_FILE, RUN_FORMAT, read_policy
from craftsim.training.config import ALGO_NAMES, TrainConfig
from craftsim.training.policy import load_policy
from craftsim.training.starts import with_starts
from craftsim.training.trainer import Trainer


def _run(config, iterations):
    trainer = Trainer(config)
    _go_on(trainer, iterations)
    return trainer


def _go_on(trainer, iterations):
    steps = (trainer.iteration + iterations) * trainer.steps_an_iteration
    assert len(list(trainer.run(steps, until=2.0))) == iterations


def _same(first, second):
    return all(torch.equal(a, b) for a, b in zip(first.values(), second.values(), strict=True))


@pytest.mark.parametrize("algo", ALGO_NAMES)
def test_a_run_goes_on_as_if_it_had_never_stopped(algo, tmp_path):
    config = TrainConfig("strip", algo, seed=3, worlds=40, width=16, novelty=0.1)
    whole = _run(config, 2)
    part = _run(config, 1)
    start = {key: value.clone() for key, value in part.learner.net.state_dict().items()}
    part.save(tmp_path)
    resumed = Trainer.resume(tmp_path)
    assert resumed.iteration == 1
    _go_on(resumed, 1)
    assert not _same(resumed.learner.net.state_dict(), start)
    assert _same(resumed.learner.net.state_dict(), whole.learner.net.state_dict())


def test_another_seed_learns_something_else():
    first, second = (_run(TrainConfig("strip", seed=s, worlds=20, width=8), 1).learner.net for s in (0, 1))
    assert not _same(first.state_dict(), second.state_dict())


@pytest.mark.parametrize("algo", ["ippo", "vdn"])
def test_a_loaded_policy_obeys_masks_and_is_the_one_saved(algo, tmp_path):
    trainer = _run(TrainConfig("simple_two_story", algo, worlds=20, width=8), 1)
    trainer.save(tmp_path)
    assert _play(load_policy(tmp_path)) == _play(load_policy(tmp_path / POLICY_FILE))
    assert _same(read_policy(tmp_path / POLICY_FILE)[1].state_dict(), trainer.learner.net.state_dict())


def _play(policy):
    episodes = Episodes(make_task("simple_two_story"), np.random.default_rng(0), 1)
    told = []
    for _ in range(60):
        vectors, mask = episodes.vectors()[0], episodes.offered()[0].astype(np.int8)
        actions = policy(
            {f"car_{i}": {"observation": vectors[i], "action_mask": mask[i]} for i in range(len(mask))}
        )
        told.append([actions[f"car_{i}"] for i in range(len(mask))])
        assert all(mask[i, action] for i, action in enumerate(told[-1]))
        if episodes.step(np.array([told[-1]])).done[0]:
            episodes.reset()
    return told


def test_a_policy_refuses_the_observations_of_another_task(tmp_path):
    Trainer(TrainConfig("strip", worlds=1, width=4)).save(tmp_path)
    policy = load_policy(tmp_path)
    mask = np.ones(15, np.int8)
    with pytest.raises(InputError, match=r"trained on strip.*117 numbers, not 13"):
        policy({f"car_{i}": {"observation": np.zeros(13), "action_mask": mask} for i in range(2)})
    with pytest.raises(InputError, match="with the agents car_0, car_1"):
        policy({"car_0": {"observation": np.zeros(117), "action_mask": mask}})


def _blueprint(task, change):
    """Return a task like one of the six that differs in its only start file."""
    return replace(task, starts=(change(task.starts[0]),))


def test_a_policy_refuses_a_task_of_equal_observations_that_it_was_not_trained_for(tmp_path):
    strip = make_task("strip")
    Trainer(TrainConfig("strip", worlds=1, width=4)).save(tmp_path)
    policy = load_policy(tmp_path)
    turned = _blueprint(strip, lambda start: replace(start, objects=start.objects[::-1]))
    other_design = replace(strip, design=replace(strip.design, targets=strip.design.targets[:-1]))
    for task, words in ((turned, "start otherwise"), (other_design, "design is another")):
        env = parallel_env(task, "grid")
        observations, _ = env.reset(seed=0)
        with pytest.raises(InputError, match=f"trained on strip, and cannot play strip.*{words}"):
            policy(observations)
        with pytest.raises(InputError, match=words):
            policy.check_task(task)
    with pytest.raises(InputError, match="rule set is published, not physical"):
        policy.check_task("strip", "published")


def test_a_policy_plays_its_task_with_another_length_reward_name_or_file(tmp_path):
    strip = make_task("strip")
    Trainer(TrainConfig("strip", worlds=1, width=4)).save(tmp_path)
    policy = load_policy(tmp_path)
    moved = _blueprint(strip, lambda start: replace(start, path=tmp_path / "copy.yaml", notes=("a note",)))
    without_goal = replace(strip, name="copy", design=None)
    for task in (strip, make_task("strip", "complexity", max_steps=3), moved, without_goal):
        policy.check_task(task, "physical")
        env = parallel_env(task, "grid")
        observations, _ = env.reset(seed=0)
        assert set(policy(observations)) == {"car_0", "car_1"}


@pytest.mark.parametrize(("cars", "algo"), [(1, "ippo"), (3, "mappo"), (5, "qmix")])
def test_any_number_of_cars_is_trained(cars, algo, tmp_path):
    task = platform(cars)
    trainer = Trainer(TrainConfig("platform", algo, worlds=4, width=4), task=task)
    _go_on(trainer, 1)
    trainer.save(tmp_path)
    observations, _ = parallel_env(task, "grid").reset(seed=0)
    assert len(load_policy(tmp_path)(observations)) == cars


class _Evil:
    def __reduce__(self):
        return os.mkdir, ("owned",)


@pytest.mark.parametrize("content", [b"", b"no checkpoint", b"\xff" * 40], ids=["empty", "text", "long"])
def test_a_bad_policy_is_refused(content, tmp_path):
    (tmp_path / POLICY_FILE).write_bytes(content)
    with pytest.raises(InputError, match="not a file that 'craftsim train' wrote"):
        load_policy(tmp_path)


def test_a_run_file_with_code_in_it_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    torch.save({"craftsim": RUN_FORMAT, "head": "{}", "learner": _Evil()}, tmp_path / RUN_FILE)
    with pytest.raises(InputError, match="not a file that 'craftsim train' wrote"):
        Trainer.resume(tmp_path)
    assert not (tmp_path / "owned").exists()


def test_a_policy_of_an_earlier_version_is_refused_by_its_name(tmp_path):
    torch.save({"craftsim": 5, "kind": "policy"}, tmp_path / "policy.pt")
    for path in (tmp_path, tmp_path / "policy.pt"):
        with pytest.raises(InputError, match=r"policy\.pt: written by craftsim 0\.2 or older"):
            load_policy(path)


def test_a_ctrl_c_is_heard_between_two_iterations():
    trainer = Trainer(TrainConfig("strip", worlds=20, width=8))
    update = trainer.learner.update

    def interrupted(rollout):
        os.kill(os.getpid(), signal.SIGINT)
        update(rollout)

    trainer.learner.update = interrupted
    with pytest.raises(KeyboardInterrupt):
        next(trainer.run(10_000, until=2.0))
    assert trainer.iteration == 1


def test_starts_along_a_plan_and_from_a_file(tmp_path):
    task = make_task("strip")
    own = task.draw(np.random.default_rng(0))
    plan = tmp_path / "short.plan"
    plan.write_text("0 0 MOVE_RIGHT\n1 0 LIFT\n2 0 MOVE_RIGHT\n")
    along = with_starts(task, plan)
    drawn = [along.draw(np.random.default_rng(seed)) for seed in range(40)]
    own_drawn = sum(
        np.array_equal(grid.cars, own.cars) and np.array_equal(grid.kind, own.kind) for grid in drawn
    )
    assert 10 <= own_drawn <= 30
    assert {int(grid.cars[0, 0]) for grid in drawn} == {1, 2}  # never where the plan's last tick leads
    save_starts(tmp_path / "reached.npz", drawn[:1])
    assert with_starts(task, tmp_path / "reached.npz").draw(np.random.default_rng(0)).n_cars == 2


def test_a_task_that_varies_starts_half_of_its_episodes_with_worlds_of_a_file(tmp_path):
    task, path = as_task("random_strip"), tmp_path / "reached.npz"
    reached = task.draw(np.random.default_rng(5))
    save_starts(path, [reached])
    mixed = with_starts(task, path)
    assert mixed.layout == task.layout
    drawn = mixed.draw_starts(np.random.default_rng(0), 200)
    there = sum(drawn.grid(i).same_visible(reached) for i in range(200))
    assert 70 < there < 130
    assert np.array_equal(drawn.designs[0], task.draw_starts(np.random.default_rng(0), 1).designs[0])
    for name, file in (("designs", path), ("random_strip", tmp_path / "a.plan")):
        with pytest.raises(InputError, match="leave starts out"):
            with_starts(as_task(name), file)
    save_starts(path, [Grid.empty((3, 3, 1), n_cars=2)])
    with pytest.raises(InputError, match="the start has size"):
        with_starts(task, path)


def test_starts_of_a_file_stand_in_for_those_on_the_way_of_imitated_plans_and_are_known_again(tmp_path):
    task = as_task("random_strip")
    files = [tmp_path / f"{seed}.npz" for seed in range(2)]
    for seed, file in enumerate(files):
        save_starts(file, [task.draw(np.random.default_rng(seed))])
    one, other = (with_starts(task, file) for file in files)
    config = TrainConfig("random_strip", worlds=1, width=4, network="relative", imitate=2)
    trainer = Trainer(config, one)
    assert trainer.guidance.starts is one
    assert trainer.guidance.shown is not None
    trainer.save(tmp_path)
    assert Trainer.resume(tmp_path, one).starts == trainer.starts
    for starts in (other, None):
        with pytest.raises(InputError, match="begun with other starts"):
            Trainer.resume(tmp_path, starts)
