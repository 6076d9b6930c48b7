"""A failure is found again in its smallest world: nothing that it does not need is left."""

import json
import shlex

import numpy as np
import pytest

from craftsim import cli
from craftsim.audit.situation import scenes
from craftsim.checking.recipe import Recipe, Step
from craftsim.checking.setup import setup_of
from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint, read_blueprint
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.learned import LearnedRules
from craftsim.errors import InputError
from craftsim.experiments.bundle import write_bundle
from craftsim.experiments.counterexample import WorldPart, pieces_of, without_parts, world_of
from craftsim.experiments.minimize import (
    FailingAction,
    NotReproducibleError,
    _is_plain,
    failing_actions,
    first_of_each_kind,
    minimize,
)

BLOCK, FSLOPE, BODY, AIR = Kind.BLOCK, Kind.FSLOPE, Kind.BODY, Kind.AIR
NEEDED = (WorldPart((3, 3, 1), AIR, 1, BLOCK), WorldPart((4, 3, 1), AIR, 0))
"""A load that turns beside a car: the published rules allow it, and its legs hit the car."""
IDLE = (
    WorldPart((6, 6, 2), AIR, 0, FSLOPE, 2),
    *(WorldPart(cell, BLOCK) for cell in ((6, 6, 1), (5, 6, 1), (1, 1, 1))),
    *(
        WorldPart((2, 1, 1), BODY, 0),
        WorldPart((6, 1, 1), FSLOPE, 1),
        WorldPart((1, 6, 1), Kind.WALL),
    ),
)
SIZE = (8, 8, 3)
PUBLISHED = setup_of("none", "published", drive="wheels")


def _cars_first(*pieces: WorldPart) -> tuple[WorldPart, ...]:
    return tuple(sorted(pieces, key=lambda piece: not piece.is_car))


CROWDED = world_of(_cars_first(*NEEDED, *IDLE), SIZE)


def test_a_world_is_the_sum_of_its_pieces_and_what_is_left_stands_when_one_is_taken_away():
    for scene in scenes()[::3]:
        grid, pieces = scene.grid, pieces_of(scene.grid)
        assert world_of(pieces, grid.size).same_visible(grid), scene.id
        if "snapshot" in blueprint_text(grid):
            continue  # the scene itself is no start that a drawing shows
        for gone in pieces:
            left = without_parts(pieces, (gone,))
            if any(piece.is_car for piece in left):
                text = blueprint_text(world_of(left, grid.size))
                parse_blueprint(text, "left")
                assert "snapshot" not in text, scene.id


def test_what_stands_on_a_piece_goes_with_it():
    kinds = ((1, BLOCK), (2, BLOCK), (3, AIR), (3, Kind.WALL))
    tower = tuple(WorldPart((0, 0, level), kind) for level, kind in kinds)
    assert without_parts(tower, tower[:1]) == tower[3:], "a wall may float"
    ramp = tuple(WorldPart((x, 0, 1), BLOCK) for x in (0, 1))
    ramp += (WorldPart((0, 0, 2), BODY, 0), WorldPart((1, 0, 2), AIR, 0, slope=1))
    assert without_parts(ramp, ramp[1:2]) == ramp[:1], "the foot falls, and the car on it"


def test_only_what_the_failure_needs_is_left():
    found = minimize(FailingAction(CROWDED, 0, Action.ROTATE_LEFT, PUBLISHED))
    assert found.minimal
    left = pieces_of(found.grid)
    assert [(piece.is_car, piece.load) for piece in left] == [(True, BLOCK), (True, AIR)]
    assert found.words == (
        "car 0 turns left with a block on level 1; it is unsafe when car 1 is in the next cell to the right"
    ).replace(
        "it is unsafe", {"unsafe": "it is unsafe", "failed": "it fails"}[found.attempt.result]
    )
    assert max(found.grid.size) <= 5


def test_the_search_ends_when_the_trials_are_used_up():
    tried = []
    found = minimize(
        FailingAction(CROWDED, 0, Action.ROTATE_LEFT, PUBLISHED), tried.append, max_trials=2
    )
    assert not found.minimal
    assert len(tried) == found.trials == 2


def test_what_works_from_a_fresh_start_is_said_to_depend_on_what_went_before():
    with pytest.raises(NotReproducibleError, match="depends on earlier"):
        minimize(FailingAction(CROWDED, 0, Action.STOP, PUBLISHED))


def test_the_first_of_each_kind_is_shrunk():
    def record(verb, reason, bundle, legal=True):
        attempt = {"verb": verb, "reason": reason, "legal": legal, "performed": True}
        return {"attempts": [{**attempt, "reason": ""}, attempt], "bundle": bundle}

    records = [
        record("LIFT", "block 1 touched car 2 (5 N)", "a"),
        record("LIFT", "block 3 touched car 0 (71 N)", "b"),
        record("DROP", "block 3 touched car 0 (71 N)", "c"),
        record("FOLD", "no bundle", None),
        record("FOLD", "forbidden", "d", legal=False),
    ]
    assert list(first_of_each_kind(records).values()) == ["a", "c"]


