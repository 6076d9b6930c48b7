"""An action of your own, from one file: an unloaded car turns about in one go, which takes less time than two turns.

Rules, masks, environments, schedules, physics, the judge and the audit know it. For commands, name this module:
craftsim --plugins own_action audit --actions TURN_ABOUT
"""

from functools import partial

import craftsim
from craftsim import Action
from craftsim.skills.skill import begin_turn

RULES = craftsim.Rules("physical")


def why_not(grid, car):
    """Return why a car cannot turn about now, None if it can: where it cannot turn by a quarter, or has a load."""
    if grid.cars[car, 4]:
        return "the car carries something"
    quarter = RULES.explain(grid, car, Action.ROTATE_LEFT)
    return None if quarter.legal else quarter.reason


def turn_about(grid, car):
    """Change the grid as the action does."""
    grid.cars[car, 3] = (grid.cars[car, 3] + 2) % 4


TURN_ABOUT = craftsim.register_action(
    "TURN_ABOUT", why_not, turn_about, duration_s=1.18, skill=partial(begin_turn, quarter=2)
)

if __name__ == "__main__":
    grid = craftsim.Grid.empty((3, 2, 1), n_cars=1)
    print(RULES.explain(grid, 0, TURN_ABOUT))

    attempt = craftsim.perform(craftsim.PhysicsWorld(grid), 0, TURN_ABOUT)
    print(f"in physics: {attempt.result}, {attempt.duration_s:.2f} s")
    assert attempt.result == "as predicted"

    for backend in ("grid", "physics"):
        env = craftsim.parallel_env("strip", backend, actions=("TURN_ABOUT",))
        env.reset(seed=0)
        print(f"{backend}: {env.action_space('car_0')}")
        _, _, _, _, infos = env.step({"car_0": 15, "car_1": 10})
        print(f"  heading {env.grid.cars[0, 3]} after {infos['car_0']['duration_s']:.2f} s")
        env.close()
