"""Worlds as text and pictures, and the commands that show and measure."""

import json

import numpy as np
import pytest

from craftsim.cli import main
from craftsim.discrete.drawing import CAR_COLOUR, CELL_PX, COLOURS, world_image, world_text
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


def test_a_picture_has_a_tile_a_cell_in_the_colour_of_what_is_there(scene, car):
    grid = scene([(Kind.BLOCK, (1, 0, 1)), (Kind.WALL, (0, 1, 2))], [car(0, 0)], size=(2, 2, 2))
    image = world_image(grid)
    gap, half = CELL_PX // 2, CELL_PX // 2
    assert image.shape == (2 * CELL_PX + 2 * gap, 2 * (2 * CELL_PX + gap) + gap, 3)

    def centre(level, x, y):
        column = gap + (level - 1) * (2 * CELL_PX + gap) + x * CELL_PX + half
        return tuple(image[gap + (1 - y) * CELL_PX + half, column].tolist())

    assert centre(1, 0, 0) == CAR_COLOUR
    assert centre(1, 1, 0) == COLOURS[Kind.BLOCK]
    assert centre(1, 1, 1) == COLOURS[Kind.AIR]
    assert centre(2, 0, 1) == COLOURS[Kind.WALL]


def test_show_prints_a_shipped_world_and_writes_its_picture(tmp_path, capsys):
    import cv2

    assert main(["show", "breaking_barrier", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "0→*" in out
    assert "5 x 5 cells, 2 levels: 2 cars, 8 blocks, 0 slopes" in out
    picture = cv2.imread(str(tmp_path / "breaking_barrier.png"))
    assert picture is not None
    assert np.unique(picture.reshape(-1, 3), axis=0).shape[0] > 4


def test_show_tells_what_is_wrong_with_a_file(tmp_path, capsys):
    (tmp_path / "b.yaml").write_text("area_length: 3\narea_widht: 3\n")
    assert main(["show", str(tmp_path / "b.yaml")]) == 2
    assert "b.yaml:2: unknown key 'area_widht'; did you mean 'area_width'" in capsys.readouterr().err


@pytest.mark.parametrize("rules", ["published", "physical"])
def test_bench_measures_both_works_and_the_memory(rules, tmp_path, capsys):
    small = ["--seconds", "0.02", "--worlds", "20", "--memory-worlds", "50", "--rules", rules]
    assert main(["bench", "rules", *small, "--out", str(tmp_path)]) == 0
    assert "50 worlds of complex_two_story" in capsys.readouterr().out
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["figures"]["bytes_a_world"] == 624
    rates = report["wall"]["rates"]
    assert set(rates) == {"simple_two_story", "complex_two_story"}
    for cases in rates.values():
        assert set(cases) == {"primitive, 20 worlds", "helper, 20 worlds", "helper, 1 world"}
        assert min(rate["steps_a_second"] for rate in cases.values()) > 100
