"""Policy and run files from people one does not know, seeds, and full disks: one message, and nothing lost."""

import io
import os
import resource
import subprocess
import sys
import zipfile

import pytest
import torch

from craftsim.cli import main
from craftsim.errors import InputError
from craftsim.training.checkpoint import FORMAT, POLICY_FILE, RUN_FILE, read_policy
from craftsim.training.config import TrainConfig
from craftsim.training.trainer import Trainer

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
    content = torch.load(path, weights_only=True)
    inner = content
    for key in way:
        inner = inner[key]
    inner[last] = value(inner[last]) if callable(value) else value
    return content


def _nan(tensor):
    return torch.full_like(tensor, torch.nan)


POLICIES = {
    "nothing else": (lambda path: {"craftsim": FORMAT, "kind": "policy"}, "config: Field required|key 'config'"),
    "only a kind": (lambda path: {"kind": "policy"}, "written in format None"),
    "a huge map": (lambda path: _change(path, "shape", "size", (128, 128, 8)), r"its table has \d+ places; allowed"),
    "a large map": (lambda path: _change(path, "shape", "size", (20, 20, 3)), r"its table has \d+ places; allowed"),
    "no table": (lambda path: _change(path, "table", {}), "its table has None places"),
    "no rows": (lambda path: _change(path, "table", "rows", None), "'rows' is NoneType"),
    "too many rows": (lambda path: _change(path, "table", "rows", torch.arange(10**6)), "its table has"),
    "rows elsewhere": (lambda path: _change(path, "table", "rows", lambda rows: rows + 10**6), "'rows' has numbers"),
    "rows twice": (lambda path: _change(path, "table", "rows", torch.zeros_like), "not in order"),
    "other values": (lambda path: _change(path, "table", "values", lambda values: values[1:]), "'values' is"),
    "values that are none": (lambda path: _change(path, "table", "values", _nan), "'values' has numbers"),
    "too large a map": (lambda path: _change(path, "shape", "size", (128, 128, 20)), "the size is"),
    "a tensor as value": (lambda path: _change(path, "config", "seed", torch.zeros(3)), "key 'config.seed'"),
    "another shape": (lambda path: _change(path, "net", "encoder.car", torch.zeros(9, 4)), "'encoder.car' is"),
    "no numbers": (lambda path: _change(path, "net", "encoder.car", _nan), "not finite"),
    "other weights": (lambda path: _change(path, "net", {"a": torch.zeros(1)}), "missing or unknown"),
    "gaps": (lambda path: _change(path, "net", "encoder.car", torch.zeros(1).expand(2, 4)), "with gaps"),
}  # fmt: skip


@pytest.mark.parametrize("name", POLICIES)
def test_a_policy_that_is_none_is_one_message(name, saved, tmp_path):
    path = tmp_path / POLICY_FILE
    torch.save(POLICIES[name][0](saved / POLICY_FILE), path)
    with pytest.raises(InputError, match=POLICIES[name][1]) as error:
        read_policy(path)
    assert str(error.value).startswith(str(path))


def _many_blocks(seen):
    return seen.index_fill(-1, torch.tensor([7]), 99)


POINT = {"successes": 5, "mean_return": 0.0, "mean_ticks": 1.0}
BUFFER = ("learner", "buffer", "_storage", "_storage")
RUNS = {
    "other weights": (("learner", "modules", {}), "missing or unknown"),
    "no modules": (("learner", {}), "no part 'modules'"),
    "the optimiser's averages": (("learner", "optimizer", "state", 0, "exp_avg_sq", lambda t: t - 1), "exp_avg_sq"),
    "its steps": (("learner", "optimizer", "state", 0, "step", torch.tensor(-1.0)), "'step' of the optimiser"),
    "its settings": (("learner", "optimizer", "param_groups", 0, "lr", 1e9), "a setting of the optimiser"),
    "what is remembered": ((*BUFFER, "agents.action", lambda t: t + 99), "what no tick has"),
    "what was seen": ((*BUFFER, "agents.observation", _many_blocks), "what no tick has"),
    "how much": (("learner", "buffer", "_storage", "_len", 10**9), "remembers 1000000000 ticks"),
    "where": (("learner", "buffer", "_writer", "_cursor", -1), "remembers"),
    "the part of random actions": (("learner", "epsilon", "eps", torch.tensor(7.0)), "the part of random actions"),
    "a curve of numbers": (("curve", [1, 2]), "key 'curve.0'"),
    "a point of it": (
        (
            "curve",
            [dict.fromkeys(("episodes", "steps", "starts", "solved", "trajectories"), 1) | POINT],
        ),
        "5 of 1 episodes",
    ),
    "a long curve": (("curve", [0] * 30_000), "30000 points"),
    "a count": (("iteration", "seven"), "key 'iteration'"),
    "a time": (("cpu_s", -1.0), "-1.0 s of CPU; allowed: 0 or more"),
    "an older file": (("craftsim", 5), "written in format 5, this version reads 6"),
    "a configuration": (("config", "width", 10**9), "width is 1000000000; allowed: 1 to 4096"),
    "novelty": (("novelty", torch.zeros(5)), "'novelty' is float32"),
}  # fmt: skip


