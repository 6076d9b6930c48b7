"""Train two cars on a task of my own, on the grid, and let the policy play in physics.

A few seconds of training show that it works, not that it learns: raise --steps to 300,000 for a policy that does.
The same from a shell:  craftsim train --task train_my_task:corner --steps 2000
"""

from pathlib import Path
from typing import Any

import craftsim
from craftsim.cli import main
from craftsim.tasks.rewards import PotentialTerm, Reward

HERE = Path(__file__).parent


def blocks_in_the_corner(grids: craftsim.Grid, designs: Any = None, layout: Any = None) -> Any:
    """Return how many blocks stand in the four cells of the corner; each tick rewards the change of this potential."""
    return (grids.kind[..., :2, :2, 1] == craftsim.Kind.BLOCK).sum(axis=(-2, -1))


def corner() -> craftsim.Task:
    """Return the task: both blocks into the corner."""
    return craftsim.Task(
        name="corner",
        starts=(craftsim.read_blueprint(HERE / "my_task.yaml"),),
        reward=Reward({PotentialTerm(blocks_in_the_corner): 1.0}),
        success=lambda grid: blocks_in_the_corner(grid) == 2,
    )


if __name__ == "__main__":
    out = Path("out/corner")
    options = ["--steps", "2000", "--worlds", "50", "--episodes", "20", "--seed", "0"]
    assert main(["train", "--task", "train_my_task:corner", *options, "--out", str(out)]) == 0

    policy = craftsim.load_policy(out)
    env = craftsim.parallel_env(corner(), "physics")
    observations, infos = env.reset(seed=1)
    for tick in range(3):
        actions = policy(observations)
        observations, rewards, terminations, truncations, infos = env.step(actions)
        print(tick, [craftsim.Action(action).name for action in actions.values()], rewards["car_0"])
    env.close()
