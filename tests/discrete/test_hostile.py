"""Hostile and broken files, recordings and starts: refused with one message, quickly, in bounded memory."""

import copy
import gzip
import json
import os
import re
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from craftsim.audit.conformance import parse_record
from craftsim.cli import main
from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint, read_blueprint
from craftsim.discrete.grid import CarField, Grid, Kind, check_grid
from craftsim.errors import BlueprintError, InputError
from craftsim.storage.limits import YAML
from craftsim.tasks import make_task
from craftsim.tasks.starts import load_starts, save_starts

BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{name}: &{name} [{','.join([f'*{before}'] * 9)}]\n"
    for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)
COUNTS = "area_length: {0}\narea_width: {0}\narea_height: {0}\nblock_num: {1}\nslope_num: 0\nsmartcar_num: 0\n"


HOSTILE = {
    "alias bomb": BOMB,
    "merge bomb": "a: &a {x: 1}\nb: {<<: [*a, *a]}\n",
    "huge area": COUNTS.format(10**9, 0),
    "large area that is allowed per side": COUNTS.format(128, 0),
    "deep flow nesting": "block: " + "[" * 100_000,
    "deep mappings": "".join(" " * i + "a:\n" for i in range(500)),
    "question marks": "? " * 100_000,
    "one long number": COUNTS.format(10, "1" * 200_000),
    "not finite": COUNTS.format(".inf", ".nan"),
    "many entries": COUNTS.format(10, 0) + "block:\n" + "  - {x: 1, y: 1, z: 1}\n" * 10_000,
    "many documents": "---\n" * 60_000,
    "python object": "!!python/object/apply:os.system ['true']",
    "ten megabytes": "x" * 10_000_000,
}


def test_a_hostile_file_is_refused_within_seconds_in_little_memory(tmp_path):
    path = tmp_path / "hostile.yaml"
    for name, text in HOSTILE.items():
        path.write_text(text)
        tracemalloc.start()
        begun = (
            time.process_time()
        )  # of this process alone, so that a busy machine does not fail the test
        with pytest.raises(BlueprintError, match=r"hostile\.yaml"):
            read_blueprint(path)
        assert time.process_time() - begun < 10, name
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 64e6, name


def test_a_pipe_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(BlueprintError, match="not a regular file"):
        read_blueprint(tmp_path / "pipe")


def test_the_largest_file_that_is_allowed_is_read_within_seconds(tmp_path):
    entries = [f"  - {{x: {x}, y: {y}, z: 1}}\n" for x in range(64) for y in range(60)]
    text = (
        COUNTS.format(64, len(entries)).replace("area_height: 64", "area_height: 2")
        + "block:\n"
        + "".join(entries)
    )
    assert YAML.file_bytes / 4 < len(text) < YAML.file_bytes
    (tmp_path / "large.yaml").write_text(text)
    begun = time.process_time()
    grid = read_blueprint(tmp_path / "large.yaml").grid(np.random.default_rng(0))
    assert time.process_time() - begun < 10
    assert (grid.kind == 3).sum() == len(entries)


def test_what_is_read_can_be_written_and_read_again():
    """The largest worlds that are accepted, with everything drawn, or listed; one thing more is refused when read."""
    counts = "area_length: 100\narea_width: 100\narea_height: 1\nblock_num: {}\nslope_num: {}\nsmartcar_num: 0\n"
    for text in (counts.format(1479, 0), counts.format(0, 1377)):
        world = parse_blueprint(text, "drawn.yaml").grid(np.random.default_rng(0))
        again = parse_blueprint(blueprint_text(world), "again.yaml").grid(np.random.default_rng(0))
        assert again.same_visible(world)
    for text in (counts.format(1480, 0), counts.format(0, 1378)):
        with pytest.raises(
            BlueprintError, match=r"much\.yaml: a world of .* makes .* values when all is written"
        ):
            parse_blueprint(text, "much.yaml")
    with pytest.raises(BlueprintError, match="makes 40010 values"):
        parse_blueprint(counts.format(0, 0), "drawn.yaml").with_counts(n_blocks=1480)


def test_a_mark_of_a_car_that_there_is_not_is_refused():
    text = COUNTS.format(3, 0) + "snapshot: {top: [{x: 0, y: 0, z: 0, mark: 0}]}\n"
    with pytest.raises(BlueprintError, match=r"mark': 0 is out of range, allowed: -2 to -1"):
        parse_blueprint(text, "mark.yaml")


def test_a_block_with_a_yaw_is_saved_and_counted_once():
    text = COUNTS.format(3, 1) + "block: [{x: 0, y: 0, z: 1}]\n"
    world = parse_blueprint(text, "yaw.yaml").grid(np.random.default_rng(0))
    world.yaw[0, 0, 1] = 3
    again = parse_blueprint(blueprint_text(world), "again.yaml").grid(np.random.default_rng(0))
    assert again.yaw[0, 0, 1] == 3


LINE = gzip.decompress(
    (Path(__file__).parents[1] / "data" / "traces.jsonl.gz").read_bytes()
).splitlines()[0]


def _changed(**changes):
    return json.dumps({**json.loads(LINE), **changes}).encode()


def _with(change):
    record = copy.deepcopy(json.loads(LINE))
    change(record)
    return json.dumps(record).encode()


