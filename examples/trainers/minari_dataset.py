"""Episodes of the planner as a Minari dataset for offline learning."""

from tempfile import mkdtemp

import minari

import craftsim
from craftsim.envs.datasets import write_dataset
from craftsim.envs.planner import PlannerPolicy

env = craftsim.parallel_env("strip", "grid")
folder = mkdtemp()
written = write_dataset(env, lambda seed: PlannerPolicy(env), folder, "craftsim/strip/planner-v0", episodes=2)
dataset = minari.MinariDataset(written.path / "data")
for episode in dataset.iterate_episodes():
    print(episode.observations["observation"].shape, episode.actions.shape, episode.rewards.sum())
replayed = dataset.recover_environment()
