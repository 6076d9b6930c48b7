"""Hostile bundles: one message that names the file, exit status 2, little time and memory, and an end."""

import json
import time

import numpy as np
import pytest
from fuzzing.replays import bundle_files

from craftsim import cli
from craftsim.errors import InputError
from craftsim.experiments.bundle import AFTER, BUNDLE_FILE, read_bundle, replay

WORLD = "area_length: {0}\narea_width: {0}\narea_height: {1}\nblock_num: {2}\nslope_num: 0\nsmartcar_num: {3}\n"
SIMULATION = ("recipe", "setup", "simulation")
FIRST = ("recipe", "steps", 0)


@pytest.fixture
def folder(tmp_path):
    """A bundle to be spoilt."""
    for name, data in bundle_files().items():
        (tmp_path / name).write_bytes(data)
    return tmp_path


def _edit(folder, keys, value):
    document = json.loads((folder / BUNDLE_FILE).read_text())
    place = document
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = value(place[keys[-1]]) if callable(value) else value
    (folder / BUNDLE_FILE).write_text(json.dumps(document))


EDITS = {
    "another schema": (("schema_version",), 99, "schema_version is 99"),
    "an unknown action": ((*FIRST, "ticks", 0, 0, "action"), "UNFLOD", "did you mean 'UNFOLD'"),
    "a text for a share": (("recipe", "setup", "randomization", "mass"), "much", "recipe.setup.randomization.mass"),
    "unknown rules": (("recipe", "setup", "rules"), "mine", "recipe.setup.rules"),
    "half a world": (("recipe", "world"), "area_length: 3", "area_width"),
    "anchors": (("recipe", "world"), "block: &a [*a]", "anchors"),
    "tiny steps": (SIMULATION, lambda s: s | {"timestep_s": 1e-7, "control_period_s": 1e-7}, "timestep_s': 1e-07 is"),
    "solver for ever": ((*SIMULATION, "solver_iterations"), 2**31, "2147483648 is out of range, allowed: 1 to"),
    "many steps": (("recipe", "steps"), lambda s: s * 6000, "18000 actions; allowed: at most 10000"),
    "steps beyond its time": (("recipe", "steps"), lambda s: s * 600, "1800 actions do not fit into the"),
    "one large step": (
        ("recipe", "steps", 1, "ticks"),
        [[{"car": 0, "action": "STOP"}]] * 2001,
        "a step of 2001 actions; allowed: at most 2000",
    ),
    "a car twice": (("recipe", "steps", 1, "ticks", 0, 1, "car"), 0, "acts twice in one tick"),
    "no actions": (("recipe", "steps", 1, "ticks"), [], "no actions"),
    "a long claim": (("end_s",), 1e9, "claim 1e+09 s of simulated time"),
    "a negative claim": (("end_s",), -1.0, "must be 0 or more"),
    "a start that never comes": (
        ("recipe", "steps", 1),
        lambda step: step | {"starts_s": [1e9] * len(step["ticks"])},
        "starts_s has 1e+09; allowed: 0 to the end, ",
    ),
    "attempts of others": (("attempts",), lambda a: a[::-1], "in their order"),
    "a text for a number": (("start_s",), "0.3", "start_s': must be a number, not '0.3'"),
    "a long seed": (("recipe", "seed", "entropy"), [1] * 100, "a seed of more than 64 numbers"),
    "200 cars": (("recipe", "world"), WORLD.format(20, 2, 1, 200), "200 cars: too large for physics"),
    "a goal far away": (("recipe", "goals"), [[10**30, 0, 1]], "outside of the area"),
    "many goals": (("recipe", "goals"), [[0, 0, 1]] * 1025, "1025 marked goals"),
    "another world intended": ((*FIRST, "intended"), WORLD.format(9, 2, 1, 2), "intended world of a step"),
    "an endless gain": (("recipe", "setup", "gains", "hinge", "allowance"), 1e300, "hinge.allowance': must be from"),
}  # fmt: skip


