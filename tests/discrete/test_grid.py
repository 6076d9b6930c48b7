"""Things are put into worlds and taken out in one place; the move graph says what the rules say of a car alone."""

import numpy as np

from craftsim.discrete.grid import CarField, Grid, Kind, Piece
from craftsim.discrete.kernel.search import SUCCESSORS
from craftsim.discrete.move_graph import UNREACHABLE, MoveGraph, MoveGraphs, cell_of_node
from craftsim.discrete.rules import Rules


def test_what_is_put_is_found_again_and_gone_once_it_is_taken():
    grid = Grid.empty((5, 4, 2))
    things = [
        Piece(Kind.BLOCK, (0, 0, 1)),
        Piece(Kind.FSLOPE, (1, 2, 1), 3),
        Piece(Kind.BODY, (2, 0, 1), 1),
    ]
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


RULES = Rules("physical")


def ramp_world():
    """Return a floor with a ramp up to a block, and a wall."""
    grid = Grid.empty((4, 3, 2))
    grid.kind[0, 1, 1], grid.kind[1, 1, 1], grid.kind[2, 1, 1] = Kind.BLOCK, Kind.BODY, Kind.FOOT
    grid.kind[0, 2, 1] = Kind.WALL
    grid.derive_marks()
    return grid


def at(grid, graph, node, load):
    """Return the world with one car at a node of the graph."""
    x, y, z = cell_of_node(graph.size, node)
    yaw = node % 4
    car = np.zeros((1, len(CarField)), np.int16)
    slope = (
        1
        if grid.kind_at((x, y, z)) == Kind.FOOT
        else 2 * (grid.kind_at((x, y, z - 1)) == Kind.BODY)
    )
    car[0] = x, y, z, yaw, load, (yaw + 2) % 4 if load == Kind.FSLOPE else 0, slope
    return Grid(grid.cells.copy(), car)


def test_its_steps_are_those_of_the_rules():
    for load in (Kind.AIR, Kind.BLOCK, Kind.FSLOPE):
        grid = ramp_world()
        graph = MoveGraph(grid, RULES, load)
        # From the ramp and the landing, too: the way up is found.
        reached = np.flatnonzero(graph.distances_from([graph.node((3, 1, 1), 2)]) < UNREACHABLE)
        assert graph.node((0, 1, 2), 2) in reached
        for node in reached.tolist():
            world = at(grid, graph, node, load)
            for action, there in zip(SUCCESSORS, graph.steps[node].tolist(), strict=True):
                assert RULES.legal(world, 0, action) == (there >= 0)
                if there >= 0:
                    after = RULES.apply(world, 0, action).cars[0].tolist()
                    assert graph.node(tuple(after[:3]), after[CarField.YAW]) == there


def test_distances_from_and_to_agree():
    graph = MoveGraph(ramp_world(), RULES, Kind.BLOCK)
    floor = graph.floor_nodes(graph.numbers[:, :, 1, 0] >= 0)
    for node in floor[::5].tolist():
        goals = graph.nodes(Piece(Kind.BLOCK, (0, 1, 2)))
        assert graph.distances_to(goals)[node] == graph.distances_from([node])[goals].min()
    assert graph.distances_from([])[0] == UNREACHABLE
    assert graph.distances_from([floor[0]])[graph.node((0, 2, 1), 0)] == UNREACHABLE


def test_a_slope_on_the_floor_has_its_gear_there():
    graph = MoveGraph(Grid.empty((3, 1, 1)), RULES, Kind.FSLOPE)
    columns = np.array([[True], [True], [False]])
    cells = {
        (cell_of_node(graph.size, node)[0], node % 4)
        for node in graph.floor_nodes(columns).tolist()
    }
    assert cells == {(1, 0), (0, 2)}


def test_a_world_is_looked_at_once():
    graphs = MoveGraphs(RULES)
    grid = ramp_world()
    first = graphs.graph(grid, Kind.BLOCK)
    assert graphs.graph(grid.copy(), Kind.BLOCK) is first
    assert graphs.graph(grid) is not first
