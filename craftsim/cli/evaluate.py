"""``craftsim evaluate``: how often a trained policy succeeds on the grid, and from how many different starts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import tyro

from craftsim.cli.options import Dir
from craftsim.cli.tables import Cells, show
from craftsim.cli.terminal import Terminal
from craftsim.cli.text import say
from craftsim.errors import InputError
from craftsim.report import write_report
from craftsim.storage.folders import owning
from craftsim.storage.limits import BLOCKS, CARS, DESIGN_SIDE, SEED, TRAIN_EPISODES
from craftsim.training.config import Acting
from craftsim.training.extra import need_torch

if TYPE_CHECKING:
    from craftsim.discrete.tasks import Task
    from craftsim.training.policy import TrainedPolicy

EPISODES: Final = 1000


@owning
def evaluate(
    policies: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="POLICY [POLICY ...]", help_behavior_hint=""),
    ],
    task: Annotated[tuple[str, ...], tyro.conf.arg(help_behavior_hint="")] = (),
    episodes: Annotated[int, TRAIN_EPISODES] = EPISODES,
    cars: Annotated[int | None, CARS] = None,
    blocks: Annotated[int | None, BLOCKS] = None,
    area: Annotated[tuple[int, ...], DESIGN_SIDE] = (),
    acting: Acting | None = None,
    seed: Annotated[int, SEED] = 0,
    out: Dir = Path("out/evaluate"),
) -> int:
    """Play trained policies on the grid, and count what differs.

    A deterministic policy plays one start alike each time: what is repeated counts once, and only different starts have
    an interval. Tasks may start otherwise than those of training, but are of the same size, and have as many cars and
    things unless the network looks from a car.
    'craftsim validate --policy' plays it in physics. Exit status 0, or 2 for wrong input.

    Args:
        policies: what 'craftsim train' wrote, files or folders, or shipped ones such as random_strip.
        task: tasks to play, such as random_strip@test; that which a policy was trained on unless given.
        episodes: how many of each; of a list of held-out starts one after the other.
        cars: other than the task's number of cars, for networks that look from a car.
        blocks: the same for blocks.
        area: length, width and height of another area, of tasks that vary.
        acting: do what a policy rates highest, or draw by its probabilities; as it was trained for unless given.
        seed: of starts, of the order in which cars act, and of what is drawn.
        out: folder for report.json.
    """
    if not policies:
        raise InputError("name at least one policy: what 'craftsim train' wrote, a file or a folder")
    need_torch()
    from craftsim.training.evaluation import evaluate as play
    from craftsim.training.policy import load_policy
    from craftsim.training.shape import Shape

    columns = ("policy", "task", "success", "starts solved", "at 95 %", "ways", "ticks")
    games = []
    for path in policies:
        policy = load_policy(path)
        for asked in _tasks(path, policy, task, (cars, blocks, area or None)):
            shape = Shape.of(asked, policy.shape.width, policy.shape.network)
            if not policy.shape.fits(shape):
                raise InputError(
                    f"{path}: its network is for {policy.shape}, task '{asked.name}' is of {shape}; a network serves "
                    "areas of one size, and unless it is relative, one number of cars and things"
                )
            games.append((path, policy, asked))
    rows: list[dict[str, Any]] = []
    lines: list[tuple[str, ...]] = []
    for path, policy, asked in games:
        how = (policy.config.rules, policy.config.helper_depth, acting or policy.config.acting)
        played = play(policy.net, asked, episodes, seed, *how)
        rows.append({"policy": path, "task": asked.name, "acting": how[-1], **played.as_figures()})
        low, high = played.interval or (None, None)
        interval = "one start" if low is None else f"{low:.3f}-{high:.3f}"
        solved = f"{played.solved} of {played.starts}"
        figures = (solved, interval, str(played.trajectories), f"{played.mean_ticks:.1f}")
        lines.append((Path(path).name, asked.name, f"{played.success:.3f}", *figures))
    title = f"{episodes} episodes each; ways are different trajectories"
    show([Cells(title, columns, tuple(lines))], (), Terminal())
    asked_of = {"policies": list(policies), "task": list(task), "episodes": episodes}
    asked_of |= {"cars": cars, "blocks": blocks, "area": list(area)}
    say(f"Report: {write_report(out, {'evaluations': rows}, command='evaluate', seed=seed, config=asked_of)}")
    return 0


def _tasks(
    path: str,
    policy: TrainedPolicy,
    task: tuple[str, ...],
    given: tuple[int | None, int | None, tuple[int, ...] | None],
) -> list[Task]:
    """Return the tasks that are asked for with these numbers of cars and blocks and this area, or a policy's own.

    Names on the command line may be of code. The name in a policy's file may be from anybody.
    """
    from craftsim.discrete.tasks import as_task, known_task

    if task:
        return [as_task(name, *given) for name in task]
    (cars, blocks, area), config = given, policy.config
    try:
        return [
            known_task(
                config.task, n_cars=cars or config.n_cars, n_blocks=blocks or config.n_blocks, area=area
            )
        ]
    except InputError as error:
        raise InputError(
            f"{path}: the task that it was trained on is not there: {error}; name one with --task"
        ) from error
