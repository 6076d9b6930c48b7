"""The spaces of all forms, and what a batch of worlds observes in them; images aside."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from craftsim.discrete.grid import Kind
from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.envs.actions import ActionForm
from craftsim.envs.observations import CHANNELS, Observation, local_views
from craftsim.envs.options import Options
from craftsim.tasks import Task
from craftsim.tasks.asynchronous import AsynchronousEpisodes
from craftsim.tasks.episodes import Episodes
from craftsim.tasks.kernel import ROW


def state_space(task: Task) -> spaces.Box:
    """Return the space of the global state: the rows of all entities, 13 numbers each, flattened."""
    return _entity_space(task, task.layout.n_observed)


def _entity_space(task: Task, n_rows: int) -> spaces.Box:
    # -2 stands in the coordinates that mean "there is none".
    return spaces.Box(-2, max(task.starts[0].size), (ROW * n_rows,), np.int32)


def car_space(task: Task, options: Options, form: ActionForm) -> spaces.Dict:
    """Return one car's observation space, and the actions that it is offered.

    It observes its own row, then all rows, or a custom observation; images; and what options add.
    """
    custom_space = None
    if options.observe is not None:
        custom_space = options.observe.space
    return spaces.Dict(
        {
            "observation": custom_space or _entity_space(task, 1 + task.layout.n_observed),
            "action_mask": spaces.Box(0, 1, (form.n_actions,), np.int8),
            **({} if options.images is None else options.images.spaces()),
            **_extra_spaces(task, options, form),
        }
    )


def central_space(task: Task, options: Options, form: ActionForm) -> spaces.Dict:
    """Return the observation space of an agent that acts for all cars: the global state, and all that each observes."""
    n_cars = task.layout.n_cars
    return spaces.Dict(
        {
            "observation": state_space(task),
            "action_mask": spaces.Box(0, 1, (n_cars, form.n_actions), np.int8),
            **({} if options.images is None else options.images.spaces(n_cars)),
            **{
                key: batch_space(space, n_cars)
                for key, space in _extra_spaces(task, options, form).items()
            },
        }
    )


def _extra_spaces(task: Task, options: Options, form: ActionForm) -> dict[str, spaces.Space[Any]]:
    """Return the spaces of what a car observes for its action form, of its local view if it has a radius, and of what
    all cars are doing where they do not act together."""
    extra = dict(form.spaces())
    size = task.starts[0].size
    cells = (*size[:2], size[2] + 1)
    if options.local_view is not None:
        width = 2 * options.local_view + 1
        shape = (width, width, cells[2], CHANNELS)
        extra["local_view"] = spaces.Box(0, max(max(Kind), 3), shape, np.int8)
    if options.timing is not None:
        extra["doing"] = spaces.Box(-1, np.inf, (task.layout.n_cars, 2), np.float32)
        extra["claimed"] = spaces.Box(0, 1, cells, np.int8)
    return extra


def observed(episodes: Episodes, form: ActionForm, radius: int | None) -> Observation:
    """Return what :func:`central_space` is the space of, for each of B worlds; images aside."""
    observation: Observation = {
        "observation": episodes.entity_rows().reshape(len(episodes), -1),
        "action_mask": form.masks(episodes),
        **form.observed(episodes),
    }
    if radius is not None:
        observation["local_view"] = local_views(episodes.grids, episodes.designs, radius)
    if isinstance(episodes, AsynchronousEpisodes):
        observation["doing"], observation["claimed"] = episodes.activity()
    return observation


def joint_action_space(task: Task, n_actions: int = N_ACTIONS) -> spaces.MultiDiscrete:
    """Return the space of one action per car."""
    return spaces.MultiDiscrete([n_actions] * task.layout.n_cars)
