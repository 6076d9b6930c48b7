"""PettingZoo's forms of asynchronous execution, in which each car decides when its own action has ended."""

from __future__ import annotations

from typing import Any

from pettingzoo import AECEnv

from craftsim.discrete.kinds import Action
from craftsim.envs.asynchronous_core import AsynchronousCore
from craftsim.envs.observations import Observation
from craftsim.envs.options import Options
from craftsim.envs.parallel import CarWorld, Infos, ParallelConstruction, ParallelStep
from craftsim.tasks import Task

_STOP = int(Action.STOP)


class AsynchronousParallel(ParallelConstruction):
    """The parallel form: in each step the cars of :attr:`agents_to_act` decide, the others' actions are ignored.

    A step runs to the next event. An agent's reward comes when its own action ends: the sum of the shared rewards of
    that time. docs/reference/environments.md describes observations and infos.
    """

    core: AsynchronousCore

    @property
    def agents_to_act(self) -> list[str]:
        """The agents that decide, in the order in which they are asked."""
        return [self.possible_agents[car] for car in self.core.turns]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], Infos]:
        """Begin an episode, in which all agents decide first."""
        observations, infos = super().reset(seed, options)
        return observations, {agent: info | {"ignored": False} for agent, info in infos.items()}

    def step(self, actions: dict[str, int]) -> ParallelStep:
        """Let the agents that decide begin their actions, and run to the next event.

        Raises InputError where no episode runs, and if such an agent's action is missing or none.
        """
        self.core.require_episode()
        acting = self.agents_to_act
        waiting = {agent: _STOP for agent in self.agents if agent not in acting}
        observations, _, terminated, truncated, infos = super().step(waiting | actions)
        for agent, info in infos.items():
            info["ignored"] = agent in actions and agent not in acting
        rewards = {agent: info["earned"] for agent, info in infos.items()}
        return observations, rewards, terminated, truncated, infos


class AsynchronousConstruction(CarWorld, AECEnv[str, Observation, int]):
    """The AEC form: ``agent_selection`` is the car that decides next, with masks and observations of that moment.

    When all that decide have, time passes to the next event. Rewards are shared; those that an agent has accumulated
    when it is its turn again are those of its action.
    """

    core: AsynchronousCore

    def __init__(self, task: Task | str, options: Options) -> None:
        """Prepare a task; the first episode begins with :meth:`reset`."""
        super().__init__(task, options)
        self.metadata["is_parallelizable"] = False

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Begin an episode; see :meth:`craftsim.envs.core.Core.reset` for the options."""
        infos = self.core.reset(seed, options)
        self.agents = self.possible_agents[:]
        self.infos = dict(zip(self.agents, infos, strict=True))
        self.rewards = dict.fromkeys(self.agents, 0.0)
        self._cumulative_rewards = dict.fromkeys(self.agents, 0.0)
        self.terminations = dict.fromkeys(self.agents, False)
        self.truncations = dict.fromkeys(self.agents, False)
        self._skip_agent_selection = None
        self.agent_selection = self.agents[self.core.turns[0]]

    def observe(self, agent: str) -> Observation:
        """Return what an agent observes now, what has begun already included."""
        return self.observe_all()[agent]

    def step(self, action: int | None) -> None:
        """Let the selected agent begin an action; if it is the last to decide, time passes to the next event.

        Raises InputError where no episode runs, and for what is no action.
        """
        if not self.agents:
            self.core.require_episode()
        agent = self.agent_selection
        if self.terminations[agent] or self.truncations[agent]:
            self._was_dead_step(action)
            return
        self.core.begin(self.possible_agents.index(agent), action)  # type: ignore[arg-type]
        self._cumulative_rewards[agent] = 0.0
        self._clear_rewards()
        if not self.core.turns:
            reward, terminated, truncated, infos = self.core.advance()
            self.rewards = dict.fromkeys(self.agents, reward)
            self.terminations = dict.fromkeys(self.agents, terminated)
            self.truncations = dict.fromkeys(self.agents, truncated)
            self.infos = dict(zip(self.agents, infos, strict=True))
        else:
            for car, mask in enumerate(self.core.masks.copy()):
                self.infos[self.possible_agents[car]]["action_mask"] = mask
        self._accumulate_rewards()
        if self.core.turns:
            self.agent_selection = self.possible_agents[self.core.turns[0]]
        else:
            self.agent_selection = self.agents[0]
