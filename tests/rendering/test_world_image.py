"""Pictures of the grid: the colours of the films, one size for a world, and only what is there."""

import numpy as np

from craftsim.discrete.drawing import GOAL, KIND_COLOURS, car_colour
from craftsim.discrete.grid import Grid, Kind, Piece
from craftsim.mjcf.parameters import NOMINAL
from craftsim.models.composition import machine_spec
from craftsim.rendering.grid_picture import CELL_PX, MARGIN_PX, Outline, level_shapes, levels_of, world_image


def _world(size=(2, 2, 2), n_cars=1) -> Grid:
    return Grid.empty(size, n_cars)


def _in_bytes(colour):
    return tuple(round(255 * part) for part in colour)


def test_a_tile_has_the_colour_of_what_is_there():
    grid = _world()
    grid.kind[1, 0, 1], grid.kind[0, 1, 2] = Kind.BLOCK, Kind.BLOCK
    image = world_image(grid)
    pitch = 2 * CELL_PX + MARGIN_PX

    def near_the_edge(level, x, y):
        """A place between a block's edge and its inner line, where a car has its nose or a wheel's gap."""
        column = MARGIN_PX + (level - 1) * pitch + x * CELL_PX + CELL_PX // 2
        row = MARGIN_PX + (1 - y) * CELL_PX + round(0.1 * CELL_PX)
        return tuple(image[row, column].tolist())

    block = _in_bytes(KIND_COLOURS[Kind.BLOCK])
    assert near_the_edge(1, 1, 0) == near_the_edge(2, 0, 1) == block
    assert near_the_edge(1, 1, 1) == _in_bytes(KIND_COLOURS[Kind.GROUND])
    car = image[MARGIN_PX + CELL_PX : -MARGIN_PX, MARGIN_PX : MARGIN_PX + CELL_PX].reshape(-1, 3)
    assert (car == _in_bytes(car_colour(0))).all(axis=1).sum() > 200


def test_levels_with_nothing_are_left_out():
    grid = _world((2, 2, 4))
    assert levels_of([grid]) == (1,)
    grid.kind[0, 0, 3] = Kind.BLOCK
    assert levels_of([grid]) == (1, 3)
    assert levels_of([grid], (0, 0, 2)) == (1, 2, 3)
    assert levels_of([grid], None, [Piece(Kind.BLOCK, (0, 0, 4), -1)]) == (1, 3, 4)


def test_a_design_is_dashed_and_a_goal_is_not():
    for kind in (Kind.BLOCK, Kind.BODY, Kind.FOOT):

        def framed(goal, design):
            shapes = [
                s
                for s in level_shapes(_world(), 1, goal, design)
                if isinstance(s, Outline) and s.line == GOAL
            ]
            return sum(np.linalg.norm(np.diff(shape.points, axis=0), axis=1).sum() for shape in shapes)

        whole, dashed = framed((1, 1, 1), []), framed(None, [Piece(kind, (1, 1, 1), 0)])
        assert 0.3 * whole < dashed < 0.7 * whole
        assert framed((1, 1, 2), [Piece(kind, (1, 1, 2), 0)]) == 0


def test_things_have_the_colours_that_films_show():
    for part, geom, kind in (
        ("wall", None, Kind.WALL),
        ("block", None, Kind.BLOCK),
        ("flag", "flag_visual", Kind.FLAG),
        ("slope", None, Kind.BODY),
        ("slope", "flap_visual", Kind.FOOT),
        ("slope", "gear_left_visual", Kind.GEAR),
    ):
        spec = machine_spec(part, NOMINAL)
        shown = [tuple(g.rgba[:3].round(4).tolist()) for g in spec.geoms if geom is None or g.name == geom]
        assert tuple(np.float32(KIND_COLOURS[kind]).round(4).tolist()) in [
            tuple(np.float32(colour).round(4).tolist()) for colour in shown
        ]