@pytest.mark.parametrize("name", RUNS)
def test_a_damaged_run_is_refused_before_it_goes_on(name, saved, tmp_path):
    torch.save(_change(saved / RUN_FILE, *RUNS[name][0]), tmp_path / RUN_FILE)
    with pytest.raises(InputError, match=RUNS[name][1]) as error:
        Trainer.resume(tmp_path, config=CONFIG)
    assert str(error.value).startswith(str(tmp_path / RUN_FILE))


def test_a_run_of_another_configuration_is_refused_before_its_task_is_made(saved, tmp_path):
    torch.save(_change(saved / RUN_FILE, "config", "task", "no_such_module:make"), tmp_path / RUN_FILE)
    with pytest.raises(InputError, match="it was begun with"):
        Trainer.resume(tmp_path, config=CONFIG)


def _pickle(path, data):
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("archive/data.pkl", data)
        archive.writestr("archive/version", "3\n")


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"\x80\x02c__builtin__\nbytearray\nJ\xff\xff\xff\x7f\x85R.", "bytearray"),
        (b"\x80\x04\x96\xff\xff\xff\xff\x00\x00\x00\x00.", "expected|step"),
        (b"\x80\x02Nr\xff\xff\xff\x7f.", "object 2147483647"),
        (b"\x80\x02" + b"N0" * 300_000 + b".", "step POP"),
        (b"\x80\x02" + b"]" * 400_000 + b"N.", "nested|not a policy|data"),
        (b"\x80\x02]q\x00h\x00a.", "nested"),
    ],
    ids=["bytearray", "bytes", "memo", "pops", "lists", "cycle"],
)
def test_a_pickle_that_asks_for_much_gets_nothing(data, words, tmp_path):
    _pickle(tmp_path / POLICY_FILE, data)
    with pytest.raises(InputError, match=words):
        read_policy(tmp_path / POLICY_FILE)


def test_what_is_no_archive_is_refused_before_torch_is_loaded(tmp_path):
    (tmp_path / "text").write_text("no policy")
    os.mkfifo(tmp_path / "pipe")
    with zipfile.ZipFile(tmp_path / "packed", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data.pkl", b" " * 10**6)
    with zipfile.ZipFile(tmp_path / "many", "w") as archive:
        for number in range(3000):
            archive.writestr(f"archive/data/{number}", b"")
    code = (
        "import sys\nfrom pathlib import Path\nfrom craftsim.errors import InputError\n"
        "from craftsim.training.checkpoint import read_policy\n"
        "for name in ('text', 'pipe', 'packed', 'many', 'gone', '.'):\n"
        "    try:\n        read_policy(Path(sys.argv[1]) / name)\n"
        "    except InputError as error:\n        print(error)\n"
        "print('torch' in sys.modules)\n"
    )
    child = subprocess.run([sys.executable, "-c", code, tmp_path], capture_output=True, text=True, check=True)
    *messages, loaded = child.stdout.splitlines()
    words = ("not a file that", "not a regular", "compressed", "too many files", "no such", "not a regular")
    assert all(word in message for word, message in zip(words, messages, strict=True))
    assert loaded == "False"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--seed", str(2**64)], "seed is 18446744073709551616; allowed: 0 to 9223372036854775807"),
        (["--worlds", "1000000000"], "worlds is 1000000000; allowed: 1 to 100000"),
        (["--episodes", "0"], "--episodes is 0"),
        (["--steps", str(10**30)], "--steps is 1000"),
        (["--until", "nan"], "--until is nan"),
        (["--novelty", "inf"], "novelty is inf"),
    ],
)
def test_a_number_that_is_too_large_is_told(words, message, tmp_path, capsys):
    assert main(["train", "--out", str(tmp_path), *words]) == 2
    assert message in capsys.readouterr().err


def test_a_full_disk_is_one_message_and_leaves_what_was_there(saved, tmp_path):
    before = {name: (saved / name).read_bytes() for name in (POLICY_FILE, RUN_FILE)}
    for name, data in before.items():
        (tmp_path / name).write_bytes(data)
    trainer, limit = Trainer.resume(tmp_path, config=CONFIG), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limit[1]))
    try:
        with pytest.raises(InputError, match=r"policy\.pt: cannot be written: File too large; make room"):
            trainer.save(tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_what_torch_wrote_earlier_is_read(saved, tmp_path):
    content = torch.load(saved / POLICY_FILE, weights_only=True)
    file = io.BytesIO()
    torch.save(content, file)
    (tmp_path / POLICY_FILE).write_bytes(file.getvalue())
    net = read_policy(tmp_path / POLICY_FILE)[3]
    state = net.state_dict()
    assert torch.equal(
        state.pop("encoder.table.weight")[content["table"]["rows"]], content["table"]["values"]
    )
    assert all(torch.equal(tensor, content["net"][key]) for key, tensor in state.items())
