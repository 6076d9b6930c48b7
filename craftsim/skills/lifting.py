"""Skills of the lifting board: lift and drop."""

from __future__ import annotations

from craftsim.discrete.kernel.jit import compiled
from craftsim.models.measuring import CarMeasurement, Floats, Records
from craftsim.skills.health import end
from craftsim.skills.skill import CompiledSkill, SkillSetup
from craftsim.skills.state import BOARD, BOARD_SHORT, NO_LOAD, SUCCEEDED


@compiled
def board_law(
    readings: Records, tasks: Records, past: Floats, constants: Records, commands: Records, car: int
) -> None:
    """Command the speed of a car's board towards its end, or end the task."""
    now, task, known = readings[car], tasks[car], constants[car]
    board, gains = task.board, known.board
    remaining = board.target_m - now.board_m
    moved = now.board_m - board.last_m
    board.last_m = now.board_m
    still = abs(moved) < gains.still * known.period_s
    if abs(remaining) < gains.reached and still and task.elapsed_s > 0:
        if board.needs_load and not task.feels_load:
            end(task, NO_LOAD, now.board_force_n, 0.0)
        else:
            end(task, SUCCEEDED, 0.0, 0.0)
    elif task.elapsed_s > board.deadline_s:
        end(task, BOARD_SHORT, remaining * 1e3, 0.0)
    limit = min(known.car.board_speed_m_s, abs(board.speed) + gains.acceleration * known.period_s)
    board.speed = max(-limit, min(limit, gains.gain * remaining))
    commands[car].board = board.speed


class MoveBoard(CompiledSkill):
    """Bring the board to one end of its travel at no more than its motor's speed."""

    def __init__(self, setup: SkillSetup, target_m: float) -> None:
        """Prepare to bring the board to ``target_m`` above its lower stop."""
        super().__init__(setup, board_law, BOARD)
        self.target_m = target_m

    def _begin(self, now: CarMeasurement) -> None:
        """Remember where the board is."""
        board = self.task[0]["board"]
        board["target_m"], board["last_m"] = self.target_m, now.board_m
        travel = abs(self.target_m - now.board_m)
        board["deadline_s"] = travel / self.setup.machine.board_speed_m_s + self.setup.gains.board.allowance


class Lift(MoveBoard):
    """Raise the board; it must feel a load at the top."""

    def __init__(self, setup: SkillSetup) -> None:
        """Prepare to raise the board to its upper stop."""
        super().__init__(setup, setup.machine.board_travel_m)
        self.task[0]["board"]["needs_load"] = True


class Drop(MoveBoard):
    """Lower the board until the load stands on its own legs and the board is clear of it."""

    def __init__(self, setup: SkillSetup) -> None:
        """Prepare to lower the board to its lower stop."""
        super().__init__(setup, 0.0)
