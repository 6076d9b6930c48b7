"""The configuration of a training run; it is kept in its checkpoints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final, Literal, get_args

from craftsim.discrete.rules import RULE_SETS, RuleSet
from craftsim.errors import InputError
from craftsim.mjcf.parameters import DRIVES, Drive
from craftsim.storage.limits import (
    BATCH,
    BONUS,
    EXPLORED_TICKS,
    HELPER_DEPTH,
    IMITATED_PLANS,
    NETWORK_WIDTH,
    SEED,
    SHARE,
    STAGES,
    TRAIN_STEPS,
)
from craftsim.training.settings import settings_of

AlgoName = Literal["ippo", "mappo", "qmix", "vdn", "iql", "coma", "qtran"]
TrainBackend = Literal["grid", "physics"]
WORLDS: Final[Mapping[TrainBackend, int]] = {"grid": 500, "physics": 32}
"""How many are stepped side by side unless said otherwise."""
PresetName = Literal["paper"]
PRESETS: Final[Mapping[PresetName, Mapping[str, Any]]] = {"paper": {"rules": "published", "helper_depth": 20}}
"""Fields of a configuration that belong together: the protocol of CraftEnv's paper (Zhao et al., AAMAS 2023)."""
NetworkName = Literal["map", "relative"]
"""A table of what may be in each cell of the map, or of what may be in each direction and distance from a car."""
Acting = Literal["greedy", "sampled"]
"""Each car does what the policy rates highest, or what is drawn with the policy's probabilities."""
HALF: Final = 0.5
"""Of the episodes of training start with worlds that are given, unless said otherwise."""
ALGO_NAMES: Final[tuple[str, ...]] = get_args(AlgoName)


WITH_PROBABILITIES: Final[tuple[AlgoName, ...]] = ("ippo", "mappo", "coma")
"""What these learn are probabilities of actions, and values with the others."""


