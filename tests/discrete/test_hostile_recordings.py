"""Recordings and files of starts from people one does not know: one message, in bounded time and memory."""

import copy
import gzip
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

from craftsim.cli import main
from craftsim.discrete.conformance import parse_record
from craftsim.discrete.grid import CarField, Grid, Kind, check_grid
from craftsim.discrete.tasks import make_task
from craftsim.discrete.tasks.starts import load_starts, save_starts
from craftsim.errors import InputError

LINE = gzip.decompress((Path(__file__).parents[1] / "data" / "traces.jsonl.gz").read_bytes()).splitlines()[0]


def _changed(**changes):
    return json.dumps({**json.loads(LINE), **changes}).encode()


def _with(change):
    record = copy.deepcopy(json.loads(LINE))
    change(record)
    return json.dumps(record).encode()


HOSTILE = {
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
    for name, (data, message) in HOSTILE.items():
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
    "kind": (_set("kind", (0, 0, 1), 99), r"'kind' of the cell \(0, 0, 1\) is 99; allowed: the kinds 0 to 8"),
    "ground": (_set("kind", (0, 0, 0), Kind.BODY), "allowed: ground in the layer 0"),
    "top": (_set("occupant", (0, 0, 1), 30000), "'top' of the cell"),
    "back": (_set("landing", (0, 0, 2), 1), "allowed: a mark as landing on blocks"),
    "heading": (_set("cars", (0, CarField.YAW), 99), "'yaw' of car 0 is 99; allowed: 0 to 3"),
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
