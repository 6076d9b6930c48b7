"""How often trained policies succeed on the grid, and from how many different starts: validate --backend grid."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from craftsim.errors import InputError
from craftsim.options import Physics, Rollouts, Trials
from craftsim.reports.json_file import document
from craftsim.reports.report import Column, DataTable, Headline, Report, Section, Tone, count
from craftsim.reports.terminal import Terminal
from craftsim.training.config import Acting
from craftsim.training.extra import need_torch

if TYPE_CHECKING:
    from craftsim.discrete.tasks import Task
    from craftsim.training.policy import TrainedPolicy


def play_policies(
    tasks: tuple[str, ...],
    what: Rollouts,
    physics: Physics,
    campaign: Trials,
    area: tuple[int, ...],
    acting: Acting | None,
    out: Path,
) -> int:
    """Play trained policies on the grid, and count what differs; return the exit status.

    A deterministic policy plays one start alike each time: what is repeated counts once, and only different starts have
    an interval. Tasks may start otherwise than those of training, but are of the same size, and have as many cars and
    things unless the network looks from a car.

    Args:
        tasks: to play, such as random_strip@test; that which a policy was trained on unless given.
        what: the policies: what 'craftsim train' wrote, files or folders, or shipped ones such as random_strip; and
            numbers of cars and blocks other than the task's.
        physics: its seed, of starts, of the order in which cars act, and of what is drawn.
        campaign: its trials: how many episodes of each; of a list of held-out starts one after the other.
        area: length, width and height of another area, of tasks that vary.
        acting: do what a policy rates highest, or draw by its probabilities; as it was trained for if None.
        out: folder for report.json.
    """
    task, policies = tasks, [str(policy) for policy in what.policy]
    cars, blocks = what.n_cars, what.n_blocks
    episodes, seed = campaign.trials, physics.seed
    if not policies or what.plan is not None or what.actions is not None:
        raise InputError(
            "on the grid trained policies are played; name one or more with --policy: what 'craftsim train' wrote, a "
            "file or a folder"
        )
    need_torch()
    from craftsim.training.evaluation import evaluate as play
    from craftsim.training.policy import load_policy
    from craftsim.training.shape import Shape

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
    asked_of = {"policies": list(policies), "task": list(task), "episodes": episodes}
    asked_of |= {"cars": cars, "blocks": blocks, "area": list(area)}
    numbers = ("success", "starts solved", "at 95 %", "ways", "ticks")
    columns = (Column("policy"), Column("task"), *(Column(name, "number") for name in numbers))
    table = DataTable(columns, lines, f"{episodes} episodes each; ways are different trajectories")
    sentence = (
        f"{count(len(rows), 'evaluation')} of {count(len(policies), 'policy', 'policies')} on the grid."
    )
    report = Report(
        "Evaluation of policies",
        ", ".join(dict.fromkeys(row["task"] for row in rows)),
        Headline("Evaluated", Tone.PLAIN, sentence),
        sections=[
            Section(
                "evaluations",
                "Evaluations",
                "What repeats itself counts once: only different starts have an interval.",
                [table],
                terminal=True,
            )
        ],
        document=document({"evaluations": rows}, command="evaluate", seed=seed, config=asked_of),
    )
    return report.publish(out, Terminal())


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