@dataclass(frozen=True)
class TrainConfig:
    """Everything that decides what a run learns, its length aside. Raises InputError for a bad value."""

    task: str
    """What it is called: a name or a file, as :func:`craftsim.discrete.tasks.known_task` takes it, or
    ``module:factory``. Of the latter a trainer is given the task itself: a configuration may come from a file."""
    algo: AlgoName = "ippo"
    seed: int = 0
    worlds: int = WORLDS["grid"]
    """How many worlds are stepped side by side in a rollout."""
    width: int = 128
    """Length of the vectors inside the networks."""
    network: NetworkName = "map"
    """How it looks at the world: cell by cell, or from each car, so that any number of cars may be there."""
    novelty: float = 0.0
    """Exploration bonus for a building never seen before; for one seen k times it is divided by the root of k."""
    n_cars: int | None = None
    """Other than the task's number of cars; those that its start does not list are drawn at random."""
    n_blocks: int | None = None
    """The same for blocks."""
    backend: TrainBackend = "grid"
    """Where it is trained and evaluated: on the grid, or in nominal contact physics."""
    drive: Drive = "reduced"
    """How cars touch the ground in physics; the grid knows no drives."""
    randomize: str = "none"
    """What is drawn of physics, floor, machines and sensors in each episode: a preset's name."""
    rules: RuleSet = "physical"
    """What is legal on the grid: what physics supports, or what CraftEnv's code allows."""
    helper_depth: int | None = None
    """Search depth of the action helper, on the grid; None is without it."""
    explore: int = 0
    """Ticks of exploration on the grid before learning; half of the episodes then start with a world it reached."""
    acting: Acting = "greedy"
    """How the policy acts in evaluations and once it is trained; while it learns, actions are always drawn."""
    imitate: int = 0
    """Plans of the planner that are imitated before learning; half of the episodes then start with a world of one."""
    shown_share: float = HALF
    """In a task that varies, the share of episodes that start with a world on the way of an imitated plan."""
    pretrained: str = ""
    """A policy to begin with, by name, file or folder; its network has the same width and form, its area may differ."""
    stages: tuple[str, ...] = ()
    """Tasks to learn on before, one after the other: easier ones, of the same size and with as many things."""
    stage_steps: int = 0
    """Ticks on each of them, all worlds together."""
    hyperparameters: dict[str, float] = field(default_factory=dict)
    """Of the algorithm, by name, where they are not its own; see :mod:`craftsim.training.settings`."""

    def __post_init__(self) -> None:
        if self.algo not in ALGO_NAMES:
            raise InputError(f"algo is {self.algo!r}; allowed: {', '.join(ALGO_NAMES)}")
        settings_of(self.algo, self.hyperparameters)
        if self.backend not in get_args(TrainBackend):
            raise InputError(f"backend is {self.backend!r}; allowed: {', '.join(get_args(TrainBackend))}")
        if self.drive not in DRIVES:
            raise InputError(f"drive is {self.drive!r}; allowed: {', '.join(DRIVES)}")
        _check_drawn(self.randomize, self.backend)
        if self.network not in get_args(NetworkName):
            raise InputError(f"network is {self.network!r}; allowed: {', '.join(get_args(NetworkName))}")
        if self.rules not in RULE_SETS:
            raise InputError(f"rules is {self.rules!r}; allowed: {', '.join(RULE_SETS)}")
        if self.helper_depth is not None:
            HELPER_DEPTH.check("helper_depth", self.helper_depth)
        EXPLORED_TICKS.check("explore", self.explore)
        if self.backend == "physics" and (self.rules, self.helper_depth, self.explore) != (
            "physical",
            None,
            0,
        ):
            raise InputError(
                "in physics cars are trained under the physical rule set, without action helper and exploration; leave "
                "rules, helper_depth and explore out, or train on the grid"
            )
        if self.acting not in get_args(Acting):
            raise InputError(f"acting is {self.acting!r}; allowed: {', '.join(get_args(Acting))}")
        if self.acting == "sampled" and self.algo not in WITH_PROBABILITIES:
            raise InputError(
                f"{self.algo} rates actions by value, there is nothing to sample; acting must be greedy"
            )
        if self.pretrained and self.algo not in WITH_PROBABILITIES:
            raise InputError(
                f"{self.algo} learns values, and cannot begin with a policy; leave pretrained out, or take one of "
                f"{', '.join(WITH_PROBABILITIES)}"
            )
        IMITATED_PLANS.check("imitate", self.imitate)
        if self.imitate and (self.algo not in ("ippo", "mappo") or self.rules != "physical" or self.explore):
            raise InputError(
                "plans are imitated by ippo and mappo, under the physical rule set, without exploration; leave imitate "
                "out, or change algo, rules or explore"
            )
        SHARE.check("shown_share", self.shown_share)
        if self.shown_share != HALF and not self.imitate:
            raise InputError(
                f"shown_share is {self.shown_share}, but nothing is imitated; leave it out, or imitate plans"
            )
        object.__setattr__(self, "stages", tuple(self.stages))
        STAGES.check("stages", len(self.stages))
        if bool(self.stages) != bool(self.stage_steps) or (self.stages and (self.explore or self.imitate)):
            raise InputError(
                f"stages {', '.join(self.stages) or 'none'} of {self.stage_steps} steps: name tasks and give each at "
                "least one step, without exploration and imitation, or leave both out"
            )
        if self.stages:
            TRAIN_STEPS.check("stage_steps", self.stage_steps)
        SEED.check("seed", self.seed)
        BATCH.check("worlds", self.worlds)
        NETWORK_WIDTH.check("width", self.width)
        BONUS.check("novelty", self.novelty)

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name."""
        return asdict(self)


def _check_drawn(randomize: str, backend: TrainBackend) -> None:
    if randomize == "none":
        return
    # MuJoCo comes with it, which the grid has no use for.
    from craftsim.checking.setup import RANDOMIZE

    if randomize not in RANDOMIZE:
        raise InputError(f"randomize is {randomize!r}; allowed: {', '.join(RANDOMIZE)}")
    if backend == "grid":
        raise InputError(
            f"randomize is {randomize!r}, but on the grid nothing is drawn of physics: leave it out"
        )
