"""IPPO of BenchMARL on a task of its PettingZoo kind; TorchRL's wrapper finds the masks in the infos."""

from tempfile import mkdtemp

import gymnasium
import numpy as np
from benchmarl.algorithms import IppoConfig
from benchmarl.environments.pettingzoo.common import PettingZooClass
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from pettingzoo.utils import BaseParallelWrapper
from torchrl.envs import PettingZooWrapper
from torchrl.envs.utils import MarlGroupMapType

from craftsim.envs import parallel_env


class Plain(BaseParallelWrapper):
    """Observes the vector as numbers; the mask is in the infos."""

    def observation_space(self, agent):
        box = self.env.observation_space(agent)["observation"]
        return gymnasium.spaces.Box(
            float(box.low.min()), float(box.high.max()), box.shape, np.float32
        )

    def reset(self, seed=None, options=None):
        seen, infos = super().reset(seed, options)
        return {agent: of["observation"].astype(np.float32) for agent, of in seen.items()}, infos

    def step(self, actions):
        seen, *rest = super().step(actions)
        return {agent: of["observation"].astype(np.float32) for agent, of in seen.items()}, *rest


class Construction(PettingZooClass):
    def get_env_fun(self, num_envs, continuous_actions, seed, device):
        return lambda: PettingZooWrapper(
            Plain(parallel_env(self.name, "grid")),
            group_map=MarlGroupMapType.ALL_IN_ONE_GROUP,
            categorical_actions=True,
            seed=seed,
            device=device,
        )

    def supports_continuous_actions(self):
        return False

    def supports_discrete_actions(self):
        return True

    def has_render(self, env):
        return False

    def max_steps(self, env):
        return 20


config = ExperimentConfig.get_from_yaml()
config.max_n_frames = 400
config.on_policy_collected_frames_per_batch = 200
config.on_policy_n_envs_per_worker = 2
config.on_policy_minibatch_size = 100
config.on_policy_n_minibatch_iters = 1
config.evaluation_interval = 200
config.evaluation_episodes = 1
config.loggers, config.create_json, config.save_folder = [], False, mkdtemp()
experiment = Experiment(
    Construction("strip", {}),
    IppoConfig.get_from_yaml(),
    model_config=MlpConfig.get_from_yaml(),
    critic_model_config=MlpConfig.get_from_yaml(),
    seed=0,
    config=config,
)
experiment.run()
played = experiment.test_env.rollout(20, experiment.policy)
chosen = played["agents", "action"].unsqueeze(-1)
assert played["agents", "action_mask"].gather(-1, chosen).all()
