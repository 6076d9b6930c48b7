"""The spaces that all forms of the environment share, on either backend."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.kernel.tasks import ROW
from craftsim.discrete.tasks import Task
from craftsim.envs.images import Images


def entity_space(task: Task, n_rows: int) -> spaces.Box:
    """Return the space of ``n_rows`` rows of 13 numbers (:mod:`craftsim.discrete.tasks.observation`), flattened."""
    # -2 stands in the coordinates that mean "there is none".
    return spaces.Box(-2, max(task.starts[0].size), (ROW * n_rows,), np.int32)


def state_space(task: Task) -> spaces.Box:
    """Return the space of the global state: the rows of all entities."""
    return entity_space(task, task.layout.n_observed)


def car_space(
    task: Task,
    own: spaces.Space[Any] | None = None,
    images: Images | None = None,
    n_actions: int = N_ACTIONS,
) -> spaces.Dict:
    """Return one car's observation space, and the actions that it is offered.

    What it observes is its own row, then all rows, or an observation of one's ``own``; and images.
    """
    return spaces.Dict(
        {
            "observation": own or entity_space(task, 1 + task.layout.n_observed),
            "action_mask": spaces.Box(0, 1, (n_actions,), np.int8),
            **({} if images is None else images.spaces()),
        }
    )


def central_space(task: Task, images: Images | None = None, n_actions: int = N_ACTIONS) -> spaces.Dict:
    """Return the observation space of one who acts for all cars: the global state, all masks and all images."""
    return spaces.Dict(
        {
            "observation": state_space(task),
            "action_mask": spaces.Box(0, 1, (task.layout.n_cars, n_actions), np.int8),
            **({} if images is None else images.spaces(task.layout.n_cars)),
        }
    )


def joint_action_space(task: Task, n_actions: int = N_ACTIONS) -> spaces.MultiDiscrete:
    """Return the space of one action a car."""
    return spaces.MultiDiscrete([n_actions] * task.layout.n_cars)