@pytest.mark.parametrize("name", EDITS)
def test_a_hostile_value_is_one_message_before_any_work(name, folder):
    keys, value, message = EDITS[name]
    _edit(folder, keys, value)
    begun = time.process_time()
    with pytest.raises(InputError, match=BUNDLE_FILE) as caught:
        replay(read_bundle(folder))
    assert message in str(caught.value)
    assert time.process_time() - begun < 10


def test_a_command_says_it_too(folder, capsys):
    _edit(folder, ("end_s",), -1.0)
    assert cli.main(["replay", str(folder), "--out", str(folder / "out"), "--minimize"]) == 2
    assert "must be 0 or more" in capsys.readouterr().err


def test_a_hostile_text_is_one_message(folder):
    for text, message in (
        (b"[" * 200_000, "recursion limit"),
        (b'{"schema_version": %b}' % (b"1" * 5000), "number out of range"),
        (b'{"end_s": NaN}', "finite number"),
        (b"[" + b"1," * 3_000_000 + b"1]", "more than the 200000 values"),
        (b"{" + b",".join(b'"%d":1' % i for i in range(150_000)) + b"}", "wrong or unknown"),
        (b" " * 9_000_000, "no larger than the 8 MiB"),
        (b"\xff\xfe", "Invalid JSON"),
        (b"null", "must be a mapping"),
    ):
        (folder / BUNDLE_FILE).write_bytes(text)
        begun = time.process_time()
        with pytest.raises(InputError, match=BUNDLE_FILE) as caught:
            read_bundle(folder)
        assert time.process_time() - begun < 10
        assert message in str(caught.value) or "is missing" in str(caught.value)
        assert len(str(caught.value)) < 1000


def test_arrays_of_another_world_are_refused_before_anything_moves(folder):
    with np.load(folder / AFTER) as archive:
        arrays = dict(archive)
    for changes, message in (
        ({"more": np.zeros(3)}, "has an unknown array 'more'"),
        ({"qpos": arrays["qpos"][:-1]}, "array 'qpos' .* recipe's world"),
    ):
        np.savez(folder / AFTER, **{**arrays, **changes})
        with pytest.raises(InputError, match=f"{AFTER}: {message}"):
            replay(read_bundle(folder))
    del arrays["act"]
    np.savez(folder / AFTER, **arrays)
    with pytest.raises(InputError, match=f"{AFTER}: has no array 'act'"):
        replay(read_bundle(folder))


def test_a_replay_ends_soon_after_the_bundle_says_it_does(folder):
    turns = [
        {
            "ticks": [[{"car": 0, "action": "ROTATE_LEFT"}]],
            "order": None,
            "intended": None,
            "number": 0,
        }
    ]
    _edit(folder, ["recipe", "steps"], lambda steps: turns * 100 + steps)
    begun = time.process_time()
    with pytest.raises(InputError, match=r"bundle\.json: the recipe.* has not finished after"):
        replay(read_bundle(folder))
    assert time.process_time() - begun < 10


def test_times_that_are_not_those_of_the_replay_differ(folder):
    _edit(folder, ["end_s"], lambda end_s: end_s + 0.02)
    assert replay(read_bundle(folder)).differing == ("start_s and end_s",)


def test_poses_that_are_none_are_refused_not_compared(folder):
    with np.load(folder / AFTER) as archive:
        arrays = dict(archive)
    # The first body that moves is a car: its place, and its turn as a quaternion.
    for first, numbers in (
        (0, [np.nan]),
        (1, [-np.inf]),
        (3, [0.0] * 4),
        (3, [0.5, 0.0, 0.0, 0.0]),
        (3, [1e200] * 4),
    ):
        qpos = arrays["qpos"].copy()
        qpos[first : first + len(numbers)] = numbers
        np.savez(folder / AFTER, **{**arrays, "qpos": qpos})
        with pytest.raises(InputError, match=f"{AFTER}: array 'qpos' holds what is no pose"):
            replay(read_bundle(folder))
