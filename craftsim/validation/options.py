"""Groups of options that commands and Python functions share: one name, one meaning, one default.

A field is an option of the command line (its annotation says its name, its values and its range), an argument of the
Python function of the same name, and a key of ``config.yaml``.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from cyclopts import Group, Parameter

from craftsim.discrete.ranges import BLOCKS, CARS, EPISODE_TICKS
from craftsim.errors import InputError, suggestion
from craftsim.experiments.ranges import CONFIDENCE_LEVEL, SUCCESS_RATE, TRIAL_COUNT
from craftsim.mjcf.drives import Drive
from craftsim.storage.limits import SEED, TIMEOUT_S, WORKERS, Range
from craftsim.workers.pool import Engine

if TYPE_CHECKING:
    from craftsim.checking.setup import Setup
    from craftsim.discrete.rules import RuleSet
    from craftsim.experiments.experiment import Progress, RunOptions
    from craftsim.mjcf.machines import Machines
    from craftsim.models.sensing import SensorNoise
    from craftsim.planning.plan_file import Plan
    from craftsim.skills.gains import Gains
    from craftsim.skills.library import SkillChoice

    Randomize = str | Path
    Noise = SensorNoise | str | Path | None
    GainsChoice = Gains | str | Path | None
    MachinesChoice = Machines | str | Path | None
    AnyRules = RuleSet | str | Path
    SkillsChoice = SkillChoice | None
    PlanChoice = str | Path | Plan | None
    ActionsFile = str | Path | None
    PolicyChoice = tuple[str | Callable[..., Any], ...]
    Folder = str | Path | None
else:
    Randomize = Noise = GainsChoice = MachinesChoice = SkillsChoice = PlanChoice = ActionsFile = str
    AnyRules = str
    Folder = Path
    PolicyChoice = tuple[str, ...]


_RUN: Final = Group("Rollouts", sort_key=1)
PHYSICS: Final = Group("Physics", sort_key=2)
_TRIALS: Final = Group("Trials", sort_key=3)
"""The headings of the help."""
PlanOrder = Literal["sequential", "ticks", "concurrent"]
"""Execution of a plan: one action after the other; tick by tick; or each action as soon as those that it depends on
have ended."""


REPLANS: Final = Range(0, 1000)


def number(allowed: Range, **options: Any) -> Parameter:
    """Return the annotation of a numeric option, which its help shows with its range, such as ``--cars 0..256``."""
    return Parameter(validator=(allowed,), metavar=str(allowed).replace(" to ", ".."), **options)


def range_of(parameter: Parameter) -> Range | None:
    """Return the range of a numeric option, if it has one."""
    checks: Any = parameter.validator
    return next((check for check in checks if isinstance(check, Range)), None)


def option_name(parameter: Parameter, name: str) -> str:
    """Return the name of a field's option on the command line, without dashes."""
    names: Any = parameter.name
    if names:
        name = names[0]
    return name.strip("-").replace("_", "-")


@Parameter(name="*", group=PHYSICS)
@dataclass(frozen=True, kw_only=True)
class Seeded:
    """The random seed."""

    seed: Annotated[int, number(SEED, help="random seed")] = 0


_RANDOMIZE: Final = (
    "randomization of physics, floor, machines, motors and sensors: none (exact), mild, "
    "strong, lab_floor or workshop_floor, or a YAML file"
)
_NOISE: Final = "YAML file of sensor and motor noise; missing values are those of --randomize"
_ASSUME: Final = (
    "noise that the cars' estimators assume at first: a preset or a YAML file; with none they use measured poses "
    "unfiltered"
)
_GAINS: Final = (
    "gains of the skills: a preset or a YAML file; default, also for missing values: robust"
)
_MACHINES: Final = "YAML file of machine parameters: masses, friction, torques, speeds, lengths"
_DRIVE: Final = (
    "model of the mecanum wheels: one tyre each, whose friction acts along its rollers, or ten free rollers each, the "
    "reference, several times as slow; default: wheels"
)
_SKILLS: Final = "user-defined skills: a mapping from actions, or from cars to such mappings"
_RULES: Final = (
    "rule set for the predictions: published (CraftEnv's own), physical (the corrected one), or a YAML file of "
    "learned rules"
)
Randomization = Annotated[Randomize, Parameter(metavar="NAME|FILE", help=_RANDOMIZE)]
RulesName = Annotated[str, Parameter(metavar="NAME|FILE")]
RulesChoice = Annotated[AnyRules, Parameter(metavar="NAME|FILE", help=_RULES)]


