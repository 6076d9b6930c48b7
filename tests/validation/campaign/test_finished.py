"""A finished campaign is read back as it was returned; what is none is refused, and the user is told why."""

import json

import cheap_work
import pytest

from craftsim.errors import InputError
from craftsim.validation.campaign import Header, read_finished, run_campaign


@pytest.fixture
def finished(tmp_path):
    """Return the folder of a finished campaign, and its records."""
    header = Header("validate", 7, {"trials": 3})
    return tmp_path, run_campaign(cheap_work.items(3, i1="raise"), cheap_work.work, tmp_path, header)


def test_it_is_read_back_whole(finished):
    folder, records = finished
    found = read_finished(folder, "validate")
    assert found.records == records
    assert (found.header["seed"], found.header["config"]) == (7, {"trials": 3})


def test_another_commands_and_an_unfinished_one_are_refused(finished):
    folder, _ = finished
    with pytest.raises(InputError, match="holds a campaign of 'craftsim validate'"):
        read_finished(folder, "audit")
    lines = folder / "trials.jsonl"
    lines.write_bytes(lines.read_bytes()[:-1])
    with pytest.raises(InputError, match=r"unfinished campaign \(2 of 3 trials\)"):
        read_finished(folder, "validate")


@pytest.mark.parametrize("line", ["{", "[]", "3", "{}", json.dumps({"key": "item 0"})])
def test_a_line_that_is_no_record_is_named(finished, line):
    folder, _ = finished
    lines = folder / "trials.jsonl"
    first, *rest = lines.read_text().splitlines()
    lines.write_text("\n".join([first, line, *rest[1:]]) + "\n")
    with pytest.raises(InputError, match=r"trials\.jsonl:2: not a trial's record"):
        read_finished(folder, "validate")


def test_a_folder_without_a_campaign_is_refused(tmp_path):
    with pytest.raises(InputError, match="holds no campaign"):
        read_finished(tmp_path / "nowhere", "validate")
    (tmp_path / "campaign.json").write_text("[]")
    with pytest.raises(InputError, match="not a campaign's description"):
        read_finished(tmp_path, "validate")
