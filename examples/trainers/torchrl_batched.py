"""Batches of worlds as an environment of TorchRL, and a Collector that plays them with masked actions.

It prints frames (ticks of a world) a CPU second, beside those of a loop without TorchRL that asks the same network.
"""

import time

import numpy as np
import torch
from tensordict import TensorDict
from tensordict.nn import InteractionType, TensorDictModule
from torchrl.collectors import Collector
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase
from torchrl.modules import MaskedCategorical, MultiAgentMLP, ProbabilisticActor

import craftsim

ROW = 13  # numbers of an entity in the state
WORLDS = 64
FRAMES = 19_200


class BatchedEnv(EnvBase):
    """B worlds of a task; arguments as of ``vector_env``.

    The group ``agents`` has what each of n cars observes, may do and does, and the team's reward for each.
    """

    def __init__(self, task, num_envs, backend="grid", **options):
        super().__init__(device="cpu", batch_size=[num_envs])
        self.envs = craftsim.vector_env(task, num_envs, backend, **options)
        spaces = self.envs.single_observation_space
        self.n_cars, n_actions = spaces["action_mask"].shape
        state = spaces["observation"]
        low = float(state.low.min())
        high = float(state.high.max())
        length = state.shape[0]
        worlds = (num_envs,)
        cars = (num_envs, self.n_cars)
        agents = Composite(
            observation=Bounded(low, high, (*cars, ROW + length), dtype=torch.float32),
            action_mask=Binary(n_actions, (*cars, n_actions), dtype=torch.bool),
            shape=cars,
        )
        self.observation_spec = Composite(
            agents=agents,
            state=Bounded(low, high, (num_envs, length), dtype=torch.float32),
            success=Binary(1, (num_envs, 1), dtype=torch.bool),
            shape=worlds,
        )
        action = Composite(action=Categorical(n_actions, cars), shape=cars)
        self.action_spec = Composite(agents=action, shape=worlds)
        reward = Composite(reward=Unbounded((*cars, 1)), shape=cars)
        self.reward_spec = Composite(agents=reward, shape=worlds)
        flags = {}
        for key in ("done", "terminated", "truncated"):
            flags[key] = Binary(1, (num_envs, 1), dtype=torch.bool)
        self.done_spec = Composite(flags, shape=worlds)
        self.first_seed = None
        self.observation = None  # with which episodes go on, or begin where one has ended
        self.ended = np.zeros(num_envs, bool)

    def _set_seed(self, seed):
        self.first_seed = seed

    def _reset(self, tensordict=None, **kwargs):
        if tensordict is not None and "_reset" in tensordict:
            chosen = tensordict["_reset"].squeeze(-1).cpu().numpy()
            if (chosen & ~self.ended).any():
                raise ValueError("reset all worlds at once, or those whose episode has ended")
            self.ended = self.ended & ~chosen
        else:
            self.observation, _ = self.envs.reset(seed=self.first_seed)
            self.first_seed = None
            self.ended = np.zeros(self.batch_size, bool)
        no = np.zeros(self.batch_size, bool)
        return self._tensors(self.observation, no, no, no).to(self.device)

    def _step(self, tensordict):
        actions = tensordict["agents", "action"].cpu().numpy()
        observation, reward, terminated, truncated, infos = self.envs.step(actions)
        self.observation = observation
        self.ended = terminated | truncated
        if self.ended.any():
            # The next episodes have begun in the same step; TorchRL asks for them by a reset.
            observation = {key: array.copy() for key, array in observation.items()}
            for world in np.flatnonzero(self.ended):
                for key, array in infos["final_obs"][world].items():
                    observation[key][world] = array
        result = self._tensors(observation, infos["success"], terminated, truncated)
        rewards = torch.as_tensor(reward, dtype=torch.float32)
        result["agents", "reward"] = rewards[:, None, None].repeat(1, self.n_cars, 1)
        return result.to(self.device)

    def _tensors(self, observation, success, terminated, truncated):
        state = torch.as_tensor(observation["observation"], dtype=torch.float32)
        # A car sees its own row, then all rows.
        row = state.unflatten(-1, (-1, ROW))[:, : self.n_cars]
        rows = state[:, None].expand(-1, self.n_cars, -1)
        agents = {
            "observation": torch.cat([row, rows], -1),
            "action_mask": torch.as_tensor(observation["action_mask"], dtype=torch.bool),
        }
        flags = {
            "success": success,
            "terminated": terminated,
            "truncated": truncated,
            "done": terminated | truncated,
        }
        result = TensorDict({}, self.batch_size)
        for key, flag in flags.items():
            result[key] = torch.tensor(flag)[:, None]
        result["state"] = state
        result["agents"] = TensorDict(agents, (*self.batch_size, self.n_cars))
        return result

    def close(self, *, raise_if_closed=True):
        """End the processes of worlds in physics."""
        self.envs.close()
        super().close(raise_if_closed=raise_if_closed)


def masked_actor(env):
    """Return a policy that draws from what is offered, and its network, which the cars share."""
    observation = ("agents", "observation")
    n_cars, length = env.observation_spec[observation].shape[1:]
    n_actions = env.full_action_spec["agents", "action"].space.n
    net = MultiAgentMLP(
        length, n_actions, n_cars, centralized=False, share_params=True, num_cells=[64]
    )
    module = TensorDictModule(net, in_keys=[observation], out_keys=[("agents", "logits")])
    actor = ProbabilisticActor(
        module,
        in_keys={"logits": ("agents", "logits"), "mask": ("agents", "action_mask")},
        out_keys=[("agents", "action")],
        distribution_class=MaskedCategorical,
        default_interaction_type=InteractionType.RANDOM,
        return_log_prob=True,
    )
    return actor, net


@torch.no_grad()
def plain_loop(envs, net, frames):
    """Play so many frames without TorchRL's environment."""
    observation, _ = envs.reset(seed=0)
    for _ in range(frames // envs.num_envs):
        vectors = torch.as_tensor(envs.car_vectors(), dtype=torch.float32)
        mask = torch.as_tensor(observation["action_mask"], dtype=torch.bool)
        policy = torch.distributions.Categorical(logits=net(vectors).masked_fill(~mask, -1e9))
        observation, *_ = envs.step(policy.sample().numpy())


def main():
    env = BatchedEnv("strip", WORLDS)
    env.set_seed(0)
    actor, net = masked_actor(env)
    collector = Collector(
        env,
        actor,
        frames_per_batch=WORLDS * 30,
        total_frames=FRAMES,
        auto_register_policy_transforms=True,
    )
    begin = time.process_time()
    for batch in collector:  # (64, 30), what TorchRL's losses take
        chosen = batch["agents", "action"].unsqueeze(-1)
        assert batch["agents", "action_mask"].gather(-1, chosen).all()
    print(f"TorchRL: {FRAMES / (time.process_time() - begin):,.0f} frames a CPU second")
    collector.shutdown()
    envs = craftsim.vector_env("strip", WORLDS)
    begin = time.process_time()
    plain_loop(envs, net, FRAMES)
    print(f"plain loop: {FRAMES / (time.process_time() - begin):,.0f} frames a CPU second")


if __name__ == "__main__":
    main()
