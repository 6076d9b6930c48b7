"""How the physics is computed: step, control period, solver and sleep, with the reason for each."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Literal

from craftsim.storage.limits import Range
from craftsim.storage.records import record

Amount = Annotated[float, Range(0.0, 1.0, below=True)]
"""From 0, which is ideal, to below 1, in whatever unit."""
Length = Annotated[float, Range(0.0, 1.0, above=True, below=True)]
"""In metres."""
Solver = Literal["newton", "pgs"]


@record()
class SimulationConfig:
    """Settings of the simulation; hashable, and written into every report.

    Not to be set: the Newton solver with elliptic cones, and the Euler integrator. The implicit integrators damp the
    stiff wheel servos after the contact forces are solved, which then no longer fit: a car that speeds up hops on its
    rear axle and shakes its load along the board (tests/models/test_driving.py, tests/models/test_load.py).

    Raises InputError, naming the field, for a value that cannot work.

    Example:
        >>> import craftsim
        >>> craftsim.SimulationConfig(timestep_s=0.002).steps_per_period
        10
    """

    timestep_s: Annotated[float, Range(2.5e-4, 0.005)] = 0.004
    """Physics step: verdicts are those of steps of 1 ms, and final poses within 2 mm of theirs (``make bench``,
    tests/skills/test_demo_plan.py). In longer steps rollers lose the ground, servos ring, and a load that an impact
    lifts off its board for one step comes down into it (docs/explanation/drives.md)."""

    control_period_s: Annotated[float, Range(1e-3, 1.0)] = 0.02
    """How often skills are asked for a command: 50 Hz, as a small robot's controller. A multiple of the step."""

    solver: Solver = "newton"
    """Contact solver: Newton converges on these stiff contacts in a few iterations; pgs, which does not, is slower and
    there to compare. MuJoCo's third solver, cg, is not stable on them."""

    solver_iterations: Annotated[int, Range(1, 10_000)] = 1000
    """Most iterations of the solver in one step, ten times what the slowest step of a good run needs. Cars that climb
    on stacked blocks came near MuJoCo's default of 100, and a step that ends there blows the stack apart
    (docs/explanation/physics.md). :attr:`PhysicsWorld.capped_steps` counts the steps that reach it."""

    friction_impedance_ratio: Annotated[float, Range(1e-3, 1e6)] = 300.0
    """How much stiffer friction is than normal contact (MuJoCo's impratio): at 300 a loaded car parked on the slope
    creeps by less than 0.03 mm/s, at 10 by 0.7 (tests/models/test_driving.py)."""

    sleep: bool = True
    """Let resting islands, idle cars included, drop out of the computation until something touches or commands them."""

    sleep_tolerance_m_s: Annotated[float, Range(1e-12, 10.0)] = 1e-4
    """Speed below which an island counts as resting: a tenth of MuJoCo's default, so that slow creep is not hidden."""

    settle_s: Annotated[float, Range(0.0, 60.0)] = 0.3
    """Simulated time after a reset in which the parts come to rest on each other under zero commands."""

    def __post_init__(self) -> None:
        ratio = self.control_period_s / self.timestep_s
        if abs(ratio - round(ratio)) > 1e-9 or round(ratio) < 1:
            raise ValueError(
                f"control_period_s ({self.control_period_s}) must be an integer multiple of "
                f"timestep_s ({self.timestep_s})"
            )

    @cached_property
    def steps_per_period(self) -> int:
        """Number of physics steps between two commands."""
        return round(self.control_period_s / self.timestep_s)
