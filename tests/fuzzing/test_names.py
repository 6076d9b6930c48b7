"""Nothing that a data file names is imported: in every format each word in turn is replaced by the name of code.

``module:factory`` and ``module:function`` are for the command line and for Python alone. A case is a file that is as it
should be but for one word, which names a module of the working folder. That module leaves a mark when it is imported,
in whatever process.
"""

import contextlib
import io
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from bags import write_bag
from sessions import put
from training_files import read_content, write_content

from craftsim.checking.setup import Setup
from craftsim.cli import main
from craftsim.discrete.tasks import as_task, make_task
from craftsim.discrete.tasks.starts import save_starts
from craftsim.errors import InputError
from craftsim.experiments.bundle import TEXT, read_bundle
from craftsim.experiments.durations import read_durations
from craftsim.experiments.experiment import RunOptions
from craftsim.experiments.records import DATABASE, OLD, TRIALS, read_finished
from craftsim.experiments.session import open_session
from craftsim.logs.files import read_logs, write_table
from craftsim.logs.log import GROUPS, Log
from craftsim.rendering.camera_files import read_aim
from craftsim.rendering.trajectory import Trajectory
from craftsim.training.checkpoint import POLICY_FILE, RUN_FILE
from craftsim.training.config import TrainConfig
from craftsim.training.trainer import Trainer
from craftsim.validation.forms import RUNS
from craftsim.validation.runs.once import record_once
from fuzzing import campaign_folders, replays, words

NAME = "planted_module:make"
MODULE = """\
from pathlib import Path

Path(__file__).with_name("imported").touch()


def make(*given):
    from craftsim.discrete.tasks import make_task

    return make_task("strip")
"""
CONFIG = TrainConfig("strip", worlds=2, width=4)
SMALL = ["--worlds", "2", "--width", "4", "--steps", "1", "--episodes", "1"]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Return a working folder with a module in it, which this process and those that it starts could import."""
    (tmp_path / "planted_module.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    yield tmp_path
    sys.modules.pop("planted_module", None)


def _run(*words: str) -> int:
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        return main(words)


def _read(read, *given) -> None:
    with contextlib.suppress(InputError):
        read(*given)


def _imported(place: Path) -> bool:
    return (place / "imported").exists()


def _documents(document) -> Iterator[object]:
    """Yield a document of plain values, each time with another of its texts, or empty lists, replaced."""
    for holder, key in list(_places(document)):
        before = holder[key]
        holder[key] = NAME if isinstance(before, str) else [NAME]
        yield document
        holder[key] = before


def _places(node) -> Iterator[tuple[object, object]]:
    for key, value in node.items() if isinstance(node, dict) else enumerate(node):
        if isinstance(value, str) or value in ((), []):
            yield node, key
        elif isinstance(value, dict | list):
            yield from _places(value)


def _texts(text: str, quote: str = "") -> Iterator[str]:
    """Yield a text, each time with another of its words replaced, and with all of them."""
    found = list(re.finditer(r"[A-Za-z_][\w@.]*(?!\w*:)", text))
    for one in found:
        yield text[: one.start()] + quote + NAME + quote + text[one.end() :]


def test_the_command_line_and_python_import_what_they_name(place):
    """What the tests below look for can be seen."""
    assert _run("evaluate", "random_strip", "--task", NAME, "--episodes", "1") in (0, 2)
    assert _imported(place)
    (place / "imported").unlink()
    del sys.modules["planted_module"]
    assert as_task(NAME).name == "strip"
    assert _imported(place)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Return the files of a short training run."""
    folder = tmp_path_factory.mktemp("run")
    trainer = Trainer(CONFIG)
    next(trainer.run(trainer.steps_an_iteration, until=2.0))
    trainer.save(folder)
    return folder


def _archives(file: Path) -> Iterator[object]:
    content = read_content(file)
    head = content["head"]
    head["config"]["stages"] = []
    for _ in _documents(head):
        head["config"]["stage_steps"] = 5 if head["config"]["stages"] else 0
        yield content


def test_a_policy_file_is_evaluated_begun_with_and_exported(place, saved):
    for number, content in enumerate(_archives(saved / POLICY_FILE)):
        write_content(place / "p.safetensors", content)
        status = _run("evaluate", "p.safetensors", "--episodes", "1")
        config = content["head"]["config"]
        assert status == 2 or config["task"] == "strip"
        assert not _imported(place), config
        if number < 2 or NAME in str(config):
            _run("export", "strip", "--policy", "p.safetensors", "--episodes", "1", "--out", str(place / "m"))
            _run("train", "--pretrained", "p.safetensors", *SMALL, "--out", f"t{number}")
            _run("validate", "strip", "--policy", "p.safetensors", "--trials", "1", "--timeout", "0.01")
            assert not _imported(place), config