def test_replay_shrinks_a_bundle_into_files_that_validate_reads(tmp_path, capsys):
    joint = [(2, Action.MOVE_RIGHT), (0, Action.ROTATE_LEFT)]  # the first ends last
    steps = (Step.single(0, 1, Action.STOP), Step.of_ticks(1, joint))
    grid = world_of(_cars_first(*NEEDED, *IDLE[3:5], WorldPart((1, 5, 1), AIR, 0)), SIZE)
    bundle = write_bundle(
        tmp_path / "bundle", "a turn", Recipe(blueprint_text(grid), steps, PUBLISHED)
    )
    assert [a.action for a in bundle.attempts if not a.agrees] == ["MOVE_RIGHT", "ROTATE_LEFT"], (
        "both are blamed"
    )
    assert (
        cli.main(["replay", str(tmp_path / "bundle"), "--minimize", "--out", str(tmp_path / "out")])
        == 0
    )
    said = capsys.readouterr().out
    assert "when car 1 is in the next cell to the right" in said
    again = _printed(said)
    options = "--rules published --randomize none --trials 1"
    assert again[2:] == ["--actions", str(tmp_path / "out" / "smallest.actions"), *options.split()]
    assert cli.main([*again, "--video", "none", "--out", str(tmp_path / "again")]) == 1
    attempts = json.loads((tmp_path / "again" / "trials.jsonl").read_text())["attempts"]
    assert [(one["action"], one["result"]) for one in attempts] == [("ROTATE_LEFT", "failed")]
    found = read_blueprint(tmp_path / "out" / "smallest.yaml").grid(np.random.default_rng(0))
    assert len(pieces_of(found)) == 2


def _printed(said):
    """Return the words after ``craftsim`` of the command that a report prints to try a failure again."""
    text = " ".join(said.split())
    return shlex.split(text[text.index("craftsim ") :].partition(" Report:")[0])[1:]


def test_what_options_do_not_say_is_repeated_by_a_bundle(tmp_path, capsys):
    grid = world_of(_cars_first(*NEEDED), SIZE)
    setup = setup_of("none", "published", gains="fast", drive="wheels")
    steps = (Step.single(0, 0, Action.ROTATE_LEFT),)
    write_bundle(tmp_path / "bundle", "a turn", Recipe(blueprint_text(grid), steps, setup))
    assert (
        cli.main(["replay", str(tmp_path / "bundle"), "--minimize", "--out", str(tmp_path / "out")])
        == 0
    )
    again = _printed(capsys.readouterr().out)
    assert again == ["replay", str(tmp_path / "out" / "bundle")]
    assert cli.main([*again, "--out", str(tmp_path / "again")]) == 0
    assert "Reproduced" in capsys.readouterr().out


def test_learned_rules_have_no_name_that_an_option_takes():
    assert _is_plain(setup_of(rules="published"))
    assert not _is_plain(setup_of(rules=LearnedRules("mine", "published")))


def test_validate_shrinks_its_failures_into_report_and_page(tmp_path, capsys):
    (tmp_path / "site.yaml").write_text(
        blueprint_text(world_of(_cars_first(*NEEDED, *IDLE[3:5]), SIZE))
    )
    (tmp_path / "tries.txt").write_text("1 STOP\n0 ROTATE_LEFT\n")
    out = tmp_path / "out"
    words = [
        "validate",
        str(tmp_path / "site.yaml"),
        "--actions",
        str(tmp_path / "tries.txt"),
        "--out",
        str(out),
    ]
    words += [
        "--rules",
        "published",
        "--drive",
        "wheels",
        "--trials",
        "1",
        "--video",
        "none",
        "--minimize",
    ]
    assert cli.main(words) == 1
    (found,) = json.loads((out / "report.json").read_text())["figures"]["smallest"]
    assert found["sentence"].endswith("when car 1 is in the next cell to the right")
    assert found["minimal"]
    assert found["sentence"] in capsys.readouterr().out
    assert found["sentence"] in (out / "report.html").read_text()
    assert (out / found["folder"] / "smallest.actions").read_text() == "0 ROTATE_LEFT\n"


def test_a_bundle_without_a_failure_of_a_legal_action_is_refused(tmp_path):
    recipe = Recipe(blueprint_text(Grid.empty((3, 1, 1), 1)), (Step.single(0, 0, Action.STOP),))
    bundle = write_bundle(tmp_path, "nothing", recipe)
    with pytest.raises(InputError, match="no action that the rules allow fails"):
        failing_actions(bundle.recipe, bundle.attempts)
