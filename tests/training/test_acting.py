"""How a policy acts: greedily, or as often as it gives an action probability."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch import nn

from craftsim.cli import main
from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.tasks import make_task
from craftsim.envs import parallel_env
from craftsim.errors import InputError
from craftsim.training.config import ALGO_NAMES, TrainConfig
from craftsim.training.evaluation import choose_actions, evaluate
from craftsim.training.policy import load_policy
from craftsim.training.trainer import Trainer

DRAWS = 40_000


class _Fixed(nn.Module):
    """A network that rates actions alike whatever it sees."""

    encoder = SimpleNamespace(places=lambda observation: observation)

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
    Trainer(TrainConfig("random_strip", worlds=1, width=4, network="relative", acting="sampled")).save(folder)
    return folder


def _acts(policy):
    env = parallel_env("random_strip", "grid")
    observations, done = env.reset(seed=0)[0], []
    for _ in range(12):
        done.append(policy(observations))
        observations = env.step(done[-1])[0]
    return done


def test_what_a_sampling_policy_draws_is_its_seed_s(trained):
    first, again, other = (_acts(load_policy(trained, seed)) for seed in (1, 1, 2))
    assert first == again
    assert first != other


def test_a_greedy_policy_draws_nothing(tmp_path):
    Trainer(TrainConfig("random_strip", worlds=1, width=4, network="relative")).save(tmp_path)
    assert _acts(load_policy(tmp_path, 1)) == _acts(load_policy(tmp_path, 2))


def test_sampled_episodes_differ_where_greedy_ones_repeat_themselves():
    net, task = Trainer(TrainConfig("strip", worlds=1, width=8)).learner.net, make_task("strip")
    greedy, first, again = (
        evaluate(net, task, 30, 0, acting=acting) for acting in ("greedy", "sampled", "sampled")
    )
    assert greedy.trajectories < 10
    assert first.trajectories == 30
    assert first == again


@pytest.mark.parametrize("algo", ALGO_NAMES)
def test_only_probabilities_can_be_drawn_by(algo):
    if algo in ("ippo", "mappo", "coma"):
        assert TrainConfig("strip", algo, acting="sampled").acting == "sampled"
    else:
        with pytest.raises(InputError, match=f"{algo} rates actions by value.* acting must be greedy"):
            TrainConfig("strip", algo, acting="sampled")


def _evaluated(tmp_path, *words):
    code = main(["evaluate", *map(str, words), "--episodes", "20", "--out", str(tmp_path)])
    return code, json.loads((tmp_path / "report.json").read_text()) if code == 0 else None


def test_a_policy_is_evaluated_with_more_cars_in_another_task_of_its_area(trained, tmp_path):
    code, report = _evaluated(
        tmp_path, trained, "--task", "random_block", "--cars", 3, "--area", 4, 4, 3, "--acting", "greedy"
    )
    assert code == 0
    row = report["figures"]["evaluations"][0]
    assert (row["acting"], row["starts"]["distinct"]) == ("greedy", 20)
    assert report["config"] | {"cars": 3, "area": [4, 4, 3]} == report["config"]
    assert _evaluated(tmp_path, trained)[1]["figures"]["evaluations"][0]["acting"] == "sampled"


def test_another_area_is_refused(trained, tmp_path, capsys):
    assert _evaluated(tmp_path, trained, "--area", 5, 5, 3)[0] == 2
    assert "network is for" in capsys.readouterr().err
