"""Tasks: worlds with a goal, rewards and observations, one by one and in batches."""

from craftsim.discrete.files.shipped import shipped_blueprint
from craftsim.discrete.tasks.registry import as_task, register_task, task_names, task_of
from craftsim.discrete.tasks.task import TASK_NAMES, Task, TaskName, free_play, make_task

__all__ = [
    "TASK_NAMES",
    "Task",
    "TaskName",
    "as_task",
    "free_play",
    "make_task",
    "register_task",
    "shipped_blueprint",
    "task_names",
    "task_of",
]
