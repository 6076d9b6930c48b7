"""A finished run is read back as it was returned; what is none is refused, and the user is told why."""

import cheap_work
import pytest
from sessions import cut_off, make_old, put

from craftsim.errors import InputError
from craftsim.experiments.records import read_finished
from craftsim.experiments.session import run_experiment


@pytest.fixture
def finished(tmp_path):
    """Return the folder of a finished run, and its records."""
    items = cheap_work.items(3, i1="raise")
    return tmp_path, run_experiment(cheap_work.experiment(items, "validate", {"trials": 3}), tmp_path)


@pytest.mark.parametrize("old", [False, True])
def test_it_is_read_back_whole(finished, old):
    folder, records = finished
    expected = list(records)
    if old:
        make_old(folder)
    found = read_finished(folder, "validate")
    assert found.records == expected
    assert (found.manifest["seed"], found.manifest["config"]) == (7, {"trials": 3})


def test_another_commands_and_an_unfinished_one_are_refused(finished):
    folder, _ = finished
    with pytest.raises(InputError, match="holds a run of 'craftsim validate'"):
        read_finished(folder, "audit")
    cut_off(folder, (0, 1))
    with pytest.raises(InputError, match=r"unfinished run \(2 of 3 trials\)"):
        read_finished(folder, "validate")


@pytest.mark.parametrize("text", ["{", "[]", "3", "{}", '{"key": "item 0"}'])
def test_what_is_no_record_is_named(finished, text):
    folder, _ = finished
    put(folder, 1, text)
    with pytest.raises(InputError, match=r"session\.db: trial 1: not a trial's record"):
        read_finished(folder, "validate")
    lines = make_old(folder) / "trials.jsonl"
    first, *rest = lines.read_text().splitlines()
    lines.write_text("\n".join([first, text, *rest[1:]]) + "\n")
    with pytest.raises(InputError, match=r"trials\.jsonl:2: not a trial's record"):
        read_finished(folder, "validate")


def test_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(InputError, match="holds no run"):
        read_finished(tmp_path / "nowhere", "validate")
    (tmp_path / "campaign.json").write_text("[]")
    with pytest.raises(InputError, match="not a run's manifest"):
        read_finished(tmp_path, "validate")
