"""Policies: how they act, what they refuse, the shipped ones, and what an evaluation counts."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch import nn

import craftsim
from craftsim.cli import main
from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.learned import LearnedRules
from craftsim.envs import parallel_env
from craftsim.errors import InputError
from craftsim.learning.checkpoint import POLICY_FILE, read_policy, save_policy
from craftsim.learning.config import TrainConfig
from craftsim.learning.curve import EvaluationResult
from craftsim.learning.evaluation import Tally, Tried, choose_actions, evaluate
from craftsim.learning.features import Features
from craftsim.learning.policies import check_policy, make_policy, policy_digest
from craftsim.learning.policy import load_policy
from craftsim.learning.policy_files import SHIPPED_POLICIES, policy_file, shipped_policies
from craftsim.learning.trainer import Trainer
from craftsim.tasks import as_task, make_task
from craftsim.validation.sources import policy_source, rollout_worlds

DRAWS = 40_000


class _Fixed(nn.Module):
    """A network that rates actions alike whatever it sees."""

    encoder = SimpleNamespace(
        ticks=0, look=lambda seen, masks: Features(seen, torch.from_numpy(masks))
    )

    def __init__(self, values):
        super().__init__()
        self.rates = values

    def forward(self, seen, memory):
        return self.rates.expand(seen.offers.shape).masked_fill(~seen.offers, -torch.inf)


def test_with_noise_actions_come_as_often_as_their_probabilities_say():
    values = torch.linspace(-2, 2, N_ACTIONS)
    offered = np.ones((1, N_ACTIONS), np.bool_)
    offered[0, [3, 14]] = False
    seen, masks = np.zeros((DRAWS, 1, 13)), np.repeat(offered[None], DRAWS, 0)
    noise = np.random.default_rng(0).gumbel(size=masks.shape)
    chosen = choose_actions(_Fixed(values), seen, masks, noise)
    expected = values.masked_fill(~torch.from_numpy(offered[0]), -torch.inf).softmax(-1).numpy()
    found = np.bincount(chosen[:, 0], minlength=N_ACTIONS) / DRAWS
    assert not found[[3, 14]].any()
    assert np.abs(found - expected).max() < 5 * np.sqrt(0.25 / DRAWS)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    Trainer(
        TrainConfig("random_strip", worlds=1, width=4, network="relative", acting="sampled")
    ).save(folder)
    return folder


def _acts(policy):
    env = parallel_env("random_strip", "grid")
    observations, done = env.reset(seed=0)[0], []
    for _ in range(12):
        done.append(policy(observations))
        assert all(observations[agent]["action_mask"][action] for agent, action in done[-1].items())
        observations = env.step(done[-1])[0]
    return done


def test_what_a_sampling_policy_draws_is_its_seed_s_and_a_greedy_one_draws_nothing(
    trained, tmp_path
):
    first, again, other = (_acts(load_policy(trained, seed)) for seed in (1, 1, 2))
    assert first == again != other
    Trainer(TrainConfig("random_strip", worlds=1, width=4, network="relative")).save(tmp_path)
    assert _acts(load_policy(tmp_path, 1)) == _acts(load_policy(tmp_path / POLICY_FILE, 2))


def test_sampled_episodes_differ_where_greedy_ones_repeat_themselves():
    net, task = Trainer(TrainConfig("strip", worlds=1, width=8)).learner.net, make_task("strip")
    greedy, first, again = (
        evaluate(net, task, 30, 0, acting=acting) for acting in ("greedy", "sampled", "sampled")
    )
    assert greedy.trajectories < 10
    assert first.trajectories == 30
    assert first == again


def test_what_was_done_in_a_situation_is_rated_lower_when_it_comes_again():
    values = torch.linspace(0, 7, N_ACTIONS)  # each half a unit above the one before
    two_cars = np.zeros((1, 2, 3 * 13), np.int64)
    two_cars[0, :, 0] = 1, 2
    elsewhere, other_moved, masks = (
        two_cars.copy(),
        two_cars.copy(),
        np.ones((1, 2, N_ACTIONS), np.bool_),
    )
    elsewhere[0, 1, 0] = 3
    other_moved[0, 0, 13] = 9  # what the first car sees of the second
    tried = Tried()
    chosen = [
        choose_actions(_Fixed(values), seen, masks, tried=tried)[0].tolist()
        for seen in (two_cars, two_cars, elsewhere, other_moved, two_cars)
    ]
    best = N_ACTIONS - 1
    # VARIED is six such units: after the best come the next five, which are all that is better by then.
    assert chosen == [
        [best, best],
        [best - 1] * 2,
        [best - 2, best],
        [best - 3, best - 2],
        [best - 4, best - 3],
    ]


def test_of_some_episodes_what_was_done_is_kept():
    values, masks = torch.linspace(0, 7, N_ACTIONS), np.ones((2, 1, N_ACTIONS), np.bool_)
    seen, tried = np.arange(2 * 26).reshape(2, 1, 26), Tried()
    choose_actions(_Fixed(values), seen, masks, tried=tried)
    tried.keep(np.array([False, True]))
    assert tried.counts(seen[1:])[0, 0].tolist() == [0] * (N_ACTIONS - 1) + [1]
    assert choose_actions(_Fixed(values), seen[:1], masks[:1], tried=Tried()) == N_ACTIONS - 1


def test_a_varied_policy_repeats_itself_from_episode_to_episode_and_never_stands_still(
    trained, tmp_path
):
    head, net = read_policy(policy_file(trained))
    save_policy(
        tmp_path / POLICY_FILE, replace(head, config=replace(head.config, acting="varied")), net
    )
    policy = load_policy(tmp_path)
    first, again = _acts(policy), _acts(policy)
    assert first == again
    net, task = load_policy("random_strip").net, as_task("random_strip@test")
    greedy, varied = (
        evaluate(net, task, 300, 0, acting=acting).success for acting in ("greedy", "varied")
    )
    assert greedy < varied


def _evaluated(tmp_path, *words):
    code = main(
        [
            "validate",
            *map(str, words),
            "--backend",
            "grid",
            "--trials",
            "20",
            "--out",
            str(tmp_path),
        ]
    )
    return code, json.loads((tmp_path / "report.json").read_text()) if code == 0 else None


def test_a_policy_is_evaluated_with_more_cars_in_another_task_of_its_area(
    trained, tmp_path, capsys
):
    code, report = _evaluated(
        tmp_path,
        "random_block",
        "--policy",
        trained,
        "--cars",
        3,
        "--area",
        4,
        4,
        3,
        "--acting",
        "greedy",
    )
    assert code == 0
    row = report["figures"]["evaluations"][0]
    assert (row["acting"], row["starts"]["distinct"]) == ("greedy", 20)
    assert report["config"] | {"cars": 3, "area": [4, 4, 3]} == report["config"]
    assert (
        _evaluated(tmp_path, "--policy", trained)[1]["figures"]["evaluations"][0]["acting"]
        == "sampled"
    )
    assert _evaluated(tmp_path, "--policy", trained, "--area", 5, 5, 3)[0] == 2
    assert "network is for" in capsys.readouterr().err


ALL = np.arange(4)


def _seen(*numbers):
    return np.array(numbers)[:, None, None]


def test_a_start_and_a_trajectory_count_once_and_another_design_is_another_start():
    for won, solved in (([1, 1, 0, 1], 1), ([1, 1, 1, 0], 1), ([1, 1, 1, 1], 2)):
        tally = Tally(np.zeros((4, 0, 5), np.int64))
        tally.add(ALL, _seen(1, 1, 1, 2), _seen(5, 5, 6, 5))
        tally.add(ALL[:3], _seen(3, 3, 3), _seen(7, 7, 7))
        tally.count(ALL, np.zeros(4), np.array(won, bool))
        found = tally.result()
        assert (found.solved, found.starts, found.trajectories, found.mean_ticks) == (
            solved,
            2,
            3,
            1.75,
        )
    tally = Tally(np.array([[[0] * 5]] * 3 + [[[1] * 5]]))
    tally.add(ALL, _seen(1, 1, 1, 1), _seen(2, 2, 2, 2))
    assert tally.result().starts == 2


def test_one_start_has_no_interval():
    assert EvaluationResult(1000, 1000, 1.0, 1.0, 1, 1, 1).interval is None
    low, high = EvaluationResult(1000, 1000, 1.0, 1.0, 1000, 1000, 1000).interval
    assert 0.995 < low < high == pytest.approx(1.0)


def test_held_out_starts_are_each_played_once():
    trainer = Trainer(TrainConfig("random_strip@test", worlds=10, width=16))
    played = trainer.evaluate(1000)
    assert (played.starts, played.episodes) == (1000, 1000)
    assert trainer.evaluate(1500).starts == 1000


@pytest.fixture(scope="module")
def strip(tmp_path_factory):
    folder = tmp_path_factory.mktemp("strip")
    Trainer(TrainConfig("strip", worlds=1, width=4)).save(folder)
    return folder


def test_a_policy_refuses_the_observations_of_another_task(strip):
    policy = load_policy(strip)
    mask = np.ones(15, np.int8)
    with pytest.raises(InputError, match=r"trained on strip.*117 numbers, not 13"):
        policy({f"car_{i}": {"observation": np.zeros(13), "action_mask": mask} for i in range(2)})
    with pytest.raises(InputError, match="with the agents car_0, car_1"):
        policy({"car_0": {"observation": np.zeros(117), "action_mask": mask}})


def _blueprint(task, change):
    """Return a task like one of the six that differs in its only start file."""
    return replace(task, starts=(change(task.starts[0]),))


def test_a_policy_refuses_a_task_of_equal_observations_that_it_was_not_trained_for(strip):
    policy, strip = load_policy(strip), make_task("strip")
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


def test_a_policy_plays_its_task_with_another_length_reward_name_or_file(strip, tmp_path):
    policy, strip = load_policy(strip), make_task("strip")
    moved = _blueprint(
        strip, lambda start: replace(start, path=tmp_path / "copy.yaml", notes=("a note",))
    )
    without_goal = replace(strip, name="copy", design=None)
    for task in (strip, make_task("strip", "complexity", max_steps=3), moved, without_goal):
        policy.check_task(task, "physical")
        env = parallel_env(task, "grid")
        observations, _ = env.reset(seed=0)
        assert set(policy(observations)) == {"car_0", "car_1"}


def test_a_policy_that_looks_from_a_car_plays_other_tasks_that_show_their_design(
    tmp_path, monkeypatch
):
    monkeypatch.setattr("craftsim.designs.tasks.POOL", 10)
    trainer = Trainer(TrainConfig("designs", worlds=1, width=4, network="relative"))
    trainer.save(tmp_path)
    policy = load_policy(tmp_path)
    env = craftsim.parallel_env("designs", "grid", n_cars=3)
    assert set(policy(env.reset(seed=0)[0])) == {"car_0", "car_1", "car_2"}
    policy.check_task(as_task("random_strip", area=(6, 6, 2)))
    with pytest.raises(InputError, match="cannot play strip"):
        policy.check_task("strip")
    with pytest.raises(InputError, match="cannot play random_strip: its worlds start otherwise"):
        policy.check_task("random_strip")
    expected = (
        "its rule set is published, not physical; give its own with --rules physical, or train"
    )
    with pytest.raises(InputError, match=expected):
        policy.check_task("designs@test", "published")


def test_a_policy_of_learned_rules_asks_for_their_file(tmp_path):
    rules = LearnedRules("mine", "physical")
    Trainer(TrainConfig("strip", worlds=1, width=4, rules=rules)).save(tmp_path)
    policy = load_policy(tmp_path)
    policy.check_task("strip", rules)
    with pytest.raises(
        InputError, match=r"not mine \(0 learned.*give its own with --rules FILE, or"
    ):
        policy.check_task("strip", "physical")


@pytest.mark.parametrize("name", shipped_policies())
def test_a_shipped_policy_builds_and_does_so_from_where_it_never_started(name):
    policy = load_policy(name)
    task = as_task(f"{name}@test" if policy.config.network == "relative" else name)
    policy.check_task(task)
    config = policy.config
    played = evaluate(policy.net, task, 60, 0, config.rules, config.helper_depth, config.acting)
    assert played.starts == (1 if name == "complex_two_story" else 60)
    assert played.success > 0.8
    assert (SHIPPED_POLICIES / f"{name}.safetensors").stat().st_size < 8e6


def test_a_name_is_a_shipped_policy_where_there_is_no_such_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    task = as_task("random_strip@test")
    assert make_policy("random_strip", 0, task).identity.name == "random_strip"
    assert policy_digest("random_strip") != policy_digest("random_simple_two_story")
    assert policy_file("random_strip") == SHIPPED_POLICIES / "random_strip.safetensors"
    (tmp_path / "random_block").mkdir()
    assert policy_file("random_block") == SHIPPED_POLICIES / "random_block.safetensors"
    source = policy_source("random_block", rollout_worlds(["random_block@test"]))
    assert source.behaviour == "random_block"
    (tmp_path / "random_block" / "policy.safetensors").write_text("no policy")
    with pytest.raises(InputError, match="not a file that"):
        make_policy("random_block", 0, task)
    (tmp_path / "random_strip").write_text("no policy")
    with pytest.raises(InputError, match="not a file that"):
        make_policy("random_strip", 0, task)


def test_a_policy_that_is_none_is_named_with_those_that_are_shipped():
    with pytest.raises(InputError, match=r"or a shipped one: .*random_strip"):
        make_policy("random_stripe", 0)


def test_a_policy_is_not_validated_under_what_it_was_not_trained_for(tmp_path):
    task = as_task("strip")
    Trainer(TrainConfig("strip", worlds=1, width=4, rules="published", helper_depth=3)).save(
        tmp_path
    )
    with pytest.raises(InputError, match="rule set is physical, not published"):
        check_policy(str(tmp_path), task, "physical", 60.0)
    with pytest.raises(
        InputError,
        match=r"an action helper of depth 3.*'craftsim validate --backend grid' plays it",
    ):
        check_policy(str(tmp_path), task, "published", 60.0)
    Trainer(TrainConfig("strip", worlds=1, width=4, rules="published")).save(tmp_path)
    check_policy(str(tmp_path), task, "published", 60.0)