RECORDINGS = {
    "spaces": (b" " * 2**21, "the line is longer than"),
    "huge size": (_changed(size=[2000, 2000, 500]), r"the size is \(2000, 2000, 500\); allowed: 1 to 128"),
    "a long number": (_changed(t=7).replace(b'"t": 7', b'"t": ' + b"9" * 5000), "not a record"),
    "not finite": (_changed(reward=float("nan")), "not a record"),
    "a huge depth": (_changed(depth=10**9, cars=[]), "key 'depth'"),
    "half a record": (_with(lambda r: r.pop("joint")), "needs 'joint'"),
    "steering": (_changed(ep="\x1b[31m"), "key 'ep'"),
    "a kind": (_with(lambda r: r["before"]["objs"][0].__setitem__(0, "tower")), "before.objs.0"),
    "a cell": (_with(lambda r: r["before"]["objs"][0].__setitem__(1, 99)), r"the cell \(99, 0, 1\) is outside"),
    "a car": (_with(lambda r: r["before"]["cars"][0].__setitem__("x", 50)), r"car 0 is at \(50, 1, 1\), outside"),
    "a load": (_with(lambda r: r["before"]["cars"][0].__setitem__("load", "wall")), "'load' of car 0 is 2; allowed"),
    "a mark": (_with(lambda r: r["before"]["dev"]["on"].append([0, 0, 0, 30])), "names a car that is not there"),
    "a car that acts": (_with(lambda r: r["joint"][0].__setitem__(0, 7)), "'joint' names a car"),
    "a car too few": (_with(lambda r: r["after"]["cars"].pop()), "'after.cars' has 1 entries"),
}  # fmt: skip


def test_a_hostile_recording_is_one_message(tmp_path, capsys):
    path = tmp_path / "odd.jsonl.gz"
    for name, (data, message) in RECORDINGS.items():
        path.write_bytes(gzip.compress(LINE + b"\n" + data))
        assert main(["conformance", str(path)]) == 2, name
        said = capsys.readouterr().err.splitlines(keepends=True)
        (error,) = (line for line in said if not line.startswith("craftsim: compiling"))
        assert error.startswith(f"craftsim: {path}:2: "), name
        assert re.search(message, error), error


def test_the_command_refuses_what_is_no_recording(tmp_path, capsys):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "odd").write_bytes(b"not gzip\n")
    for name, message in (("pipe", "not a regular file"), ("odd", "not a gzip file")):
        assert main(["conformance", str(tmp_path / name)]) == 2
        assert message in capsys.readouterr().err


def test_keys_that_we_do_not_compare_are_passed_over():
    assert "weather" not in parse_record(_changed(weather="fair"))


def _start():
    return make_task("strip").draw(np.random.default_rng(0))


def _set(name, place, value):
    def change(grid):
        getattr(grid, name)[place] = value

    return change


ODD = {
    "kind": (
        _set("kind", (0, 0, 1), 99),
        r"'kind' of the cell \(0, 0, 1\) is 99; allowed: the kinds 0 to 8",
    ),
    "ground": (_set("kind", (0, 0, 0), Kind.BODY), "allowed: ground in the layer 0"),
    "top": (_set("occupant", (0, 0, 1), 30000), "'top' of the cell"),
    "back": (_set("landing", (0, 0, 2), 1), "allowed: a mark as landing on blocks"),
    "heading": (_set("cars", (0, CarField.YAW), 99), "'yaw' of car 0 is 99; allowed: 0 to 3"),
    "load": (_set("cars", (0, CarField.LOAD), -1), "'load' of car 0 is -1; allowed: "),
    "load beyond": (_set("cars", (0, CarField.LOAD), 99), "'load' of car 0 is 99; allowed: "),
    "negative kind": (_set("kind", (0, 0, 1), -7), r"'kind' of the cell \(0, 0, 1\) is -7"),
    "load yaw": (_set("cars", (0, CarField.LOAD_YAW), 2), "'load_yaw' of car 0 is 2"),
    "slope": (_set("cars", (0, CarField.SLOPE), 99), "'slope' of car 0 is 99"),
    "below": (_set("cars", (1, CarField.Z), 0), "car 1 is at"),
}


def test_a_start_that_the_rules_cannot_look_up_is_refused(tmp_path):
    for change, message in ODD.values():
        grid = _start()
        change(grid)
        with pytest.raises(InputError, match=message):
            make_task("strip").starting_from([grid])
        arrays = Grid.stack([_start(), grid]).to_arrays()
        np.savez(tmp_path / "starts.npz", **arrays)
        with pytest.raises(InputError, match=r"starts\.npz: world 1: "):
            load_starts(tmp_path / "starts.npz")


def test_arrays_of_another_shape_or_type_are_no_world():
    grid = _start()
    for name, array, words in (
        ("cells", grid.cells.astype(np.int64), "the array 'cells' holds int64; allowed: int16"),
        ("cells", grid.kind, "have the shapes"),
        ("cars", grid.cars[:, :3], "have the shapes"),
        ("cars", np.zeros((300, 7), np.int16), "300 cars"),
        ("cells", [1, 2], "holds list"),
    ):
        other = grid.copy()
        setattr(other, name, array)
        with pytest.raises(InputError, match=words):
            check_grid(other)
    with pytest.raises(InputError, match="the size is"):
        check_grid(Grid.empty((129, 1, 1)))
    for odd, words in (
        (1 << 16, "holds 6553[67]; allowed: at most 32767"),
        (0.5, "holds float64; allowed: integers"),
    ):
        arrays = grid.to_arrays()
        arrays["cars"] = arrays["cars"] + odd
        with pytest.raises(InputError, match=words):
            Grid.from_arrays(arrays)


def test_feet_without_a_body_count_as_slopes(tmp_path):
    grid = make_task("simple_two_story").draw(np.random.default_rng(0))
    free = [tuple(cell) for cell in np.argwhere(grid.kind[:, :, 1] == Kind.AIR)]
    for x, y in free[:4]:
        grid.kind[x, y, 1] = Kind.FOOT
    with pytest.raises(InputError, match="slopes; task 'simple_two_story' observes at most"):
        make_task("simple_two_story").starting_from([grid])
    save_starts(tmp_path / "starts.npz", [grid])
