"""Policy and run files from people one does not know, seeds, and full disks: one message, and nothing lost."""

import os
import re
import resource
import subprocess
import sys
import zipfile

import numpy as np
import pytest
import torch
from learning.training_files import read_content, write_content
from safetensors.torch import save_file

from craftsim.errors import InputError
from craftsim.learning.checkpoint import ENCODER_TABLE, POLICY_FILE, ROWS, RUN_FILE, read_policy
from craftsim.learning.config import TrainConfig
from craftsim.learning.policy import load_policy
from craftsim.learning.starts import plans_of_arrays
from craftsim.learning.trainer import Trainer

CONFIG = TrainConfig("strip", "vdn", worlds=2, width=4)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    trainer = Trainer(CONFIG)
    next(trainer.run(trainer.steps_an_iteration, until=2.0))
    trainer.save(folder)
    return folder


def _change(path, *way_and_value):
    *way, last, value = way_and_value
    content = read_content(path)
    inner = content
    for key in way:
        inner = inner[key]
    inner[last] = value(inner[last]) if callable(value) else value
    return content


def _nan(tensor):
    return torch.full_like(tensor, torch.nan)


def _without_rows(tensors):
    return {name: tensor for name, tensor in tensors.items() if name != ROWS}


SIZE = ("head", "shape", "size")
POLICIES = {
    "another format": (("format", 5), "written in format 5, this version reads 6"),
    "nothing else": (("head", {}), "key 'config' is missing"),
    "too large a map": ((*SIZE, [128, 128, 20]), "the size is"),
    "no rows": (("tensors", _without_rows), "'encoder.table.rows' is missing or unknown"),
    "too many rows": (("tensors", ROWS, torch.arange(10**6)), r"is torch.int64 \(1000000,\); allowed"),
    "rows elsewhere": (("tensors", ROWS, lambda rows: rows + 10**6), "'encoder.table.rows' has numbers"),
    "rows twice": (("tensors", ROWS, torch.zeros_like), "not in order"),
    "other values": (("tensors", ENCODER_TABLE, lambda values: values[1:].clone()), "'encoder.table.weight' is"),
    "values that are none": (("tensors", ENCODER_TABLE, _nan), "'encoder.table.weight' has numbers"),
    "a list as value": (("head", "config", "seed", [3]), "key 'config.seed'"),
    "another shape": (("tensors", "encoder.car", torch.zeros(9, 4)), "'encoder.car' is"),
    "another type": (("tensors", "encoder.car", lambda car: car.double()), "'encoder.car' is torch.float64"),
    "a type of its own": (("tensors", "encoder.car", lambda car: car.bfloat16()), "not a file that"),
    "no numbers": (("tensors", "encoder.car", _nan), "not finite"),
    "other weights": (("tensors", {"a": torch.zeros(1)}), "missing or unknown"),
}  # fmt: skip


@pytest.mark.parametrize("name", POLICIES)
def test_a_policy_that_is_none_is_one_message(name, saved, tmp_path):
    path = tmp_path / POLICY_FILE
    write_content(path, _change(saved / POLICY_FILE, *POLICIES[name][0]))
    with pytest.raises(InputError, match=POLICIES[name][1]) as error:
        read_policy(path)
    assert str(error.value).startswith(str(path))


def test_a_policy_whose_map_was_changed_plays_nothing(saved, tmp_path):
    write_content(tmp_path / POLICY_FILE, _change(saved / POLICY_FILE, *SIZE, [20, 20, 3]))
    with pytest.raises(
        InputError, match="this policy is damaged: its network is for 20 x 20 x 3 cells"
    ):
        load_policy(tmp_path).check_task("strip")


def test_what_others_write_as_safetensors_is_no_policy(tmp_path):
    save_file({"a": torch.zeros(2)}, tmp_path / POLICY_FILE)
    with pytest.raises(InputError, match="not a policy file of 'craftsim train'"):
        read_policy(tmp_path / POLICY_FILE)
    (tmp_path / POLICY_FILE).write_bytes((10**7).to_bytes(8, "little") + b"{" * 10**7)
    with pytest.raises(InputError, match="not a file that"):
        read_policy(tmp_path / POLICY_FILE)


POINT = {"successes": 5, "mean_return": 0.0, "mean_ticks": 1.0}
T = "tensors"
RUNS = {
    "other weights": ((T, {}), "missing or unknown"),
    "the optimiser's averages": ((T, "optimizer.0.exp_avg_sq", lambda t: t - 1), "exp_avg_sq' has numbers"),
    "its steps": ((T, "optimizer.0.step", torch.tensor(-1.0)), "step' has numbers"),
    "averages of nothing": ((T, lambda t: t | {"optimizer.99.step": torch.tensor(1.0)}), "optimizer.99.step"),
    "what is remembered": ((T, "memory.actions", lambda t: t + 99), "'memory.actions' has numbers"),
    "what was seen": ((T, "memory.places", lambda t: t - 1), "'memory.places' has numbers"),
    "how much": ((T, "memory.total", torch.tensor(-1)), "'memory.total' has numbers"),
    "a curve of numbers": (("head", "curve", [1, 2]), r"key 'curve\[0\]'"),
    "a point of it": (
        (
            "head",
            "curve",
            [dict.fromkeys(("episodes", "steps", "starts", "solved", "trajectories"), 1) | POINT],
        ),
        "5 of 1 episodes",
    ),
    "a long curve": (("head", "curve", [0] * 30_000), "key 'curve"),
    "a count": (("head", "iteration", "seven"), "key 'iteration'"),
    "a time": (("head", "cpu_s", -1.0), "-1.0 s of CPU; allowed: 0 or more"),
    "an older file": (("format", "run 9"), "written in format run 9, this version reads run 10"),
    "a configuration": (("head", "config", "width", 10**9), "key 'config.width': 1000000000 is out of range"),
    "plans of nobody": ((T, lambda t: t | {"plans.lengths": torch.ones(9, dtype=torch.int32)}), "at most"),
    "novelty": ((T, "novelty", torch.zeros(5)), "'novelty' is missing or unknown"),
}  # fmt: skip


