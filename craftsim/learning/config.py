"""The configuration of a training run, stored in its checkpoints, with the hyperparameters of each algorithm."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args

from pydantic import Field, Strict

from craftsim.discrete.kinds import Execution
from craftsim.discrete.rules import RuleSet
from craftsim.errors import InputError, check_choice
from craftsim.learning.algorithms import ALGORITHMS, AlgoName, enumerated, with_trait
from craftsim.learning.ranges import RUN_RANGES
from craftsim.learning.settings import BackendChoice, PresetName, Settings
from craftsim.mjcf.drives import Drive
from craftsim.storage.limits import STAGES
from craftsim.storage.records import from_json, record
from craftsim.storage.yaml import read_document
from craftsim.tasks import Task, known_task, make_task
from craftsim.tasks.task import DEFAULT_MAX_STEPS

_PHYSICS_WORLDS: Final = 32
"""Default number of parallel worlds in physics."""
NetworkName = Literal["map", "relative", "linear"]
"""Embedding table by cell of the map, or by position relative to the car; or a linear layer on what is observed."""
RewardName = Literal["paper", "published_code"]
"""As the paper states it, or as CraftEnv's code computes it."""
Acting = Literal["greedy", "sampled", "varied"]
"""Each car takes the highest rated action; samples from the policy; or takes the highest rated one, an action being
rated lower for each time that it was taken in the same situation of the episode, see
:class:`craftsim.learning.evaluation.Tried`."""
HALF: Final = 0.5
"""Default share of training episodes that start from given worlds."""
IS_VARIED: Final[Mapping[Acting, bool]] = {"greedy": False, "sampled": False, "varied": True}
IS_SAMPLED: Final[Mapping[Acting, bool]] = {"greedy": False, "sampled": True, "varied": False}


def settings_of(algo: AlgoName, overrides: Mapping[str, float]) -> Settings:
    """Return the hyperparameters of an algorithm with some replaced. Raises InputError for unknown or invalid ones."""
    check_choice("algorithm", algo, ALGORITHMS)
    kind = ALGORITHMS[algo].settings
    values = dict(overrides)
    for field_of_kind in fields(kind):
        value = values.get(field_of_kind.name)
        # What is whole stays so, though a file may have it as 4.0.
        if isinstance(field_of_kind.default, int) and value is not None and value == value // 1:
            values[field_of_kind.name] = int(value)
    return from_json(kind, json.dumps(values).encode(), algo)


def read_settings(path: Path, algo: AlgoName) -> dict[str, float]:
    """Return the hyperparameters in a YAML file. Raises InputError with file, line and key."""
    document = read_document(path)
    document.to(ALGORITHMS[algo].settings)
    return document.plain