def test_a_run_goes_on(place, saved):
    for content in _archives(saved / RUN_FILE):
        write_content(place / RUN_FILE, content)
        _read(Trainer.resume, place)
        if NAME in str(content["head"]["config"]):
            _run("train", *SMALL, "--resume", "--out", str(place))
        assert not _imported(place), content["head"]["config"]


STUDY = """\
title: some words
tasks: [strip]
algos: [ippo]
preset: paper
seeds: 1
steps: 1
episodes: 1
settings: {worlds: 2, width: 4, network: map, pretrained: x, stages: [strip], stage_steps: 5, acting: greedy}
of_tasks: {strip: {rules: physical, backend: grid, drive: rollers, randomize: none, hyperparameters: {gamma: 1}}}
tests: {strip: [strip]}
reference: {strip: 0.5}
"""


def test_a_study_runs(place):
    given = STUDY.replace("pretrained: x, ", "")
    for text in [*_texts(STUDY, '"'), *_texts(given, '"'), given.replace("strip", f'"{NAME}"')]:
        Path("s.yaml").write_text(text)
        if text.count(NAME) > 1 or _names_tasks(text):
            assert _run("study", "s.yaml", "--out", "study", "--timeout", "60") == 2
        else:
            from craftsim.studies.study import read_study

            _read(read_study, "s.yaml")
        assert not _imported(place), text


def _names_tasks(text: str) -> bool:
    return any(f'{key}: ["{NAME}"]' in text for key in ("tasks", "stages", "strip"))


def test_a_run_goes_on_and_is_compared_with(place):
    data, manifest, lines = campaign_folders.valid()
    first, *_ = records = lines.decode().splitlines()
    for document in [*_documents(json.loads(first)), *_documents(json.loads(manifest))]:
        changed = json.dumps(document)
        is_manifest = "command" in document
        (place / DATABASE).write_bytes(data)
        put(place, 0, first if is_manifest else changed, changed if is_manifest else None)
        _read(read_finished, place, "validate", RUNS)
        _read(_resume, place)
        assert not _imported(place), document
        (place / DATABASE).unlink()
        (place / OLD).write_text(changed if is_manifest else manifest.decode())
        (place / TRIALS).write_text("\n".join(records if is_manifest else [changed, *records[1:]]) + "\n")
        _read(read_finished, place, "validate", RUNS)
        (place / OLD).unlink()
        (place / TRIALS).unlink()
        assert not _imported(place), document


def _resume(place: Path) -> None:
    with open_session(campaign_folders.EXPERIMENT, place, RunOptions(resume=True)):
        pass


def test_a_bundle_is_replayed(place):
    for name, data in replays.bundle_files().items():
        Path(name).write_bytes(data)
    for document in _documents(json.loads(replays.bundle_files()[TEXT])):
        Path(TEXT).write_text(json.dumps(document))
        _read(read_bundle, place)
        assert not _imported(place), document
    Path(TEXT).write_bytes(replays.bundle_files()[TEXT].replace(b'"STOP"', f'"{NAME}"'.encode()))
    assert _run("replay", str(place)) == 2
    assert not _imported(place)


def test_a_trajectory_is_read_and_drawn(place):
    Path("short.plan").write_text("0 0 STOP\n")
    Path("one.yaml").write_text(
        "area_length: 3\narea_width: 3\narea_height: 2\nblock_num: 0\nslope_num: 0\nsmartcar_num: 1\n"
    )
    record_once("one.yaml", Setup(), 0, plan=Path("short.plan")).write("whole.npz")
    with np.load("whole.npz") as archive:
        arrays = dict(archive)
    (text,) = (name for name, array in arrays.items() if array.dtype == np.uint8)
    for document in _documents(json.loads(arrays[text].tobytes())):
        data = np.frombuffer(json.dumps(document).encode(), np.uint8)
        np.savez("run.npz", **{**arrays, text: data})
        _read(Trajectory.read, "run.npz")
        assert not _imported(place), document
    assert _run("plot", "run.npz") in (0, 2)
    np.savez("run.npz", **arrays, more=np.array([NAME]))
    assert _run("plot", "run.npz") == 2
    assert not _imported(place)


