"""Tasks: worlds with a goal, rewards and observations, one by one and in batches."""

from craftsim.discrete.tasks.task import (
    TASK_NAMES,
    Task,
    TaskName,
    as_task,
    free_play,
    make_task,
    shipped_blueprint,
)

__all__ = ["TASK_NAMES", "Task", "TaskName", "as_task", "free_play", "make_task", "shipped_blueprint"]
