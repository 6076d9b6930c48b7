"""Hostile and broken files: refused quickly, in bounded memory, and never with another error than ours.

Times are of this process alone, so that a busy machine does not fail the tests.
"""

import os
import time
import tracemalloc

import numpy as np
import pytest

from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint, read_blueprint
from craftsim.errors import BlueprintError
from craftsim.storage.limits import YAML

BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{name}: &{name} [{','.join([f'*{before}'] * 9)}]\n"
    for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)
COUNTS = (
    "area_length: {0}\narea_width: {0}\narea_height: {0}\nblock_num: {1}\nslope_num: 0\nsmartcar_num: 0\n"
)


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
        begun = time.process_time()
        with pytest.raises(BlueprintError, match=r"hostile\.yaml"):
            read_blueprint(path)
        assert time.process_time() - begun < 10, name
        tracemalloc.start()
        with pytest.raises(BlueprintError):
            read_blueprint(path)
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
    counts = (
        "area_length: 100\narea_width: 100\narea_height: 1\nblock_num: {}\nslope_num: {}\nsmartcar_num: 0\n"
    )
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
