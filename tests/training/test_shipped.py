"""The policies that come with craftsim are small, play what they say, and are found by name."""

import pytest

from craftsim.discrete.tasks import as_task
from craftsim.errors import InputError
from craftsim.training.config import TrainConfig
from craftsim.training.evaluation import evaluate
from craftsim.training.policy import SHIPPED, load_policy, policy_file, shipped_policies
from craftsim.training.trainer import Trainer
from craftsim.validation.choice import policy_pilot, subjects_of
from craftsim.validation.policies import check_policy, make_policy, policy_digest


@pytest.mark.parametrize("name", shipped_policies())
def test_a_shipped_policy_builds_and_does_so_from_where_it_never_started(name):
    policy = load_policy(name)
    task = as_task(f"{name}@test" if policy.config.network == "relative" else name)
    policy.check_task(task)
    config = policy.config
    played = evaluate(policy.net, task, 100, 0, config.rules, config.helper_depth, config.acting)
    assert played.starts == (1 if name == "complex_two_story" else 100)
    assert played.success > 0.8
    assert (SHIPPED / f"{name}.safetensors").stat().st_size < 8e6


def test_a_name_is_a_shipped_policy_where_there_is_no_such_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    task = as_task("random_strip@test")
    assert make_policy("random_strip", 0, task).identity.name == "random_strip"
    assert policy_digest("random_strip") != policy_digest("random_simple_two_story")
    assert policy_file("random_strip") == SHIPPED / "random_strip.safetensors"
    (tmp_path / "random_block").mkdir()
    assert policy_file("random_block") == SHIPPED / "random_block.safetensors"
    pilot = policy_pilot("random_block", subjects_of(["random_block@test"]), "sequential")
    assert pilot.by == "random_block"
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
    Trainer(TrainConfig("strip", worlds=1, width=4, rules="published", helper_depth=3)).save(tmp_path)
    with pytest.raises(InputError, match="rule set is physical, not published"):
        check_policy(str(tmp_path), task, "physical", 60.0)
    with pytest.raises(
        InputError, match=r"an action helper of depth 3.*'craftsim validate --backend grid' plays it"
    ):
        check_policy(str(tmp_path), task, "published", 60.0)
    Trainer(TrainConfig("strip", worlds=1, width=4, rules="published")).save(tmp_path)
    check_policy(str(tmp_path), task, "published", 60.0)
