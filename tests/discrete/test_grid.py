"""Things are put into worlds and taken out of them in one place."""

from craftsim.discrete.grid import Grid, Kind, Piece


def test_what_is_put_is_found_again_and_gone_once_it_is_taken():
    grid = Grid.empty((5, 4, 2))
    things = [Piece(Kind.BLOCK, (0, 0, 1)), Piece(Kind.FSLOPE, (1, 2, 1), 3), Piece(Kind.BODY, (2, 0, 1), 1)]
    for thing in things:
        grid.put(thing)
    assert [*grid.pieces()] == things
    assert [*grid.pieces(Kind.BODY)] == things[2:]
    assert (grid.kind[1, 1, 1], grid.yaw[1, 1, 1]) == (Kind.GEAR, 3)
    assert (grid.kind[2, 1, 1], grid.yaw[2, 1, 1]) == (Kind.FOOT, 1)
    assert [grid.take(thing.cell) for thing in things] == things
    assert not grid.cells[:, :, 1:, :2].any()


def test_a_gear_gives_way_to_what_stands_and_to_the_end_of_the_map():
    grid = Grid.empty((3, 1, 1))
    grid.put(Piece(Kind.BLOCK, (1, 0, 1)))
    grid.put(Piece(Kind.FSLOPE, (0, 0, 1), 0))
    grid.put(Piece(Kind.FSLOPE, (2, 0, 1), 0))
    assert grid.kind[:, 0, 1].tolist() == [Kind.FSLOPE, Kind.BLOCK, Kind.FSLOPE]
    assert grid.take((0, 0, 1)) == Piece(Kind.FSLOPE, (0, 0, 1), 0)
    assert grid.kind[1, 0, 1] == Kind.BLOCK


def test_a_thing_knows_its_cells_what_it_is_on_a_car_and_how_a_car_stands_below_it():
    ramp = Piece(Kind.BODY, (1, 1, 2), 2)
    assert (ramp.cells, ramp.kinds) == (((1, 1, 2), (0, 1, 2)), (Kind.BODY, Kind.FOOT))
    assert (ramp.load, ramp.yaws) == (Kind.FSLOPE, (0,))
    block = Piece(Kind.BLOCK, (1, 1, 2))
    assert (block.cells, block.load, block.yaws) == (((1, 1, 2),), Kind.BLOCK, (0, 1, 2, 3))
