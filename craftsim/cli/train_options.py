"""The options of ``craftsim train``: settings of a run in groups, and the hyperparameters of its algorithm.

None stands for what is not given: a preset, the algorithm or the task settles it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from cyclopts import Group, Parameter

from craftsim.discrete.kinds import Execution
from craftsim.errors import InputError
from craftsim.learning.algorithms import (
    ALGORITHMS,
    AlgoName,
    default_of,
    enumerated,
    names_of,
    readers_of,
    setting_range,
    with_trait,
)
from craftsim.learning.ranges import RUN_RANGES
from craftsim.learning.settings import Device, Settings
from craftsim.mjcf.drives import Drive
from craftsim.storage.limits import WORKERS, Range
from craftsim.validation.options import PHYSICS, number, option_name
from craftsim.workers.pool import Engine

LEARNING: Final = Group("Learning", sort_key=4)
EXPLORATION: Final = Group("Exploration, demonstrations and curriculum", sort_key=5)
EVERY_ALGORITHM: Final = Group("Hyperparameters of every algorithm", sort_key=6)


def _groups() -> dict[type[Settings], Group]:
    groups: dict[type[Settings], Group] = {}
    for algorithm in ALGORITHMS.values():
        settings = algorithm.settings
        title = f"Hyperparameters of {enumerated(names_of(settings))}"
        groups.setdefault(settings, Group(title, sort_key=7 + len(groups)))
    return groups


OF_ALGORITHM: Final = _groups()
"""The headings of the help. A hyperparameter stands under each algorithm that reads it."""


def _grid_worlds() -> str:
    """Return the default numbers of worlds on the grid in words, the largest first."""
    readers: dict[int, list[str]] = {}
    for name, algorithm in ALGORITHMS.items():
        readers.setdefault(algorithm.grid_worlds, []).append(name)
    *largest, smallest = sorted(readers, reverse=True)
    texts = [f"{number} for {enumerated(readers[number])}" for number in largest]
    return ", ".join([*texts, f"{smallest} for the others"])


def _option(text: str, **parameter_options: Any) -> Parameter:
    return Parameter(help=text, **parameter_options)


def _run_number(field: str, **parameter_options: Any) -> Parameter:
    """Return the annotation of an option that is a field of a run's configuration."""
    return number(RUN_RANGES[field], **parameter_options)


@Parameter(name="*", group=LEARNING)
@dataclass(frozen=True, kw_only=True)
class Learning:
    """The network, the episodes and the evaluations of a run."""

    worlds: Annotated[
        int | None,
        _run_number(
            "worlds",
            help="parallel worlds",
            show_default=f"32 in physics; on the grid {_grid_worlds()}",
        ),
    ] = None
    network: Annotated[
        Literal["map", "relative", "linear"] | None,
        _option(
            "network for one map, relative to each car, for any number of cars and objects, or linear in observations",
            show_default="map",
        ),
    ] = None
    width: Annotated[
        int | None, _run_number("width", help="width of the hidden layers", show_default="128")
    ] = None
    recurrent: Annotated[
        bool | None,
        _option(
            "remember: a GRU over observations and last actions, for "
            f"{enumerated(with_trait('is_recurrent'))}",
            show_default="no",
        ),
    ] = None
    last_action: Annotated[
        bool | None, _option("a GRU sees what its car did last", show_default="yes")
    ] = None
    reward: Annotated[
        Literal["paper", "published_code"] | None,
        _option(
            "of the paper's tasks: as it is written, or as its code has it", show_default="paper"
        ),
    ] = None
    ends_on_success: Annotated[
        bool | None, _option("success ends an episode", show_default="as the task says")
    ] = None
    shows_hidden: Annotated[
        bool | None,
        _option(
            "policies see the tick, whose limit ends an episode as success does, and which helpers are under way, "
            "on the grid",
            show_default="no",
        ),
    ] = None
    queue_survives: Annotated[
        bool | None,
        _option("the action helper goes on in the next episode of training", show_default="no"),
    ] = None
    rules: Annotated[
        str | None,
        _option(
            "rule set on the grid: published, physical, or a YAML file of learned rules",
            metavar="NAME|FILE",
            show_default="physical",
        ),
    ] = None
    helper_depth: Annotated[
        int | None,
        _run_number(
            "helper_depth", help="search depth of the action helper on the grid; default: no helper"
        ),
    ] = None
    execution: Annotated[
        Execution,
        _option(
            "a step lasts until the slowest car has finished, or, for "
            f"{enumerated(with_trait('is_asynchronous'))} on the grid, each car decides"
        ),
    ] = "synchronous"
    n_cars: Annotated[
        int | None,
        _run_number(
            "n_cars",
            name="--cars",
            help="number of cars; those not listed in the start are placed at random",
        ),
    ] = None
    n_blocks: Annotated[
        int | None, _run_number("n_blocks", name="--blocks", help="number of blocks")
    ] = None
    max_steps: Annotated[
        int | None, _run_number("max_steps", help="step limit of an episode; default: the task's")
    ] = None
    acting: Annotated[
        Literal["greedy", "sampled", "varied"],
        _option(
            "in evaluations, take the most probable action, sample, or rate repeated actions lower"
        ),
    ] = "greedy"
    evaluate_every: Annotated[
        int | None,
        _run_number(
            "evaluate_every", help="steps between evaluations", show_default="ten rollouts"
        ),
    ] = None
    evaluation_episodes: Annotated[
        int | None,
        _run_number(
            "evaluation_episodes",
            help="episodes of an evaluation during training",
            show_default="500 on the grid, 64 in physics",
        ),
    ] = None


