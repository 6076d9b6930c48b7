"""One control period of all cars, compiled: their laws are stepped, and their commands reach the motors."""

from __future__ import annotations

from craftsim.discrete.kernel.jit import compiled
from craftsim.models.measuring import Floats, Records, drive_wheels
from craftsim.skills.driving_law import drive_law
from craftsim.skills.folding import hinge_law
from craftsim.skills.ground import feel_ground
from craftsim.skills.health import check_health
from craftsim.skills.leading import lead_wheels
from craftsim.skills.lifting import board_law
from craftsim.skills.state import BOARD, DRIVE, HINGE, HOLD, IDLE, OWN, RUNNING


@compiled
def step_cars(
    readings: Records,
    tasks: Records,
    past: Floats,
    constants: Records,
    commands: Records,
    cars: Records,
    plugs: Records,
    docked: Records,
    leads: Records,
    grounds: Records,
    wheel_speeds: Floats,
    wheel_share: float,
    ctrl: Floats,
) -> int:
    """Step all cars that are not idle, and command their motors; return how many compiled tasks have ended.

    A law is stepped as :meth:`craftsim.skills.skill.Skill.step` does; a task that has ended stops all.

    Args:
        readings: (n,) READING, what the cars measure.
        tasks: (n,) TASK.
        past: (n, m) what laws remember of the last periods.
        constants: (n,) CONSTANTS.
        commands: (n,) COMMAND; those of skills in Python are given, the others are written.
        cars: (n,) WIRING.
        plugs: PLUG of each slope.
        docked: (n,) the slope that each car commands, -1 for none.
        leads: (n,) LEAD, what the cars know of their motors' lag.
        grounds: (n,) GROUND, what they feel of their floor.
        wheel_speeds: (n, 4) commands to the wheels' servos so far.
        wheel_share: share by which these approach new ones in a period.
        ctrl: MjData.ctrl.
    """
    ended = 0
    for car in range(len(tasks)):
        task, known = tasks[car], constants[car]
        level = feel_ground(grounds[car], readings[car], task, known)
        if task.law == IDLE:
            continue
        wheels = commands[car].wheels
        if task.law != OWN:
            wheels[0] = wheels[1] = wheels[2] = wheels[3] = commands[car].board = commands[car].hinge = 0.0
        if task.law == HOLD:
            # The wheels go back where the car's weight has turned them (craftsim/skills/holding.py).
            for wheel in range(4):
                task.turned[wheel] += readings[car].wheel_speeds[wheel] * known.period_s
                off = abs(task.turned[wheel]) > known.hold.dead_band
                wheels[wheel] = -known.hold.gain * task.turned[wheel] if off else 0.0
        elif task.law != OWN:
            if task.status == RUNNING:
                check_health(readings, tasks, constants, car)
            if task.status == RUNNING:
                if task.law == DRIVE:
                    drive_law(readings, tasks, past, constants, commands, car)
                elif task.law == BOARD:
                    board_law(readings, tasks, past, constants, commands, car)
                elif task.law == HINGE:
                    hinge_law(readings, tasks, past, constants, commands, car)
                task.elapsed_s += known.period_s
            if task.status != RUNNING:
                wheels[0] = wheels[1] = wheels[2] = wheels[3] = commands[car].board = commands[car].hinge = (
                    0.0
                )
                ended += 1
        lead_wheels(leads[car], wheels, readings[car].wheel_speeds, known.car, known.period_s, level)
        drive_wheels(wheels, wheel_speeds[car], wheel_share, cars[car], ctrl)
        ctrl[cars[car].board_motor] = commands[car].board
        slope, last = readings[car].slope, docked[car]
        # A slope that loses its car loses the command.
        if last >= 0 and last != slope:
            ctrl[plugs[last].motor] = 0.0
        if slope >= 0:
            ctrl[plugs[slope].motor] = commands[car].hinge
        docked[car] = slope
    return ended
