"""Every item gets one record, whatever becomes of it, at any number of workers."""

import json
from contextlib import nullcontext

import cheap_work
import pytest

from craftsim.errors import InputError
from craftsim.experiments.experiment import RunOptions
from craftsim.experiments.session import run_experiment


def _run(out, items, batch=1, timeout_s=60.0, **options):
    return run_experiment(
        cheap_work.experiment(items, batch=batch, timeout_s=timeout_s), out, RunOptions(**options)
    )


def test_what_goes_wrong_with_an_item_is_its_record_and_harms_no_other(tmp_path):
    items = cheap_work.items(
        16,
        i3="raise",
        i5="die",
        i6=("die once", tmp_path / "died"),
        i9="exit",
        i11="hang",
        i13="nan",
    )
    options = {"timeout_s": 1.0}
    one = _run(tmp_path / "one", items, **options)
    assert [record["key"] for record in one] == [item.key for item in items]
    assert {record["index"]: record["error"] for record in one if record["error"]} == {
        3: "ValueError: no 3\nin two lines",
        5: "its worker process died, 2 times",
        9: "SystemExit: 3",
        11: "no answer within 1 s",
    }
    assert one[3]["extra"]["traceback"].startswith("Traceback")
    assert one[6]["agrees"]
    assert one[6]["extra"] == {"number": 6}
    assert one[13]["attempts"] == [{"error_m": None}]
    (tmp_path / "died").unlink()
    assert _run(tmp_path / "two", items, workers=2, batch=2, **options) == one
    lines = [(tmp_path / name / "trials.jsonl").read_text() for name in ("one", "two")]
    assert lines[0] == lines[1]
    assert [json.loads(line) for line in lines[0].splitlines()] == one


def test_a_full_disk_in_a_worker_stops_the_campaign_and_resume_goes_on(tmp_path):
    items = cheap_work.items(5, i3="disk")
    with pytest.raises(InputError, match=r"bundles/one: No space left on device; .*--resume"):
        _run(tmp_path, items)
    seen = []
    progress = lambda total: nullcontext(lambda record: seen.append(record["index"]))  # noqa: E731
    records = _run(tmp_path, cheap_work.items(5), resume=True, progress=progress)
    assert seen == [0, 1, 2, 3, 4]
    assert all(record["agrees"] for record in records)


def test_resume_tries_again_what_had_an_error(tmp_path):
    _run(tmp_path, cheap_work.items(3, i1="raise"))
    assert all(record["error"] is None for record in _run(tmp_path, cheap_work.items(3), resume=True))
    assert len((tmp_path / "trials.jsonl").read_text().splitlines()) == 3
