"""A world, its rules, a plan and physics: a notebook in percent format, which runs as a script, too."""

# %% A world
from pathlib import Path

import numpy as np

import craftsim
from craftsim import Action

HERE = Path(__file__).parent if "__file__" in globals() else Path()
grid = craftsim.read_blueprint(HERE / "yard.yaml").grid(np.random.default_rng(0))
rules = craftsim.Rules()

# %% Which actions are legal now, and why is one not?
for car in range(grid.n_cars):
    print(f"car {car}:", [action.name for action in Action if rules.mask(grid)[car, action]])
print(rules.explain(grid, 1, Action.MOVE_FORWARD))

# %% The rules predict, physics performs, and poses are read
physics = craftsim.PhysicsWorld(grid)
attempt = craftsim.perform(physics, car=1, action=Action.ROTATE_LEFT)
print(attempt)

# %% A plan, in three worlds with randomized physics
result = craftsim.validate(
    HERE / "yard.yaml", plan=HERE / "carry.plan", randomize="mild", trials=3, seed=1
)
print(result)

# %% Every action as a table
actions = result.to_frame()
print((1e3 * actions.groupby("action")[["car_error_m", "placed_error_m"]].max()).round(2))

# %% A plan for a building of two storeys
goal = craftsim.discrete.files.design.read_design(HERE / "yard_goal.yaml")
found = craftsim.plan(grid, goal, rounds=5)
print(
    f"{len(found.ticks)} ticks, {found.makespan_s:.1f} s; no plan takes less than {found.bound_s:.1f} s"
)
