"""A skill of your own in place of a built-in one: a lift at half speed that feels whether its load has come along.

A skill sees what its car measures, and commands its motors. The same from the command line, from this folder:
craftsim validate strip --skills own_skill:SKILLS
"""

import craftsim
from craftsim import Action, Command, Mecanum, Reason


class GentleLift(craftsim.Skill):
    """Raise the board slowly to its upper stop."""

    time_limit_s = 10.0

    def start(self, measurement):
        """Know how far it is and what forces the car feels."""
        self.end_m = self.setup.machine.board_travel_m
        self.mecanum = Mecanum(self.setup.machine)

    def step(self, measurement):
        """Return the board's speed, or end."""
        left_m = self.end_m - measurement.board_m
        if left_m < 0.0005:
            felt = self.mecanum.felt_forces(measurement, (0.0, 0.0, 0.0, 0.0))
            if felt.board_n > 1.0:
                self.succeed()
            else:
                self.fail(Reason.LOAD_LOST, f"the board is up and feels {felt.board_n:.1f} N")
        return Command(board=min(self.setup.machine.board_speed_m_s / 2, 4 * left_m))


SKILLS = {Action.LIFT: GentleLift}

if __name__ == "__main__":
    for name, skills in (("built in", None), ("own", SKILLS), ("own for car 0 alone", {0: SKILLS})):
        result = craftsim.validate("strip", skills=skills, randomize="none", trials=1)
        lifts = [attempt for attempt in result.attempts if attempt.action == "LIFT"]
        seconds = ", ".join(f"{attempt.duration_s:.2f} s (car {attempt.car})" for attempt in lifts)
        print(f"{name}: {seconds}; all as predicted: {result.agrees}")
