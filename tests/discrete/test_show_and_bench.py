"""Worlds as text and pictures, and the commands that show and measure."""

import json

import numpy as np
import pytest
from benches import ToAndFro, yard

from craftsim.cli import main
from craftsim.cli.bench import three_digits
from craftsim.discrete.drawing import GOAL, KIND_COLOURS, car_colour, world_text
from craftsim.discrete.grid import Kind


def test_text_shows_levels_from_the_top_with_y_up(scene, car):
    objects = [
        (Kind.BLOCK, (0, 0, 1)),
        (Kind.BLOCK, (0, 0, 2)),
        (Kind.BODY, (1, 1, 1), 0),
        (Kind.WALL, (2, 0, 1)),
    ]
    grid = scene(objects, [car(0, 0, 3, yaw=2, load=Kind.FLAG), car(0, 1, yaw=1)], size=(3, 2, 2))
    lines = [line.rstrip() for line in world_text(grid, goal=(1, 0, 1)).plain.splitlines()]
    assert lines == [
        "level 3",
        "  1  .     .  .",
        "  0  .0←f  .  .",
        "    0     1  2",
        "level 2",
        "  1  .  .  .",
        "  0 []  .  .",
        "    0  1  2",
        "level 1",
        "  1  .1↑ B→  f→",
        "  0 []    .* ##",
        "    0    1   2",
    ]


def test_show_prints_a_shipped_world_and_writes_its_picture(tmp_path, capsys):
    import cv2

    assert main(["show", "breaking_barrier", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "0→*" in out
    assert "5 x 5 cells, 2 levels: 2 cars, 8 blocks, 0 slopes" in out
    picture = cv2.imread(str(tmp_path / "breaking_barrier.png"))
    assert picture is not None
    colours = {
        tuple(colour) for colour in np.unique(picture.reshape(-1, 3), axis=0)[:, ::-1].tolist()
    }
    wanted = [car_colour(0), car_colour(1), KIND_COLOURS[Kind.BLOCK], GOAL]
    assert {tuple(round(255 * part) for part in colour) for colour in wanted} <= colours


def test_show_marks_the_cells_of_a_goal_file_of_one_s_own(tmp_path):
    import cv2

    (tmp_path / "goal.yaml").write_text("block:\n  - {id: 0, x: 0, y: 0, z: 1}\n")
    show = ["show", "free_building", "--out", str(tmp_path)]
    green = []
    for goal in ([], ["--goal", str(tmp_path / "goal.yaml")]):
        assert main([*show, *goal]) == 0
        picture = cv2.imread(str(tmp_path / "free_building.png"))
        green.append(
            int((picture[:, :, ::-1] == [round(255 * part) for part in GOAL]).all(axis=2).sum())
        )
    assert green[0] == 0
    assert green[1] > 100


CASES = {
    "rules": {"primitive, 20 worlds", "helper, 20 worlds", "helper, 1 world"},
    "env": {
        f"{form}, helper {used}"
        for form in ("PettingZoo", "vector, 20 worlds")
        for used in ("yes", "no")
    },
    "physics": {"rollers", "wheels"},
}


@pytest.mark.parametrize("what", CASES)
def test_bench_measures_each_case(what, tmp_path, capsys):
    assert main(["bench", what, "--seconds", "0.02", "--worlds", "20", "--out", str(tmp_path)]) == 0
    printed, page = capsys.readouterr().out, (tmp_path / f"{what}.md").read_text()
    rates = json.loads((tmp_path / "report.json").read_text())["wall"]["rates"]
    assert set(rates) == {"simple_two_story", "complex_two_story"}
    for task, cases in rates.items():
        assert set(cases) == CASES[what]
        for name, rate in cases.items():
            assert f"| {task} | {name} | {three_digits(rate)} |" in page
            assert three_digits(rate) in printed


def test_the_commands_of_an_episode_are_replayed_to_the_same_end():
    episode = ToAndFro(yard(2, 3), drive="wheels")
    assert len(episode.periods) > 50
    episode.reset()
    episode.replay()  # raises an error where it ends elsewhere
