"""Play a policy in randomized physics, and keep the worlds that it reached: half of the episodes then start with one.

A few episodes show how; docs/how-to/train-further.md has what came of a hundred. Training from them, in a shell:

  craftsim train random_strip --network relative --imitate 2000 --starts out/reached.npz --out out/strip
"""

import argparse
from pathlib import Path

import craftsim
from craftsim.envs.parallel import ParallelConstruction
from craftsim.learning.policy import TrainedPolicy
from craftsim.tasks.starts import save_starts

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument(
    "--policy", default="random_strip", help="a trained one, or the name of a shipped one"
)
parser.add_argument("--task", default="random_strip", help="a task with random starts")
parser.add_argument(
    "--randomize", default="strong", help="a preset or a file, drawn for each episode"
)
parser.add_argument("--episodes", type=int, default=2)
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--out", type=Path, default=Path("out/reached.npz"))


def worlds_reached(
    env: ParallelConstruction, policy: TrainedPolicy, seed: int
) -> list[craftsim.Grid]:
    """Return the worlds of an episode before its last tick, as they were read from physics."""
    observations, _ = env.reset(seed=seed)
    worlds = []
    while env.agents:
        worlds.append(env.grid)
        observations, *_ = env.step(policy(observations))
    return worlds[1:]


if __name__ == "__main__":
    asked = parser.parse_args()
    policy = craftsim.load_policy(asked.policy)
    env = craftsim.parallel_env(
        asked.task, "physics", randomization=asked.randomize, drive="wheels"
    )
    reached = []
    for episode in range(asked.episodes):
        reached += worlds_reached(env, policy, asked.seed + episode)
        print(f"episode {episode}: {len(reached)} worlds so far")
    env.close()
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    save_starts(asked.out, reached)
    print(f"{len(reached)} worlds in {asked.out}")