@record()
class TrainConfig:
    """Everything that determines what a run learns, except its length. Raises InputError for an invalid value."""

    task: str
    """A name or file, as for :func:`craftsim.tasks.known_task`, or ``module:factory``; for the latter the
    trainer needs the task itself, since a configuration may come from a file."""
    algo: AlgoName = "ippo"
    seed: Annotated[int, RUN_RANGES["seed"]] = 0
    worlds: Annotated[int, RUN_RANGES["worlds"]] | None = (
        None  # in parallel; default by algorithm and backend
    )
    width: Annotated[int, RUN_RANGES["width"]] = 128  # of the hidden layers
    network: NetworkName = "map"
    """By cell of the map, relative to each car, for any number of cars, or linear in what is observed."""
    recurrent: bool = False  # a GRU over observations and last actions
    last_action: bool = True  # what a car did last is among the inputs of a recurrent policy
    novelty: Annotated[float, RUN_RANGES["novelty"]] = (
        0.0  # bonus for a building, over sqrt(k) for one seen k times
    )
    n_cars: Annotated[int, RUN_RANGES["n_cars"]] | None = (
        None  # those not listed in the task's start are placed at random
    )
    n_blocks: Annotated[int, RUN_RANGES["n_blocks"]] | None = None
    max_steps: Annotated[int, RUN_RANGES["max_steps"]] | None = (
        None  # step limit of episodes; default: the task's
    )
    reward: RewardName = "paper"  # of the paper's six tasks
    ends_on_success: bool | None = None  # default: as the task says
    shows_hidden: bool = False
    """The tick of the episode, and whether helpers are under way, are inputs, too, on the grid. Then nothing is worth
    anything after the time limit, and a car whose helper is under way has no choice."""
    backend: BackendChoice = "grid"  # training and evaluation on the grid, or in contact physics
    drive: Drive = "wheels"  # of the cars in physics
    randomize: str = "none"  # preset of the randomization in physics
    rules: RuleSet = "physical"  # on the grid
    helper_depth: Annotated[int, RUN_RANGES["helper_depth"]] | None = (
        None  # of the action helper on the grid
    )
    queue_survives: bool = (
        False  # in training what the helper has still to do outlives the episode, as in CraftEnv
    )
    execution: Execution = (
        "synchronous"  # cars decide in ticks, or each when its own action has ended (grid)
    )
    explore: Annotated[int, RUN_RANGES["explore"]] = 0
    """Ticks of exploration on the grid before learning; half of the episodes then start from worlds that it reached."""
    acting: Acting = (
        "greedy"  # in evaluations and of the trained policy; in training actions are sampled
    )
    imitate: Annotated[int, RUN_RANGES["imitate"]] = 0
    """Number of plans for imitation before learning; half of the episodes then start from worlds along them."""
    shown_share: Annotated[float, RUN_RANGES["shown_share"]] = (
        HALF  # of a random task's episodes that start along such a plan
    )
    pretrained: str = ""
    """Initial policy, by name, file or folder; with the same width and kind of network, possibly another area."""
    stages: Annotated[tuple[str, ...], Strict(False), Field(max_length=STAGES)] = ()
    """Curriculum: easier tasks of the same shape to learn on first."""
    stage_steps: Annotated[int, RUN_RANGES["stage_steps"]] = (
        0  # ticks on each of them, over all worlds
    )
    evaluate_every: Annotated[int, RUN_RANGES["evaluate_every"]] | None = (
        None  # ticks over all worlds; default: ten rollouts
    )
    evaluation_episodes: Annotated[int, RUN_RANGES["evaluation_episodes"]] | None = (
        None  # 500 on the grid, 64 in physics
    )
    hyperparameters: dict[str, float] = field(
        default_factory=dict
    )  # those that differ from the defaults

    def __post_init__(self) -> None:
        settings_of(self.algo, self.hyperparameters)
        for is_wrong, message in self._conflicts():
            if is_wrong:
                raise ValueError(message)

    def _conflicts(self) -> Iterator[tuple[bool, str]]:
        """Yield what does not go together: whether it is so here, and in words."""
        algo = self.algo
        algorithm = ALGORITHMS[algo]
        learns_values = not algorithm.learns_probabilities
        on_grid = self.backend == "grid"
        if self.randomize != "none":
            # MuJoCo comes with it, which the grid has no use for.
            from craftsim.checking.setup import RANDOMIZE

            drawn_level = f"randomize is {self.randomize!r}"
            yield self.randomize not in RANDOMIZE, f"{drawn_level}; allowed: {', '.join(RANDOMIZE)}"
            yield (
                on_grid,
                f"{drawn_level}, but on the grid nothing is drawn of physics: leave it out",
            )
        yield (
            on_grid and self.drive != "wheels",
            f"drive is {self.drive!r}, but on the grid nothing drives: leave it out",
        )
        yield (
            not on_grid and (self.rules, self.helper_depth, self.explore) != ("physical", None, 0),
            "in physics cars are trained under the physical rule set, without action helper and exploration; leave "
            "rules, helper_depth and explore out, or train on the grid",
        )
        yield (
            self.execution == "asynchronous"
            and bool(not algorithm.is_asynchronous or not on_grid or self.imitate),
            f"cars are trained asynchronously by {enumerated(with_trait('is_asynchronous'))}, on the grid, without "
            "imitation; leave execution out, or change algo, backend or imitate",
        )
        yield (
            self.recurrent and not algorithm.is_recurrent,
            f"{algo} has no recurrent policy; leave recurrent out, or take one of "
            f"{', '.join(with_trait('is_recurrent'))}",
        )
        yield (
            not self.last_action and not self.recurrent,
            "last_action is for a recurrent policy, the only one that sees it; leave it out",
        )
        yield (
            self.queue_survives and self.helper_depth is None,
            "queue_survives is for an action helper; leave it out, or set helper_depth",
        )
        yield (
            self.shows_hidden and bool(not on_grid or self.execution == "asynchronous"),
            "shows_hidden is for episodes on the grid that go tick by tick; leave it out",
        )
        yield (
            self.acting != "greedy" and learns_values,
            f"{algo} rates actions by value, not by probability; acting must be greedy",
        )
        yield (
            bool(self.pretrained) and learns_values,
            f"{algo} learns values, and cannot begin with a policy; leave pretrained out, or take one of "
            f"{', '.join(with_trait('learns_probabilities'))}",
        )
        yield (
            bool(self.imitate)
            and bool(not algorithm.imitates or self.rules != "physical" or self.explore),
            f"plans are imitated by {enumerated(with_trait('imitates'))}, under the physical rule set, without "
            "exploration; leave imitate out, or change algo, rules or explore",
        )
        yield (
            self.shown_share != HALF and not self.imitate,
            f"shown_share is {self.shown_share}, but nothing is imitated; leave it out, or imitate plans",
        )
        yield (
            bool(self.stages) != bool(self.stage_steps)
            or bool(self.stages and (self.explore or self.imitate)),
            f"stages {', '.join(self.stages) or 'none'} of {self.stage_steps} steps: name tasks and give each at least "
            "one step, without exploration and imitation, or leave both out",
        )

    @property
    def n_worlds(self) -> int:
        """Number of parallel worlds."""
        usual = _PHYSICS_WORLDS
        if self.backend == "grid":
            usual = ALGORITHMS[self.algo].grid_worlds
        return self.worlds or usual

    @property
    def n_evaluation_episodes(self) -> int:
        """Episodes of each evaluation during training."""
        return self.evaluation_episodes or (500 if self.backend == "grid" else 64)

    def find_task(self, name: str, find: Callable[..., Task] = known_task) -> Task:
        """Return a task by its name, with the run's numbers of cars and blocks and its step limit."""
        if self.reward == "paper":
            task = find(name, n_cars=self.n_cars, n_blocks=self.n_blocks)
        else:
            task = make_task(name, self.reward, n_cars=self.n_cars, n_blocks=self.n_blocks)
        if self.max_steps is not None:
            task = replace(task, max_steps=self.max_steps)
        if self.ends_on_success is not None:
            task = replace(task, ends_on_success=self.ends_on_success)
        return task

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name."""
        return asdict(self)


PAPER_STEPS: Final = 1_000_500
PAPER_LONG_STEPS: Final = 2_000_000
"""Steps for two-story buildings and harder tasks."""
_SHORT_TASKS: Final = ("strip", "block")
RELEASED_STEPS: Final[Mapping[str, int]] = {
    "strip": PAPER_STEPS,
    "block": PAPER_STEPS,
    "simple_two_story": PAPER_LONG_STEPS,
    "complex_two_story": PAPER_LONG_STEPS,
    "free_building": PAPER_STEPS,
    "breaking_barrier": PAPER_STEPS,
}
"""Steps of the released runs: of buildings as CraftEnv's plots have them, of others ``t_max`` of its configuration."""
_OF_FORK: Final = ("iql", "vdn", "qmix")
FORK: Final[Mapping[str, tuple[Any, str]]] = {
    "network": ("linear", "modules/agents/rnn_agent.py:10"),
    "width": (64, "config/default.yaml:41"),
    "recurrent": (True, "modules/agents/rnn_agent.py:11"),
    "last_action": (True, "config/default.yaml:43"),
    # One there; side by side they are twice as fast, and as many updates follow.
    "worlds": (8, "config/default.yaml:8"),
    "rules": ("published", "smartcar.py:141"),
    "helper_depth": (20, "config/envs/free.yaml:42"),
    "queue_survives": (True, "smartcar.py:74"),
    "reward": ("published_code", "goal_env.py:182, free_env.py:120, flag_env.py:89"),
    "ends_on_success": (False, "craft_env.py:550"),
    "evaluate_every": (10_000, "config/default.yaml:10"),
    "evaluation_episodes": (20, "config/default.yaml:9"),
}
"""What the learner that was released with CraftEnv has (revision d60d406), and where it says so: fields of a
configuration."""
FORK_SETTINGS: Final[Mapping[str, tuple[float, str]]] = {
    "td_lambda": (0.0, "learners/q_learner.py:86"),
    "limit_ends": (1, "runners/episode_runner.py:75"),
    "rmsprop": (1, "learners/q_learner.py:30"),
    "learning_rate": (5e-4, "config/default.yaml:33"),
    "decay_ticks": (0, "learners/q_learner.py:30"),
    "max_gradient": (10.0, "config/default.yaml:37"),
    "target_rate": (1.0, "learners/q_learner.py:119"),
    "epsilon_start": (0.21, "config/algs/qmix.yaml:5"),
    "epsilon_end": (0.2, "config/algs/qmix.yaml:6"),
    "epsilon_ticks": (1, "config/algs/qmix.yaml:7"),
    "replays": (32.0, "run.py:179"),
}
"""The same for hyperparameters."""
FORK_EPISODES: Final[Mapping[str, tuple[int, str]]] = {
    "batch": (32, "config/default.yaml:31"),
    "buffer": (5000, "config/algs/qmix.yaml:11"),
    "target_ticks": (200, "config/algs/qmix.yaml:14"),
}
"""The same for hyperparameters that count episodes there, and ticks here."""
_MOST_REPLAYED: Final = 1_000_000
"""Ticks that a replay memory has at most: of episodes of more than 198 ticks it holds fewer than 5,000."""


