"""IPPO of BenchMARL on batches of worlds, by the environment of torchrl_batched.py."""

from tempfile import mkdtemp

from benchmarl.algorithms import IppoConfig
from benchmarl.environments.common import TaskClass
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from torchrl.data import Composite
from torchrl_batched import BatchedEnv


class Construction(TaskClass):
    """A task by its name. BenchMARL calls what it needs of the specs one by one."""

    def get_env_fun(self, num_envs, continuous_actions, seed, device):
        def make():
            env = BatchedEnv(self.name, num_envs)
            env.set_seed(seed)
            return env.to(device)

        return make

    def supports_continuous_actions(self):
        return False

    def supports_discrete_actions(self):
        return True

    def has_render(self, env):
        return False

    def max_steps(self, env):
        return env.envs.task.max_steps

    def group_map(self, env):
        return {"agents": [f"car_{car}" for car in range(env.n_cars)]}

    def state_spec(self, env):
        return Composite(state=env.full_observation_spec_unbatched["state"].clone())

    def _of_agents(self, env, key):
        agents = env.full_observation_spec_unbatched["agents"].clone()
        chosen = Composite({key: agents[key]}, shape=agents.shape)
        return Composite(agents=chosen)

    def observation_spec(self, env):
        return self._of_agents(env, "observation")

    def action_mask_spec(self, env):
        return self._of_agents(env, "action_mask")

    def info_spec(self, env):
        return None

    def action_spec(self, env):
        return env.full_action_spec_unbatched

    @staticmethod
    def env_name():
        return "craftsim"


config = ExperimentConfig.get_from_yaml()
config.max_n_frames = 2400
config.on_policy_collected_frames_per_batch = 1200
config.on_policy_n_envs_per_worker = 40
config.on_policy_minibatch_size = 100
config.on_policy_n_minibatch_iters = 1
config.evaluation_interval = 1200
config.evaluation_episodes = 1
config.loggers = []
config.create_json = False
config.save_folder = mkdtemp()
experiment = Experiment(
    Construction("strip", {}),
    IppoConfig.get_from_yaml(),
    model_config=MlpConfig.get_from_yaml(),
    critic_model_config=MlpConfig.get_from_yaml(),
    seed=0,
    config=config,
)
experiment.run()
played = experiment.test_env.rollout(18, experiment.policy)
chosen = played["agents", "action"].unsqueeze(-1)
assert played["agents", "action_mask"].gather(-1, chosen).all()
