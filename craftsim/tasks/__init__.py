"""Tasks: worlds with a goal, rewards and observations, one by one and in batches."""

from craftsim.tasks.random_tasks import random_task
from craftsim.tasks.registry import VARIED_NAMES, as_task, known_task, register_task, task_names
from craftsim.tasks.task import TASK_NAMES, Task, TaskName, free_play, make_task

__all__ = [
    "TASK_NAMES",
    "VARIED_NAMES",
    "Task",
    "TaskName",
    "as_task",
    "free_play",
    "known_task",
    "make_task",
    "random_task",
    "register_task",
    "task_names",
]
