"""A campaign's folder is what it says, or the user is told what is wrong with it."""

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cheap_work
import pytest
from owner import owner

from craftsim.errors import InputError
from craftsim.validation.campaign import Done, Header
from craftsim.validation.campaign.items import make_record
from craftsim.validation.campaign.store import Store

HEADER = Header("test", 7, {"trials": 1, "nested": {"a": [1.5]}})
ITEMS = cheap_work.items(4)


def _record(i):
    return make_record(ITEMS[i], i, Done(True, [{"error_m": 0.1 / 3}]))


@pytest.fixture
def begun(tmp_path):
    """Return the folder of a campaign of which items 2 and 0 are finished."""
    store = Store(tmp_path, HEADER, ITEMS, resume=False)
    store.append(_record(2))
    store.append(_record(0))
    store.close()
    return tmp_path


def _resume(out, header=HEADER, items=ITEMS):
    store = Store(out, header, items, resume=True)
    kept = list(store.kept())
    store.close()
    return kept


def test_resuming_reads_back_what_is_finished(begun):
    assert _resume(begun) == [_record(2), _record(0)]


def test_a_torn_last_line_is_cut_off(begun):
    path = begun / "trials.jsonl"
    whole = path.read_bytes()
    path.write_bytes(whole[:-5])
    assert _resume(begun) == [_record(2)]
    assert path.read_bytes() == whole[: whole.index(b"\n") + 1]


@pytest.mark.parametrize("line", [b"{", b"[]", b"3", b"{}", b"\xff\xfe", b""])
def test_an_unreadable_line_is_named_with_what_to_do(begun, line):
    path = begun / "trials.jsonl"
    path.write_bytes(line + b"\n" + path.read_bytes())
    with pytest.raises(InputError, match=r"trials\.jsonl:1: .*delete this line"):
        _resume(begun)


def test_a_record_of_no_item_is_named(begun):
    with (begun / "trials.jsonl").open("a") as file:
        file.write(json.dumps({**_record(1), "key": "stranger"}) + "\n")
    with pytest.raises(InputError, match=r"trials\.jsonl:3: trial 'stranger'"):
        _resume(begun)


@pytest.mark.parametrize(
    ("header", "items", "key"),
    [
        (replace(HEADER, seed=8), ITEMS, "seed is 7, not 8"),
        (replace(HEADER, config={**HEADER.config, "trials": 2}), ITEMS, "config.trials is 1, not 2"),
        (replace(HEADER, command="other"), ITEMS, "command is 'test', not 'other'"),
        (HEADER, ITEMS[:3], "items is 4, not 3"),
        (HEADER, [replace(ITEMS[0], key="x"), *ITEMS[1:]], "keys is "),
    ],
)
def test_another_campaign_is_not_resumed(begun, header, items, key):
    with pytest.raises(InputError, match=f"its {key}"):
        _resume(begun, header, items)


def test_another_version_is_not_resumed(begun):
    path = begun / "campaign.json"
    path.write_text(path.read_text().replace('"mujoco": "', '"mujoco": "0.'))
    with pytest.raises(InputError, match=r"versions\.mujoco"):
        _resume(begun)


def test_a_description_that_cannot_be_read_is_named(begun):
    (begun / "campaign.json").write_text("nonsense")
    with pytest.raises(InputError, match=r"campaign\.json"):
        _resume(begun)


def test_an_unfinished_campaign_is_not_overwritten(begun):
    with pytest.raises(InputError, match=r"unfinished campaign \(2 of 4 trials\): go on with --resume"):
        Store(begun, HEADER, ITEMS, resume=False)


def test_a_finished_campaign_gives_way_to_another_with_all_that_it_left(begun):
    with (begun / "trials.jsonl").open("a") as file:
        file.writelines(json.dumps(_record(i)) + "\n" for i in (1, 3))
    (begun / "report.json").write_text("{}")
    for name in ("report.html", "durations.csv"):
        (begun / name).touch()
    for name in ("bundles", "films", "worlds", "smallest"):
        (begun / name).mkdir()
        (begun / name / "old").touch()
    (begun / "mine.txt").touch()
    Store(begun, HEADER, ITEMS, resume=False).close()
    assert sorted(path.name for path in begun.iterdir()) == ["campaign.json", "mine.txt", "trials.jsonl"]
    assert (begun / "trials.jsonl").read_bytes() == b""


def test_one_process_at_a_time_has_a_folder(begun):
    with owner(begun), pytest.raises(InputError, match="is in use: another craftsim writes into it"):
        Store(begun, HEADER, ITEMS, resume=True)
    store = Store(begun, HEADER, ITEMS, resume=True)
    with ThreadPoolExecutor(1) as other, pytest.raises(InputError, match="is in use"):
        other.submit(_resume, begun).result()
    store.close()
    _resume(begun)


def test_nothing_that_a_link_in_the_folder_points_to_is_changed(begun, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    (elsewhere / "precious").write_text("a line without an end")
    trials = begun / "trials.jsonl"
    trials.unlink()
    trials.symlink_to(elsewhere / "precious")
    with pytest.raises(InputError, match=r"trials\.jsonl: not a regular file"):
        _resume(begun)
    trials.unlink()
    for name in ("bundles", "trajectories", "worlds"):
        (begun / name).symlink_to(elsewhere)
        for resume in (False, True):
            with pytest.raises(InputError, match=f"{name}: not a folder; move it away"):
                Store(begun, HEADER, ITEMS, resume)
        (begun / name).unlink()
    assert (elsewhere / "precious").read_text() == "a line without an end"
    _resume(begun)


def test_resume_begins_where_nothing_is(tmp_path):
    assert _resume(tmp_path / "new") == []
