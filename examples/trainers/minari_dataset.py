"""Episodes of the planner as a Minari dataset for offline learning, the first of which is played again.

Another policy may take the planner's place: it returns an action for each agent, as in the PettingZoo forms.
"""

import os
from tempfile import mkdtemp

# Where Minari writes and finds datasets; by default in a folder of the home directory.
os.environ.setdefault("MINARI_DATASETS_PATH", mkdtemp())

import gymnasium
import minari
import numpy as np
from minari.data_collector import EpisodeBuffer

import craftsim.envs
from craftsim.envs.planner import PlannerPolicy

BACKEND = "grid"  # or "physics"
EPISODES = 2
NAME = "craftsim/strip/planner-v0"


def stored_info(info, n_cars):
    """Return what the dataset holds of infos; those of a reset lack most."""
    illegal = np.array(info.get("illegal", [False] * n_cars))
    results = np.array(info.get("result", ["as predicted"] * n_cars))
    return {
        "success": info.get("success", False),
        "duration_s": info.get("duration_s", 0.0),
        "illegal": illegal,
        "as_predicted": np.char.startswith(results, "as predicted") & ~illegal,
    }


def play(env, seed):
    """Return an episode as Minari stores it."""
    world = env.unwrapped
    agents = {f"car_{car}": None for car in range(world.core.n_cars)}
    observation, info = env.reset(seed=seed)
    policy = PlannerPolicy(world)
    observations = [observation]
    infos = [stored_info(info, len(agents))]
    actions, rewards, terminations, truncations = [], [], [], []
    while not any(terminations + truncations):
        actions.append(np.array(list(policy(agents).values())))
        observation, reward, terminated, truncated, info = env.step(actions[-1])
        observations.append(observation)
        infos.append(stored_info(info, len(agents)))
        rewards.append(reward)
        terminations.append(terminated)
        truncations.append(truncated)
    return EpisodeBuffer(
        seed=seed,
        observations={key: np.array([step[key] for step in observations]) for key in observation},
        actions=np.array(actions),
        rewards=rewards,
        terminations=terminations,
        truncations=truncations,
        infos={key: np.array([step[key] for step in infos]) for key in infos[0]},
    )


env = gymnasium.make(craftsim.envs.TASK_IDS["strip"], backend=BACKEND)
episodes = [play(env, seed) for seed in range(EPISODES)]
minari.create_dataset_from_buffers(NAME, episodes, env=env, algorithm_name="planner")

dataset = minari.load_dataset(NAME)
replay = dataset.recover_environment()
replay.reset(seed=0)
for step, action in enumerate(dataset[0].actions, start=1):
    observation = replay.step(action)[0]
    np.testing.assert_array_equal(
        observation["observation"], dataset[0].observations["observation"][step]
    )
print(f"{dataset.total_episodes} episodes, {dataset.total_steps} steps, the same when played again")