@dataclass(frozen=True, kw_only=True)
class Physics(Seeded):
    """Configuration of the physics."""

    randomize: Randomization = "mild"
    noise: Annotated[Noise | None, Parameter(metavar="FILE", help=_NOISE)] = None
    assume: Annotated[Noise | None, Parameter(metavar="NAME|FILE", help=_ASSUME)] = None
    gains: Annotated[GainsChoice | None, Parameter(metavar="NAME|FILE", help=_GAINS)] = None
    machines: Annotated[MachinesChoice | None, Parameter(metavar="FILE", help=_MACHINES)] = None
    drive: Annotated[Drive | None, Parameter(show=False, help=_DRIVE)] = None
    skills: Annotated[SkillsChoice | None, Parameter(metavar="MODULE:NAME", help=_SKILLS)] = None
    rules: RulesChoice = "physical"

    def setup(self) -> "Setup":
        """Return the configuration of the physics. Raises InputError for an invalid file."""
        from craftsim.checking.setup import setup_of

        return setup_of(
            self.randomize,
            self.rules,
            self.gains,
            self.machines,
            self.noise,
            self.assume,
            self.drive,
            skills=self.skills,
        )


_WORKERS: Final = "number of processes; results do not depend on it"
_ENGINE: Final = "local processes, or an existing Ray cluster that shares the output folder"
_RESUME: Final = "continue an interrupted run in the output folder"


@Parameter(name="*", group=_TRIALS)
@dataclass(frozen=True, kw_only=True)
class Work:
    """Where trials are run; results do not depend on it."""

    workers: Annotated[int, number(WORKERS, help=_WORKERS)] = 1
    engine: Annotated[Engine, Parameter(help=_ENGINE)] = "local"
    resume: Annotated[bool, Parameter(help=_RESUME)] = False

    def run(self, progress: "Progress") -> "RunOptions":
        """Return the options of an experiment."""
        from craftsim.experiments.experiment import RunOptions

        return RunOptions(self.workers, self.engine, self.resume, progress=progress)


DEFAULT_TRIALS: Final = 10
CERTIFICATION_TRIALS: Final = 2000
"""Runs of each case after which it stays undecided."""
TrialCount = Annotated[int, number(TRIAL_COUNT, help="number of trials of each case")]
_BASELINE: Final = "folder of an earlier run for a paired comparison"
_RUNS: Final = "number of runs of each case; default: 10, with --certify at most 2000"
_CERTIFY: Final = (
    "run each plan or policy until it is decided whether this share of runs succeeds: as predicted, or of a policy and "
    "of --plan auto with the goal built"
)
_CONFIDENCE: Final = "probability at least with which each answer of --certify is right"


@dataclass(frozen=True, kw_only=True)
class Trials(Work):
    """How trials are run; a subclass says how many."""

    baseline: Annotated[Folder | None, Parameter(metavar="DIR", help=_BASELINE)] = None

    def run(self, progress: "Progress") -> "RunOptions":
        """Return the options of an experiment."""
        options = super().run(progress)
        if self.baseline is None:
            return options
        return replace(options, against=Path(self.baseline))


