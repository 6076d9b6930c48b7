"""The configuration of a training run; it is kept in its checkpoints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Annotated, Any, Final, Literal, get_args

from pydantic import Field, Strict

from craftsim.choices import AlgoName as AlgoName
from craftsim.choices import Backend as TrainBackend
from craftsim.choices import Execution, PresetName
from craftsim.discrete.rules import RuleSet
from craftsim.mjcf.parameters import Drive
from craftsim.storage.limits import (
    BATCH,
    BLOCKS,
    BONUS,
    CARS,
    EXPLORED_TICKS,
    HELPER_DEPTH,
    IMITATED_PLANS,
    NETWORK_WIDTH,
    SEED,
    SHARE,
    STAGES,
    TRAIN_EPISODES,
    TRAIN_STEPS,
    Range,
)
from craftsim.storage.records import record
from craftsim.training.settings import settings_of

PHYSICS_WORLDS: Final = 32
"""How many are stepped side by side in physics unless said otherwise."""
GRID_WORLDS: Final[Mapping[AlgoName, int]] = {
    **dict.fromkeys(("ippo", "mappo"), 500),
    **dict.fromkeys(("qmix", "vdn", "iql", "qtran", "coma"), 25),
    "pqn": 100,
}
"""The same on the grid: learning from few worlds means many updates."""
NetworkName = Literal["map", "relative"]
"""A table of what may be in each cell of the map, or of what may be in each direction and distance from a car."""
Acting = Literal["greedy", "sampled"]
"""Each car does what the policy rates highest, or what is drawn with the policy's probabilities."""
HALF: Final = 0.5
"""Of the episodes of training start with worlds that are given, unless said otherwise."""
ALGO_NAMES: Final[tuple[str, ...]] = get_args(AlgoName)


WITH_PROBABILITIES: Final[tuple[AlgoName, ...]] = ("ippo", "mappo", "coma")
"""What these learn are probabilities of actions, and values with the others."""


