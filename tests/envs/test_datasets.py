"""A dataset that Minari loads holds what was played, bit for bit, and is whole or not there."""

import json
import threading

import numpy as np
import pytest

from craftsim.cli import main
from craftsim.envs import parallel_env
from craftsim.envs.datasets import write_dataset
from craftsim.envs.planner import PlanPolicy
from craftsim.errors import InputError
from craftsim.planning.plan_file import read_plan
from craftsim.storage.folders import LOCK
from craftsim.tasks import TASK_NAMES, make_task
from craftsim.testing import random_policy

minari = pytest.importorskip("minari")
pytest.importorskip("h5py")

NAME = "craftsim/strip/test-v3"
EXPORT = ["validate", "strip", "--backend", "grid", "--record", "minari"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    return tmp_path


def _random(seed):
    return random_policy(np.random.default_rng(seed))


@pytest.mark.parametrize("backend", ["grid", "physics"])
def test_the_environment_that_a_dataset_names_plays_its_episodes_again(folder, backend):
    task = make_task("strip")
    episodes = 3 if backend == "grid" else 1
    written = write_dataset(parallel_env(task, backend), _random, folder, NAME, episodes, seed=7)
    dataset = minari.load_dataset(NAME)
    assert (dataset.total_episodes, dataset.total_steps) == (written.episodes, written.steps)
    env = dataset.recover_environment()
    assert env.unwrapped.core.options.backend == backend
    assert dataset.observation_space == env.observation_space
    assert dataset.action_space == env.action_space
    for number, episode in enumerate(dataset.iterate_episodes()):
        seen, info = env.reset(seed=7 + number)
        for step, action in enumerate([*episode.actions, None]):
            for key, value in episode.observations.items():
                np.testing.assert_array_equal(value[step], seen[key])
            for key in ("success", "duration_s", "illegal") if step else ():
                np.testing.assert_array_equal(episode.infos[key][step], info[key])
            if action is not None:
                seen, reward, ended, cut, info = env.step(action)
                told = episode.rewards[step], episode.terminations[step], episode.truncations[step]
                assert told == (reward, ended, cut)
        assert ended or cut
    env.close()


@pytest.mark.parametrize("task", TASK_NAMES)
def test_a_shipped_plan_builds_whatever_order_the_cars_act_in(folder, task):
    env = parallel_env(task, "grid")
    plan = read_plan(task, env.core.n_cars)
    written = write_dataset(env, lambda seed: PlanPolicy(env, plan), folder, NAME, 3)
    assert written.successes == 3
    assert minari.load_dataset(NAME)[0].infos["as_predicted"].all()


def test_a_task_that_a_name_does_not_say_names_no_environment(folder):
    write_dataset(parallel_env(make_task("strip", max_steps=3), "grid"), _random, folder, NAME, 1)
    assert minari.load_dataset(NAME).spec.env_spec is None


def test_a_policy_that_breaks_leaves_nothing_behind(folder):
    def breaks(seed):
        if seed == 1:
            raise RuntimeError("broken")
        return _random(seed)

    with pytest.raises(RuntimeError, match="broken"):
        write_dataset(parallel_env("strip", "grid"), breaks, folder, NAME, 2)
    assert not [path for path in folder.rglob("*") if path.is_file() or "test" in path.name]


def test_the_command_writes_what_loads_and_overwrites_nothing(folder, capsys):
    words = [*EXPORT, "--plan", "strip", "--trials", "2", "--out", str(folder)]
    assert main(words) == 0
    report = json.loads((folder / "craftsim/strip/plan-v0/report.json").read_text())
    assert (report["command"], report["figures"]["success"]["rate"]) == ("export", 1.0)
    assert minari.load_dataset("craftsim/strip/plan-v0").total_episodes == 2
    assert main(words) == 2
    assert "exists already; choose another name" in capsys.readouterr().err
    assert main([*words, "--policy", "random"]) == 2
    assert "give one of them" in capsys.readouterr().err
    for name in ("strip", "../strip-v0", "strip v0", "/strip-v0", "-v", ""):
        with pytest.raises(InputError, match="no name of a dataset"):
            write_dataset(parallel_env("strip", "grid"), _random, folder, name, 1)


@pytest.mark.parametrize("words", [[], ["--out", "sets"], ["--out", "sets/inner/../../sets"]])
def test_the_folder_may_be_relative(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main([*EXPORT, "--policy", "random", "--trials", "1", *words]) == 0
    folder = tmp_path / (words[-1] if words else "out/dataset")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder))
    assert minari.load_dataset("craftsim/strip/random-v0").total_episodes == 1
    assert sorted(path.name for path in (folder / "craftsim/strip/random-v0").iterdir()) == [
        "data",
        "report.json",
    ]


def test_what_a_kill_leaves_of_a_dataset_is_gone_with_the_next_and_no_link_there_is_followed(folder):
    victim = folder / "victim"
    victim.mkdir()
    (victim / "precious").touch()
    for name in (NAME, "left-v0"):
        (folder / name).mkdir(parents=True)
    (folder / NAME / ".partial-data").symlink_to(victim)
    (folder / NAME).with_name(".partial-test-v3").symlink_to(victim)
    (folder / "left-v0/.partial-data").mkdir()
    (folder / "left-v0/.partial-data/main_data.hdf5").write_text("half")
    (folder / "left-v0" / LOCK).touch()
    for name in (NAME, "left-v0"):
        write_dataset(parallel_env("strip", "grid"), _random, folder, name, 1)
        assert minari.load_dataset(name).total_episodes == 1
        assert [path.name for path in (folder / name).iterdir()] == ["data"]
    assert [path.name for path in victim.iterdir()] == ["precious"]


def test_without_minari_the_command_says_how_to_get_it(folder, capsys, monkeypatch):
    monkeypatch.setattr("craftsim.storage.extras.find_spec", lambda name: None)
    assert main([*EXPORT, "--out", str(folder)]) == 2
    assert "-m pip install 'minari[hdf5]>=" in capsys.readouterr().err


def test_a_second_export_of_a_name_is_refused_and_the_first_loses_nothing(folder, capsys):
    words = [*EXPORT, "--dataset", NAME, "--policy", "random", "--trials", "1", "--out", str(folder)]
    statuses = []

    def meanwhile(seed):
        if seed == 1:
            # As another process would: who owns a folder in this thread may own it again.
            second = threading.Thread(target=lambda: statuses.append(main(words)))
            second.start()
            second.join()
        return _random(seed)

    write_dataset(parallel_env("strip", "grid"), meanwhile, folder, NAME, 3)
    assert statuses == [2]
    assert "is in use: another craftsim writes into it" in capsys.readouterr().err
    assert minari.load_dataset(NAME).total_episodes == 3
    assert [path.name for path in (folder / NAME).iterdir()] == ["data"]
