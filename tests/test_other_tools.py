"""What other tools read is as they define it: LeRobot's EnvHub, OpenEnv. Their own packages test it where they are."""

import importlib
import json
import runpy
import sys
import types
from contextlib import closing
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import yaml

from craftsim.envs.text_designs import chosen_rows
from craftsim.tasks import TASK_NAMES

EXAMPLES = Path(__file__).parents[1] / "examples"
OPENENV = EXAMPLES / "openenv"


@pytest.fixture
def hub(monkeypatch):
    monkeypatch.setenv("CRAFTSIM_BACKEND", "grid")
    return types.SimpleNamespace(**runpy.run_path(str(EXAMPLES / "envhub" / "env.py")))


def test_envhub_makes_a_batch_for_each_task_with_what_lerobot_looks_for(hub):
    suites = hub.make_env(n_envs=2, use_async_envs=False)
    assert list(suites) == ["craftsim"]
    assert list(suites["craftsim"]) == list(range(len(TASK_NAMES)))
    for batch in suites["craftsim"].values():
        with closing(batch):
            assert isinstance(batch, gymnasium.vector.VectorEnv)
            observations, _ = batch.reset(seed=[3, 4])
            assert list(observations) == ["environment_state"]
            assert observations["environment_state"].dtype == np.float32
            assert batch.call("_max_episode_steps")[0] > 0
            assert all(isinstance(text, str) for text in batch.call("task_description"))


def test_an_episode_of_envhub_ends_with_the_info_that_lerobot_counts(hub):
    (batch,) = hub.make_env(n_envs=2, cfg=types.SimpleNamespace(task="strip"))["craftsim"].values()
    rng = np.random.default_rng(0)
    with closing(batch):
        batch.reset(seed=[3, 4])
        for _ in range(batch.call("_max_episode_steps")[0]):
            actions = rng.uniform(-1, 1, batch.action_space.shape)
            *_, terminated, truncated, infos = batch.step(actions.astype(np.float32))
            if (terminated | truncated).any():
                break
        assert "is_success" in infos["final_info"]


def test_lerobot_itself_takes_the_environment(hub):
    utils = pytest.importorskip("lerobot.envs.utils")
    module = utils._load_module_from_path(str(EXAMPLES / "envhub" / "env.py"))
    made = utils._normalize_hub_result(utils._call_make_env(module, 2, False, None))
    observations, _ = made["craftsim"][0].reset(seed=[0, 1])
    assert utils.preprocess_observation(observations)["observation.environment_state"].shape[0] == 2


def test_the_manifest_of_openenv_names_what_there_is():
    manifest = yaml.safe_load((OPENENV / "openenv.yaml").read_text("utf-8"))
    assert (manifest["spec_version"], manifest["app"]) == (1, "server.app:app")
    assert (OPENENV / "server" / "app.py").is_file()
    assert f"EXPOSE {manifest['port']}" in (OPENENV / "server" / "Dockerfile").read_text("utf-8")


@pytest.fixture
def results(monkeypatch):
    monkeypatch.syspath_prepend(OPENENV)
    yield importlib.import_module("check_results")
    sys.modules.pop("check_results")


def test_the_stored_results_are_what_their_answers_lead_to(results, capsys, tmp_path):
    stored = results.read(OPENENV / "results.jsonl")
    assert [row["design"] for row in stored] == list(range(30))
    assert len(results.DESIGNS) == sum(map(len, chosen_rows().values())) == 30
    few = tmp_path / "results.jsonl"
    for row in (stored[0], stored[10]):
        results.add(few, row)
    assert results.main(few) == 0
    assert "random: 0 built in 2 episodes of 2 designs" in capsys.readouterr().out
    results.add(few, stored[0] | {"in_place": 1.0})
    assert results.main(few) == 1
    assert f"{few}:3: in_place is " in capsys.readouterr().out


def test_the_server_of_openenv_plays_an_episode_and_adds_its_row(results, monkeypatch, tmp_path):
    pytest.importorskip("openenv")
    monkeypatch.setenv("CRAFTSIM_RESULTS", str(tmp_path / "results.jsonl"))
    from models import Answer
    from server.app import Builders

    env = Builders()
    seen = env.reset(design=0, backend="grid", builder="mine")
    assert seen.instructions.startswith("You steer 2 cars")
    while not seen.done:
        seen = env.step(Answer(text="car_0: move right"))
    (row,) = map(json.loads, (tmp_path / "results.jsonl").read_text().splitlines())
    assert (row["builder"], row["turns"], env.state.score["turns"]) == ("mine", 20, 20)
    assert results.main(tmp_path / "results.jsonl") == 0
    with pytest.raises(ValueError, match="allowed: 0 to 29"):
        env.reset(design=30)
