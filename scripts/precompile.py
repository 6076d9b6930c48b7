"""Let a task be planned and played on the grid and in physics, so that all which is compiled is there.

The first that needs a compiled function compiles it, and all others wait: before a test suite it is done beside what
else is to be done.
"""

from __future__ import annotations

import numpy as np

from craftsim.discrete.kinds import Action
from craftsim.discrete.tasks import make_task
from craftsim.envs import vector_env
from craftsim.models.parameters import DRIVES
from craftsim.planning import plan_building


def main() -> None:
    """Take each way through the compiled code once."""
    task = make_task("simple_two_story")
    stops = np.full((1, task.layout.n_cars), int(Action.STOP))
    for options in ({"rule_set": "physical"}, {"rule_set": "published", "helper_depth": 2}):
        envs = vector_env(task, 1, "grid", **options)
        envs.reset(seed=0)
        envs.step(stops)
    plan_building(task.draw(np.random.default_rng(0)), task, rounds=1)
    for drive in DRIVES:
        envs = vector_env(task, 1, "physics", drive=drive, workers=1)
        envs.reset(seed=0)
        envs.step(stops)
        envs.close()


if __name__ == "__main__":
    main()
