"""PPO in one file, in the manner of CleanRL: cars share a network and the team's reward; on the grid of a task.

Prints in which share of the last training episodes, and of greedy episodes, the goal was reached.
"""

import argparse
from collections import defaultdict, deque

import numpy as np
import torch
from torch import nn
from torch.distributions import Categorical
from torch.nn import functional

import craftsim

WORLDS = 64
TICKS = 36  # of each world in a rollout
EPOCHS = 4
MINIBATCHES = 4
LEARNING_RATE = 1e-3  # falls to 0
GAMMA = 0.95
DECAY = 0.9  # lambda of generalized advantages
CLIP = 0.2
ENTROPY = 0.02
MAX_GRADIENT = 0.5
WIDTH = 128
ROW = 13  # numbers of an entity in the state


class Agent(nn.Module):
    """Rates the actions of each car, and the return to come, from one-hot numbers."""

    def __init__(self, envs):
        super().__init__()
        state_space = envs.single_observation_space["observation"]
        self.n_cars, n_actions = envs.single_observation_space["action_mask"].shape
        self.low = int(state_space.low.min())
        self.n_values = int(state_space.high.max()) - self.low + 1
        n_inputs = (ROW + state_space.shape[0]) * self.n_values + self.n_cars
        self.first = nn.Linear(n_inputs, WIDTH)
        self.second = nn.Linear(WIDTH, WIDTH)
        self.actor = nn.Linear(WIDTH, n_actions)
        self.critic = nn.Linear(WIDTH, 1)

    def forward(self, state, mask):
        """Return distributions over actions and values, each (B, n), of states (B, 13 * rows)."""
        row = state.unflatten(-1, (-1, ROW))[:, : self.n_cars]  # its own
        rows = state[:, None].expand(-1, self.n_cars, -1)
        numbers = torch.cat([row, rows], -1) - self.low
        one_hot = functional.one_hot(numbers, self.n_values).flatten(-2).float()
        which_car = torch.eye(self.n_cars).expand(len(state), -1, -1)
        hidden = self.first(torch.cat([one_hot, which_car], -1)).relu()
        hidden = self.second(hidden).relu()
        logits = self.actor(hidden).masked_fill(~mask, -1e9)
        return Categorical(logits=logits), self.critic(hidden).squeeze(-1)


def tensors(observation):
    """Return states, int64, and masks, bool."""
    state = torch.as_tensor(observation["observation"], dtype=torch.int64)
    return state, torch.as_tensor(observation["action_mask"], dtype=torch.bool)


@torch.no_grad()
def collect(envs, agent, observation, successes):
    """Return a rollout by name, each (T, B, ...), and the observation after it; append how episodes ended."""
    columns = defaultdict(list)
    for _ in range(TICKS):
        state, mask = tensors(observation)
        policy, value = agent(state, mask)
        action = policy.sample()
        observation, reward, terminated, truncated, infos = envs.step(action.numpy())
        done = terminated | truncated
        successes.extend(infos["success"][done])
        reward = torch.as_tensor(reward, dtype=torch.float32)[:, None].repeat(1, agent.n_cars)
        if truncated.any():
            # A time limit is no end of the task: what could have followed counts.
            last = infos["final_obs"][truncated]
            batch = {key: np.stack([single[key] for single in last]) for key in observation}
            reward[truncated] += GAMMA * agent(*tensors(batch))[1]
        columns["state"].append(state)
        columns["mask"].append(mask)
        columns["action"].append(action)
        columns["log_prob"].append(policy.log_prob(action))
        columns["value"].append(value)
        columns["reward"].append(reward)
        columns["goes_on"].append(torch.as_tensor(~done)[:, None])
    rollout = {key: torch.stack(column) for key, column in columns.items()}
    later_value = agent(*tensors(observation))[1]
    advantage = torch.zeros_like(later_value)
    advantages = torch.zeros_like(rollout["value"])
    for tick in reversed(range(TICKS)):
        goes_on = rollout["goes_on"][tick]
        target = rollout["reward"][tick] + GAMMA * goes_on * later_value
        later_value = rollout["value"][tick]
        advantage = target - later_value + GAMMA * DECAY * goes_on * advantage
        advantages[tick] = advantage
    rollout["advantage"] = advantages
    rollout["return"] = advantages + rollout["value"]
    return rollout, observation


def ppo_loss(agent, batch):
    """Return the clipped objective, the error of the values and the entropy, weighted."""
    policy, value = agent(batch["state"], batch["mask"])
    ratio = (policy.log_prob(batch["action"]) - batch["log_prob"]).exp()
    advantage = batch["advantage"]
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    gain = torch.minimum(ratio * advantage, ratio.clamp(1 - CLIP, 1 + CLIP) * advantage)
    error = (value - batch["return"]).square()
    return 0.5 * error.mean() - gain.mean() - ENTROPY * policy.entropy().mean()


def train(task, steps, seed):
    """Return an agent that has learned from so many ticks, counted over all worlds."""
    torch.manual_seed(seed)
    envs = craftsim.vector_env(task, WORLDS)
    agent = Agent(envs)
    optimizer = torch.optim.Adam(agent.parameters(), LEARNING_RATE)
    observation, _ = envs.reset(seed=seed)
    successes = deque(maxlen=500)
    n_updates = max(1, steps // (WORLDS * TICKS))
    for update in range(n_updates):
        optimizer.param_groups[0]["lr"] = LEARNING_RATE * (1 - update / n_updates)
        rollout, observation = collect(envs, agent, observation, successes)
        flat = {key: column.flatten(0, 1) for key, column in rollout.items()}
        for _ in range(EPOCHS):
            for rows in torch.randperm(WORLDS * TICKS).chunk(MINIBATCHES):
                loss = ppo_loss(agent, {key: column[rows] for key, column in flat.items()})
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), MAX_GRADIENT)
                optimizer.step()
        if update % 10 == 9:
            print(f"{(update + 1) * WORLDS * TICKS} steps: {np.mean(successes):.2f}", flush=True)
    return agent


@torch.no_grad()
def greedy_success(task, agent, episodes=100):
    """Return in which share of episodes the actions that are rated best reach the goal."""
    envs = craftsim.vector_env(task, episodes)
    observation, _ = envs.reset(seed=1)
    running = np.ones(episodes, bool)
    succeeded = np.zeros(episodes, bool)
    while running.any():
        policy, _ = agent(*tensors(observation))
        actions = policy.logits.argmax(-1).numpy()
        observation, _, terminated, truncated, infos = envs.step(actions)
        succeeded |= running & infos["success"]
        running &= ~(terminated | truncated)
    return succeeded.mean()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", default="strip")
    parser.add_argument("--steps", type=int, default=120_000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    learned = train(args.task, args.steps, args.seed)
    print(f"greedy success: {greedy_success(args.task, learned):.2f}")