@Parameter(name="*", group=EXPLORATION)
@dataclass(frozen=True, kw_only=True)
class Exploration:
    """What leads a run to rewards that untrained cars do not find."""

    novelty: Annotated[
        float, _run_number("novelty", help="exploration bonus for new buildings")
    ] = 0.0
    explore: Annotated[
        int | None,
        _run_number(
            "explore", help="ticks of random exploration before learning", show_default="0"
        ),
    ] = None
    imitate: Annotated[
        int,
        _run_number("imitate", help="number of the planner's plans for imitation before learning"),
    ] = 0
    shown_share: Annotated[
        float, _run_number("shown_share", help="share of episodes that start along such a plan")
    ] = 0.5
    starts: Annotated[
        Path | None,
        _option(
            "a plan or a file of reached worlds, at which every second episode starts",
            metavar="FILE",
        ),
    ] = None
    pretrained: Annotated[
        str, _option("initial policy: a name, file or folder", metavar="NAME|FILE")
    ] = ""
    stages: Annotated[
        tuple[str, ...], _option("a curriculum: easier tasks to learn on first", metavar="TASK")
    ] = ()
    stage_steps: Annotated[int, _run_number("stage_steps", help="steps on each of these")] = 0


@Parameter(name="*", group=PHYSICS)
@dataclass(frozen=True, kw_only=True)
class TrainingPhysics:
    """Worlds of a run with --backend physics."""

    drive: Annotated[
        Drive | None, _option("model of the mecanum wheels", show_default="wheels")
    ] = None
    randomize: Annotated[
        str | None, _option("preset of the randomization", metavar="NAME", show_default="none")
    ] = None
    workers: Annotated[
        int | None,
        number(
            WORKERS,
            help="number of processes that share the worlds",
            show_default="one per processor",
        ),
    ] = None
    engine: Annotated[
        Engine | None, _option("local processes, or workers on a Ray cluster", show_default="local")
    ] = None


