"""scripts/paper.py: a run that is stored is not made again, and a new one is stored beside the others."""

import json
from pathlib import Path

import paper
import pytest

RUN = {
    "task": "strip",
    "algo": "vdn",
    "seed": 0,
    "steps": 150_000,
    "max_steps": 18,
    "revision": "0123abcd",
    "versions": {"torch": "1"},
    "cpu_s": None,
    "last_fifth": 0.5,
    "mean_return": None,
    "curve": [],
}


@pytest.fixture
def trained(tmp_path, monkeypatch):
    """Store one run, let training make a report at once, and return what was trained."""
    made = []

    def train(command, **_):
        task, given = command[5], dict(zip(command[6::2], command[7::2], strict=True))
        made.append((task, given["--algo"], int(given["--seed"])))
        config = {"task": task, "algo": given["--algo"]} | {
            n: int(given[f"--{n}"]) for n in ("seed", "steps")
        }
        config["max_steps"] = int(given["--max-steps"])
        curve = [{"steps": 10_000, "successes": 5, "episodes": 20}]
        figures = {
            "training_versions": {"torch": "2"},
            "last_fifth": 0.25,
            "mean_return": 3.5,
            "learning_curve": curve,
        }
        out = Path(given["--out"])
        out.mkdir(parents=True)
        (out / "report.json").write_text(json.dumps({"config": config, "figures": figures}))

    monkeypatch.setattr(paper, "STORED", tmp_path / "runs.json")
    monkeypatch.setattr(paper, "OUT", tmp_path / "out")
    monkeypatch.setattr(paper, "revision", lambda: "4567cdef")
    monkeypatch.setattr(paper.subprocess, "run", train)
    paper.STORED.write_text(json.dumps({"runs": [RUN]}))
    return made


def test_only_what_is_not_stored_is_trained_and_stored_with_its_own_revision(trained):
    paper.main(["strip", "--algo", "vdn", "--seeds", "2"])
    first, second = paper.stored()
    assert trained == [("strip", "vdn", 1)]
    assert first == RUN
    assert (second["seed"], second["revision"], second["versions"]) == (
        1,
        "4567cdef",
        {"torch": "2"},
    )
    assert (second["last_fifth"], second["mean_return"], second["cpu_s"]) == (0.25, 3.5, 0)
    assert second["curve"] == [[10_000, 0.25]]
    paper.main(["strip", "--algo", "vdn", "--seeds", "2"])
    assert len(trained) == 1


def test_a_run_of_another_length_is_another_run(trained, monkeypatch):
    monkeypatch.setitem(paper.STEPS, "vdn", 300_000)
    paper.main(["strip", "--algo", "vdn", "--seeds", "1"])
    assert [run["steps"] for run in paper.stored()] == [150_000, 300_000]


def test_seeds_begin_with_the_first(trained):
    paper.main(["strip", "--algo", "vdn", "--first", "11", "--seeds", "2"])
    assert trained == [("strip", "vdn", 11), ("strip", "vdn", 12)]


def test_a_run_with_longer_episodes_is_another_run(trained):
    paper.main(["strip", "--algo", "vdn", "--seeds", "1", "--max-steps", "28"])
    assert [(run["steps"], run["max_steps"]) for run in paper.stored()] == [
        (150_000, 18),
        (150_000, 28),
    ]


@pytest.mark.parametrize(("success", "revision"), [(0.25, "0123abcd"), (0.5, "4567cdef")])
def test_a_run_that_is_trained_again_is_replaced_where_it_has_another_curve(
    trained, success, revision
):
    paper.STORED.write_text(json.dumps({"runs": [RUN | {"curve": [[10_000, success]]}]}))
    paper.main(["strip", "--algo", "vdn", "--seeds", "1", "--again"])
    (kept,) = paper.stored()
    assert (kept["revision"], kept["curve"]) == (revision, [[10_000, 0.25]])
    assert kept.get("same_at") == ("4567cdef" if success == 0.25 else None)