@pytest.mark.parametrize("name", RUNS)
def test_a_damaged_run_is_refused_before_it_goes_on(name, saved, tmp_path):
    write_content(tmp_path / RUN_FILE, _change(saved / RUN_FILE, *RUNS[name][0]))
    with pytest.raises(InputError, match=RUNS[name][1]) as error:
        Trainer.resume(tmp_path, config=CONFIG)
    assert str(error.value).startswith(str(tmp_path / RUN_FILE))


@pytest.mark.parametrize(
    ("lengths", "steps", "message"),
    [
        ([1, 1], [[2, 0, 0, 1]], "of no action of its plans"),
        ([1, 1], [[0, 1, 0, 1]], "of no action of its plans"),
        ([1, 1], [[0, 0, 9, 1]], "of no action of its plans"),
        ([1, 1], [[0, 0, 0, 99]], "of no action of its plans"),
        ([1, 1], [[-1, 0, 0, 1]], "of no action of its plans"),
        ([2**31 - 1, 2**31 - 1], [[0, 0, 0, 1]], "or more than 10 ticks together"),
        ([-1], [[0, 0, 0, 1]], "numbers below 0"),
        ([1, 1, 1], [[0, 0, 0, 1]], "at most (2,)"),
        ([1], [[0, 0, 0]], "allowed: int32 (m, 4)"),
    ],
)
def test_plans_of_a_run_that_are_none_are_refused(lengths, steps, message):
    arrays = {
        "plans.lengths": np.array(lengths, np.int32),
        "plans.steps": np.array(steps, np.int32),
    }
    with pytest.raises(InputError, match=re.escape(message)):
        plans_of_arrays(arrays, max_plans=2, n_cars=2)


def test_a_run_of_another_configuration_is_refused_before_its_task_is_made(saved, tmp_path):
    write_content(
        tmp_path / RUN_FILE,
        _change(saved / RUN_FILE, "head", "config", "task", "no_such_module:make"),
    )
    with pytest.raises(InputError, match="it was begun with"):
        Trainer.resume(tmp_path, config=CONFIG)


def _pickle(path, data):
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("archive/data.pkl", data)
        archive.writestr("archive/version", "3\n")


def test_what_is_no_policy_is_refused_before_torch_is_loaded(tmp_path):
    (tmp_path / "text").write_text("no policy")
    os.mkfifo(tmp_path / "pipe")
    _pickle(tmp_path / "old", b"N.")
    save_file({"a": torch.zeros(2)}, tmp_path / "other")
    code = (
        "import sys\nfrom pathlib import Path\nfrom craftsim.errors import InputError\n"
        "from craftsim.learning.checkpoint import read_policy\n"
        "for name in ('text', 'pipe', 'old', 'other', 'gone', '.'):\n"
        "    try:\n        read_policy(Path(sys.argv[1]) / name)\n"
        "    except InputError as error:\n        print(error)\n"
        "print('torch' in sys.modules)\n"
    )
    child = subprocess.run(
        [sys.executable, "-c", code, tmp_path], capture_output=True, text=True, check=True
    )
    *messages, loaded = child.stdout.splitlines()
    words = (
        "not a file that",
        "not a regular",
        "not a file that",
        "not a policy",
        "no such",
        "not a regular",
    )
    assert all(word in message for word, message in zip(words, messages, strict=True))
    assert loaded == "False"


def test_a_full_disk_is_one_message_and_leaves_what_was_there(saved, tmp_path):
    before = {name: (saved / name).read_bytes() for name in (POLICY_FILE, RUN_FILE)}
    for name, data in before.items():
        (tmp_path / name).write_bytes(data)
    trainer, limit = (
        Trainer.resume(tmp_path, config=CONFIG),
        resource.getrlimit(resource.RLIMIT_FSIZE),
    )
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limit[1]))
    try:
        with pytest.raises(
            InputError, match=r"run\.safetensors: cannot be written: File too large; make room"
        ):
            trainer.save(tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_long_run_goes_on(saved, tmp_path):
    trainer = Trainer.resume(saved, config=CONFIG)
    trainer.learner.rewards[:] = torch.tensor([1e8, 3e7, 2e7])
    trainer.save(tmp_path)
    assert Trainer.resume(tmp_path, config=CONFIG).learner.rewards.tolist() == [1e8, 3e7, 2e7]