TEXTS = {
    "task file": ("start: strip\ngoal: strip_goal\nreward: paper\n", lambda path: as_task(str(path))),
    "blueprint": ("area_length: 3\narea_width: 3\narea_height: 2\nflag: [{id: 0, x: 1, y: 1, z: 1}]\n", None),
    "machines": ("smartcar: {chassis_mass_kg: 1.1}\ncars: [{}, {wheel_mass_kg: 2.5}]\n", "--machines"),
    "gains": ("gains: {drive: {max_speed: 0.4}}\n", "--gains"),
    "noise": ("{min_delay_s: 0.02, max_delay_s: 0.04, position_m: 0.001}\n", "--noise"),
    "camera": ("lookat: [0, 0, 0]\ndistance: 1\nazimuth: 1\nelevation: 1\n", read_aim),
}  # fmt: skip


@pytest.mark.parametrize("form", TEXTS)
def test_what_people_write(form, place):
    text, read = TEXTS[form]
    for changed in [*_texts(text, '"'), text.replace(": ", f": {NAME} "), f"{NAME}\n", f'"{NAME}": 1\n']:
        Path("file.yaml").write_text(changed)
        if callable(read):
            _read(read, Path("file.yaml"))
        elif read is None:
            _run("show", "file.yaml", "--goal", "file.yaml")
        else:
            _run("validate", "strip", read, "file.yaml", "--trials", "1", "--timeout", "0.01", "--out", "v")
        assert not _imported(place), changed


def test_settings_plans_starts_and_tables(place):
    for changed in _texts("learning_rate: 0.01\nepochs: 2\n", '"'):
        Path("settings.yaml").write_text(changed)
        assert _run("train", "--settings", "settings.yaml", *SMALL) == 2
    for changed in [*_texts("0 0 STOP\n1 0 STOP\n"), f"{NAME}\n"]:
        Path("a.plan").write_text(changed)
        assert _run("show", "strip", "--plan", "a.plan") == 2
        assert _run("train", "--starts", "a.plan", *SMALL) == 2
    for changed in _texts(words._table().decode()):
        Path("durations.csv").write_text(changed)
        _read(read_durations, Path("durations.csv"))
    save_starts(Path("starts.npz"), [make_task("strip").draw(np.random.default_rng(0))])
    with np.load("starts.npz") as archive:
        arrays = dict(archive)
    for name in (*arrays, "more", NAME.replace(":", ".")):
        np.savez("starts.npz", **{**arrays, name: np.array([NAME])})
        assert _run("train", "--starts", "starts.npz", *SMALL) == 2
    assert not _imported(place)


def test_logs_and_bags(place):
    rng = np.random.default_rng(0)
    groups = {name: 0.01 * rng.normal(size=(12, len(columns))) for name, columns in GROUPS.items()}
    log = Log(0.02 * np.arange(12), **groups)
    write_table(Path("whole.csv"), {0: log})
    head, rest = Path("whole.csv").read_text().split("\n", 1)
    for changed in [*_texts(head), f"{head}\n{NAME},"]:
        Path("log.csv").write_text(f"{changed}\n{rest}")
        _read(read_logs, "log.csv")
    write_bag(Path("log.mcap"), log, commands=f"/{NAME}", pose_topics=(NAME,))
    _read(read_logs, "log.mcap")
    write_bag(Path("log.mcap"), log)
    for changed in _texts("commands: /wheel_commands\npose: /localisation\n", '"'):
        Path("topics.yaml").write_text(changed)
        _read(read_logs, "log.mcap", "topics.yaml")
    assert not _imported(place)


def test_a_recording_of_the_grid_world(place):
    import gzip

    data = gzip.decompress((Path(__file__).parents[1] / "data" / "plans.jsonl.gz").read_bytes())
    for document in _documents(json.loads(data.splitlines()[0])):
        Path("r.jsonl").write_text(json.dumps(document) + "\n")
        _run("conformance", "r.jsonl")
        assert not _imported(place), document


def test_a_dataset_names_no_code_but_what_gymnasium_makes_the_task_of(place):
    """Minari imports what a dataset names as its environment; craftsim reads none."""
    assert _run("export", "strip", "--episodes", "1", "--name", "strip-v0", "--out", str(place / "sets")) == 0
    described = json.loads((place / "sets" / "strip-v0" / "data" / "metadata.json").read_text())
    spec = json.loads(described["env_spec"])
    assert spec["entry_point"].startswith("craftsim.")