LEARNED: Final = 0.99
"""Default success rate that counts as learned."""


@dataclass(frozen=True)
class Protocol:
    """A preset: fields of a configuration, and the length of a run."""

    settings: Mapping[str, Any] = field(default_factory=dict)
    steps: int = 1_000_000
    until: float = LEARNED


def protocol(
    preset: PresetName,
    task: str,
    algo: AlgoName,
    steps: int | None = None,
    max_steps: int | None = None,
) -> Protocol:
    """Return the protocol of CraftEnv's paper (Zhao et al., AAMAS 2023) for a task and an algorithm.

    Published rules, the action helper with depth 20, the task's own start, greedy evaluations of 20 episodes every
    10,000 ticks, and no early stop; policies see the tick, and whether a helper is under way. Value-based algorithms
    explore with probability 0.21, decaying to 0.2. Learning rates except PPO's decay to 0 over the run, the paper's
    length unless ``steps`` is given. ``paper_plus`` adds exploration before learning. ``fork`` is the learner that was
    released with it, for episodes of ``max_steps``, see :data:`FORK`, and runs as long as that. Raises InputError for
    an algorithm that the released learner has otherwise.
    """
    check_choice("preset", preset, get_args(PresetName))
    if preset == "fork":
        steps = steps or RELEASED_STEPS.get(task, PAPER_LONG_STEPS)
        return Protocol(_fork(algo, max_steps or DEFAULT_MAX_STEPS), steps, NEVER)
    short = task in _SHORT_TASKS
    steps = steps or (PAPER_STEPS if short else PAPER_LONG_STEPS)
    hyperparameters: dict[str, float] = {}
    if ALGORITHMS[algo].decays_in_paper:
        hyperparameters = {"decay_ticks": steps}
    if not ALGORITHMS[algo].learns_probabilities:
        hyperparameters |= {"epsilon_start": 0.21, "epsilon_end": 0.2, "epsilon_ticks": 50_000}
    settings: dict[str, Any] = {
        "rules": "published",
        "helper_depth": 20,
        "shows_hidden": True,
        "evaluate_every": 10_000,
        "evaluation_episodes": 20,
        "hyperparameters": hyperparameters,
    }
    if preset == "paper_plus":
        if short:
            settings["explore"] = 1_000_000
        else:
            settings["explore"] = 5_000_000
    return Protocol(settings, steps, NEVER)


def _fork(algo: AlgoName, max_steps: int) -> dict[str, Any]:
    if algo not in _OF_FORK:
        raise InputError(
            f"preset fork is the released learner of {enumerated(_OF_FORK)}; {algo} is another one here: take one of "
            "these, or preset paper"
        )
    settings = {name: value for name, (value, _) in FORK.items()}
    hyperparameters = {name: value for name, (value, _) in FORK_SETTINGS.items()}
    for name, (episodes, _) in FORK_EPISODES.items():
        hyperparameters[name] = episodes * (max_steps + 2)
    hyperparameters["buffer"] = min(hyperparameters["buffer"], _MOST_REPLAYED)
    return settings | {"hyperparameters": hyperparameters}


NEVER: Final = 2.0
"""A success rate above 1, for runs without early stop."""