@dataclass(frozen=True, kw_only=True)
class RunTrials(Trials):
    """How often each plan or policy is run: a number of times, or until its success is certain."""

    trials: Annotated[int | None, number(TRIAL_COUNT, help=_RUNS)] = None
    certify: Annotated[float | None, number(SUCCESS_RATE, help=_CERTIFY)] = None
    confidence: Annotated[float, number(CONFIDENCE_LEVEL, help=_CONFIDENCE)] = 0.95

    @property
    def most_trials(self) -> int:
        """Number of runs of each case, with ``certify`` the largest one."""
        if self.trials is not None:
            return self.trials
        if self.certify is not None:
            return CERTIFICATION_TRIALS
        return DEFAULT_TRIALS


_PLAN: Final = (
    "plan to execute: a file of 'tick car ACTION' lines, or auto: plan, act, read the world, and plan again after a "
    "failure"
)
_ORDER: Final = (
    "execution of plans: one action after the other; tick by tick; or concurrent, each action as soon as those that it "
    "depends on have ended"
)


@Parameter(name="*", group=_RUN)
@dataclass(frozen=True, kw_only=True)
class CarriedPlan:
    """The plan and its execution."""

    plan: Annotated[PlanChoice | None, Parameter(metavar="FILE|auto", help=_PLAN)] = None
    order: Annotated[PlanOrder, Parameter(help=_ORDER)] = "concurrent"

    @property
    def plan_file(self) -> Path | None:
        """The plan, if it is a file."""
        if self.plan is None:
            return None
        return Path(str(self.plan))


@Parameter(name="*", group=_RUN)
@dataclass(frozen=True, kw_only=True)
class GoalFile:
    """The design to build."""

    goal: Annotated[
        Path | None, Parameter(metavar="FILE", help="design to build instead of the task's goal")
    ] = None


_ACTIONS: Final = "file with one 'car ACTION' per line, executed in sequence"
_POLICY: Final = (
    "planner (the shipped plan, or one made at the start, with replanning after failures), random, play (random legal "
    "play, weighted towards rare actions), module:function, or a trained policy; several are compared. Default: "
    "planner, in random worlds play"
)
_REPLANS: Final = (
    "maximum number of further plans with --plan auto, default 10; with --policy, of plans that go on where a policy "
    "gets no further, and cars go back after failures; default 0"
)
_CARS: Final = (
    "number of cars; those not listed in the start are placed at random. Random worlds have 1 to 12"
)
_BLOCKS: Final = "number of blocks; in random worlds approximate"
_MAX_STEPS: Final = "ticks of an episode in random worlds, without the last two"


@dataclass(frozen=True, kw_only=True)
class Rollouts(CarriedPlan):
    """What is run in each world."""

    actions: Annotated[ActionsFile | None, Parameter(metavar="FILE", help=_ACTIONS)] = None
    policy: Annotated[PolicyChoice, Parameter(metavar="NAME", help=_POLICY)] = ()
    replans: Annotated[int | None, number(REPLANS, help=_REPLANS)] = None
    n_cars: Annotated[int | None, number(CARS, help=_CARS, name="--cars")] = None
    n_blocks: Annotated[int | None, number(BLOCKS, help=_BLOCKS, name="--blocks")] = None
    max_steps: Annotated[int, number(EPISODE_TICKS, help=_MAX_STEPS)] = 14
    timeout_s: Annotated[
        float, number(TIMEOUT_S, help="time limit of a run in seconds", name="--timeout")
    ] = 600.0


def changed(groups: tuple[Any, ...], values: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return groups of options with some values replaced. Raises InputError for an unknown name."""
    names = []
    changed_groups = []
    for group in groups:
        own_names = [field.name for field in fields(group)]
        own_values = {name: values[name] for name in own_names if name in values}
        names += own_names
        changed_groups.append(replace(group, **own_values))
    for name in values:
        if name not in names:
            raise InputError(
                f"no option '{name}'{suggestion(name, names)} (options: {', '.join(names)})"
            )
    return tuple(changed_groups)
