"""Ask the rules about an action, say why it is forbidden, and try one in physics.

docs/extending.md shows how to add an action of your own, a block that is pushed along the floor, to rules and skills.
"""

import craftsim
from craftsim import Action, Kind

grid = craftsim.Grid.empty((3, 1, 2), n_cars=1)  # one car at (0, 0), two free cells ahead
grid.kind[1, 0, 1] = Kind.BLOCK
grid.kind[2, 0, 1] = Kind.WALL
grid.derive_marks()
rules = craftsim.Rules("physical")

print("now:", [Action(a).name for a in range(15) if rules.legal(grid, 0, a)])
print(rules.explain(grid, 0, Action.LIFT))  # forbidden, and why

site = craftsim.Site(grid)
attempt = craftsim.perform(site, 0, Action.MOVE_RIGHT)
print(attempt)
assert attempt.result == "as predicted"

under_the_block = rules.apply(grid, 0, Action.MOVE_RIGHT)
print("then:", [Action(a).name for a in range(15) if rules.legal(under_the_block, 0, a)])