@record()
class TrainConfig:
    """Everything that decides what a run learns, its length aside. Raises InputError for a bad value."""

    task: str
    """What it is called: a name or a file, as :func:`craftsim.discrete.tasks.known_task` takes it, or
    ``module:factory``. Of the latter a trainer is given the task itself: a configuration may come from a file."""
    algo: AlgoName = "ippo"
    seed: Annotated[int, SEED] = 0
    worlds: Annotated[int, BATCH] | None = None
    """How many worlds are stepped side by side in a rollout; as many as suit algorithm and backend unless given."""
    width: Annotated[int, NETWORK_WIDTH] = 128
    """Length of the vectors inside the networks."""
    network: NetworkName = "map"
    """How it looks at the world: cell by cell, or from each car, so that any number of cars may be there."""
    novelty: Annotated[float, BONUS] = 0.0
    """Exploration bonus for a building never seen before; for one seen k times it is divided by the root of k."""
    n_cars: Annotated[int, CARS] | None = None
    """Other than the task's number of cars; those that its start does not list are drawn at random."""
    n_blocks: Annotated[int, BLOCKS] | None = None
    """The same for blocks."""
    backend: TrainBackend = "grid"
    """Where it is trained and evaluated: on the grid, or in nominal contact physics."""
    drive: Drive = "reduced"
    """How cars touch the ground in physics; the grid knows no drives."""
    randomize: str = "none"
    """What is drawn of physics, floor, machines and sensors in each episode: a preset's name."""
    rules: RuleSet = "physical"
    """What is legal on the grid: what physics supports, or what CraftEnv's code allows."""
    helper_depth: Annotated[int, HELPER_DEPTH] | None = None
    """Search depth of the action helper, on the grid; None is without it."""
    execution: Execution = "synchronous"
    """Whether cars decide together, tick by tick, or each when its own action has ended, on the grid."""
    explore: Annotated[int, EXPLORED_TICKS] = 0
    """Ticks of exploration on the grid before learning; half of the episodes then start with a world it reached."""
    acting: Acting = "greedy"
    """How the policy acts in evaluations and once it is trained; while it learns, actions are always drawn."""
    imitate: Annotated[int, IMITATED_PLANS] = 0
    """Plans of the planner that are imitated before learning; half of the episodes then start with a world of one."""
    shown_share: Annotated[float, SHARE] = HALF
    """In a task that varies, the share of episodes that start with a world on the way of an imitated plan."""
    pretrained: str = ""
    """A policy to begin with, by name, file or folder; its network has the same width and form, its area may differ."""
    stages: Annotated[tuple[str, ...], Strict(False), Field(max_length=STAGES)] = ()
    """Tasks to learn on before, one after the other: easier ones, of the same size and with as many things."""
    stage_steps: Annotated[int, Range(0, TRAIN_STEPS.high)] = 0
    """Ticks on each of them, all worlds together."""
    evaluate_every: Annotated[int, TRAIN_STEPS] | None = None
    """Ticks from one evaluation to the next, all worlds together; ten rollouts unless given."""
    evaluation_episodes: Annotated[int, TRAIN_EPISODES] | None = None
    """Of each evaluation while it learns; 500 on the grid and 64 in physics unless given."""
    hyperparameters: dict[str, float] = field(default_factory=dict)
    """Of the algorithm, by name, where they are not its own; see :mod:`craftsim.training.settings`."""

    def __post_init__(self) -> None:
        settings_of(self.algo, self.hyperparameters)
        _check_drawn(self.randomize, self.backend)
        if self.backend == "physics" and (self.rules, self.helper_depth, self.explore) != (
            "physical",
            None,
            0,
        ):
            raise ValueError(
                "in physics cars are trained under the physical rule set, without action helper and exploration; leave "
                "rules, helper_depth and explore out, or train on the grid"
            )
        if self.execution == "asynchronous" and (
            self.algo not in ("ippo", "mappo") or self.backend != "grid" or self.imitate
        ):
            raise ValueError(
                "cars are trained asynchronously by ippo and mappo, on the grid, without imitation; leave execution "
                "out, or change algo, backend or imitate"
            )
        if self.acting == "sampled" and self.algo not in WITH_PROBABILITIES:
            raise ValueError(
                f"{self.algo} rates actions by value, there is nothing to sample; acting must be greedy"
            )
        if self.pretrained and self.algo not in WITH_PROBABILITIES:
            raise ValueError(
                f"{self.algo} learns values, and cannot begin with a policy; leave pretrained out, or take one of "
                f"{', '.join(WITH_PROBABILITIES)}"
            )
        if self.imitate and (self.algo not in ("ippo", "mappo") or self.rules != "physical" or self.explore):
            raise ValueError(
                "plans are imitated by ippo and mappo, under the physical rule set, without exploration; leave imitate "
                "out, or change algo, rules or explore"
            )
        if self.shown_share != HALF and not self.imitate:
            raise ValueError(
                f"shown_share is {self.shown_share}, but nothing is imitated; leave it out, or imitate plans"
            )
        if bool(self.stages) != bool(self.stage_steps) or (self.stages and (self.explore or self.imitate)):
            raise ValueError(
                f"stages {', '.join(self.stages) or 'none'} of {self.stage_steps} steps: name tasks and give each at "
                "least one step, without exploration and imitation, or leave both out"
            )

    @property
    def n_worlds(self) -> int:
        """How many worlds are stepped side by side."""
        usual = GRID_WORLDS[self.algo] if self.backend == "grid" else PHYSICS_WORLDS
        return self.worlds or usual

    @property
    def n_evaluation_episodes(self) -> int:
        """How many episodes an evaluation while it learns has."""
        return self.evaluation_episodes or (500 if self.backend == "grid" else 64)

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name."""
        return asdict(self)


PAPER_STEPS: Final = 1_000_500
PAPER_LONG_STEPS: Final = 2_000_000
"""Of two-story buildings and harder tasks."""
_SHORT_TASKS: Final = ("strip", "block")


LEARNED: Final = 0.99
"""The success rate that counts as learned, unless a run or a study says otherwise."""


@dataclass(frozen=True)
class Protocol:
    """What a preset settles: fields of a configuration, and how long a run is."""

    settings: Mapping[str, Any] = field(default_factory=dict)
    steps: int = 1_000_000
    until: float = LEARNED


def protocol(preset: PresetName, task: str, algo: AlgoName) -> Protocol:
    """Return the protocol of CraftEnv's paper (Zhao et al., AAMAS 2023) for a task and an algorithm.

    Published rules, the action helper with depth 20, the task's own start, greedy evaluations of 20 episodes every
    10,000 ticks, and no end at the first success. Value-based algorithms explore with probability 0.21, soon 0.2.
    Learning rates but those of PPO fall to nothing.
    ``paper_plus`` adds exploration of craftsim's own before learning.
    """
    short = task in _SHORT_TASKS
    steps = PAPER_STEPS if short else PAPER_LONG_STEPS
    hyperparameters: dict[str, float] = {} if algo in ("ippo", "mappo") else {"decay_ticks": steps}
    if algo not in WITH_PROBABILITIES:
        hyperparameters |= {"epsilon_start": 0.21, "epsilon_end": 0.2, "epsilon_ticks": 50_000}
    settings: dict[str, Any] = {
        "rules": "published",
        "helper_depth": 20,
        "evaluate_every": 10_000,
        "evaluation_episodes": 20,
        "hyperparameters": hyperparameters,
    }
    if preset == "paper_plus":
        settings["explore"] = 1_000_000 if short else 5_000_000
    return Protocol(settings, steps, NEVER)


NEVER: Final = 2.0
"""A success rate that no evaluation has: a run that waits for it goes on to its last step."""


def _check_drawn(randomize: str, backend: TrainBackend) -> None:
    if randomize == "none":
        return
    # MuJoCo comes with it, which the grid has no use for.
    from craftsim.checking.setup import RANDOMIZE

    if randomize not in RANDOMIZE:
        raise ValueError(f"randomize is {randomize!r}; allowed: {', '.join(RANDOMIZE)}")
    if backend == "grid":
        raise ValueError(
            f"randomize is {randomize!r}, but on the grid nothing is drawn of physics: leave it out"
        )
