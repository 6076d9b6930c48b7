"""Two different machines in one world: a car with slower, weaker wheels drives beside a standard one."""

from dataclasses import replace

import craftsim
from craftsim import Action

standard = craftsim.SmartcarParameters()
weak = replace(standard, wheel_torque_nm=1.2, wheel_speed_rad_s=8.0)
machines = craftsim.Machines(cars=(standard, weak))

grid = craftsim.Grid.empty((3, 2, 1), n_cars=2)
grid.cars[1, 1] = 1  # the second car's y: it starts in the next row
grid.derive_marks()

physics = craftsim.PhysicsWorld(grid, machines=machines)
executor = craftsim.Executor(physics)
outcomes = executor.run({0: Action.MOVE_RIGHT, 1: Action.MOVE_RIGHT})

for car, outcome in outcomes.items():
    torque = physics.cars[car].parameters.wheel_torque_nm
    print(f"car {car} with {torque:.1f} Nm a wheel: {outcome} after {outcome.duration_s:.2f} s")
assert all(outcome.succeeded for outcome in outcomes.values())