def _hyperparameter(name: str, text: str) -> Parameter:
    """Return the annotation of a hyperparameter, with ranges and defaults from the algorithms' own settings."""
    readers = readers_of(name)
    defaults: dict[float, list[str]] = {}
    for algo in readers:
        defaults.setdefault(default_of(name, algo), []).append(algo)
    texts = [f"{default:g} for {', '.join(algos)}" for default, algos in defaults.items()]
    if len(defaults) == 1:
        texts = [f"{default:g}" for default in defaults]
    ranges = [setting_range(name, algo) for algo in readers]
    widest = Range(min(allowed.low for allowed in ranges), max(allowed.high for allowed in ranges))
    groups: tuple[Group, ...] = (EVERY_ALGORITHM,)
    if len(readers) < len(ALGORITHMS):
        groups = tuple(dict.fromkeys(OF_ALGORITHM[ALGORITHMS[algo].settings] for algo in readers))
    return number(widest, help=text, show_default="; ".join(texts), group=groups)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Hyperparameters:
    """Hyperparameters of the algorithm that differ from its defaults."""

    gamma: Annotated[float | None, _hyperparameter("gamma", "discount per tick")] = None
    learning_rate: Annotated[
        float | None, _hyperparameter("learning_rate", "learning rate of Adam; of RAdam for pqn")
    ] = None
    max_gradient: Annotated[
        float | None, _hyperparameter("max_gradient", "clipping norm of gradients")
    ] = None
    decay_ticks: Annotated[
        int | None,
        _hyperparameter("decay_ticks", "ticks of linear decay of the learning rate; 0: constant"),
    ] = None
    gae_lambda: Annotated[
        float | None, _hyperparameter("gae_lambda", "lambda of generalised advantage estimation")
    ] = None
    clip: Annotated[
        float | None, _hyperparameter("clip", "clipping range of the probability ratio")
    ] = None
    critic: Annotated[float | None, _hyperparameter("critic", "weight of the critic's loss")] = None
    entropy: Annotated[float | None, _hyperparameter("entropy", "entropy coefficient")] = None
    epochs: Annotated[int | None, _hyperparameter("epochs", "epochs over each rollout")] = None
    minibatches: Annotated[int | None, _hyperparameter("minibatches", "minibatches per epoch")] = (
        None
    )
    td_lambda: Annotated[
        float | None, _hyperparameter("td_lambda", "lambda of the returns; 0 is one-step learning")
    ] = None
    target_rate: Annotated[
        float | None,
        _hyperparameter(
            "target_rate", "part of the difference by which target networks follow; 1: a copy"
        ),
    ] = None
    target_ticks: Annotated[
        int | None,
        _hyperparameter(
            "target_ticks", "ticks between these updates; 0: one after each optimiser step"
        ),
    ] = None
    limit_ends: Annotated[
        int | None,
        _hyperparameter("limit_ends", "1: the time limit ends an episode as success does"),
    ] = None
    rmsprop: Annotated[int | None, _hyperparameter("rmsprop", "1: RMSProp in place of Adam")] = None
    epsilon_start: Annotated[
        float | None, _hyperparameter("epsilon_start", "initial probability of a random action")
    ] = None
    epsilon_end: Annotated[
        float | None, _hyperparameter("epsilon_end", "final probability of a random action")
    ] = None
    epsilon_ticks: Annotated[
        int | None, _hyperparameter("epsilon_ticks", "ticks of linear decay between them")
    ] = None
    batch: Annotated[
        int | None,
        _hyperparameter("batch", "ticks per optimiser step, in whole rollouts of one world"),
    ] = None
    buffer: Annotated[
        int | None, _hyperparameter("buffer", "capacity of the replay memory in ticks")
    ] = None
    replays: Annotated[
        float | None,
        _hyperparameter("replays", "average number of times that each tick is sampled"),
    ] = None
    standardize: Annotated[
        int | None,
        _hyperparameter("standardize", "1: divide rewards by their standard deviation so far"),
    ] = None


Algo = Annotated[AlgoName, _option(", ".join(algorithm.title for algorithm in ALGORITHMS.values()))]
_TRACKER: Final = (
    "where the learning curve also goes: tensorboard, or a function of yours that takes figures "
    "and steps"
)
TrackerName = Annotated[
    str | None, _option(_TRACKER, group=LEARNING, metavar="tensorboard|MODULE:NAME")
]
LearningDevice = Annotated[
    Device | None, _option("where networks learn", group=LEARNING, show_default="cpu")
]
SettingsFile = Annotated[
    Path | None,
    _option(
        "YAML file of hyperparameters; options come before it",
        metavar="FILE",
        group=EVERY_ALGORITHM,
    ),
]


def chosen_values(options: object) -> dict[str, Any]:
    """Return the values of a group of options that are not None, by name."""
    return {name: value for name, value in vars(options).items() if value is not None}


def check_read(names: Iterable[str], algo: AlgoName) -> None:
    """Raise InputError for a hyperparameter that an algorithm does not read."""
    for name in names:
        readers = readers_of(name)
        if algo not in readers:
            options = [_flag(field.name) for field in fields(ALGORITHMS[algo].settings)]
            raise InputError(
                f"{algo} has no {_flag(name)}, which is for {', '.join(readers)}; {algo} has {', '.join(options)}"
            )


def _flag(name: str) -> str:
    return f"--{option_name(Parameter(), name)}"
