"""How an environment works, on top of its task: every option with the values that it takes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args

from pydantic import AfterValidator, BeforeValidator, InstanceOf

from craftsim.checking.setup import setup_of
from craftsim.discrete.actions import ACTIONS, as_registered
from craftsim.discrete.kinds import Action, Execution
from craftsim.discrete.ranges import HELPER_DEPTH
from craftsim.discrete.rules import RuleSet
from craftsim.envs.actions import ActionForm, ChoiceForm, ObjectChoice
from craftsim.envs.observations import Images, Observe
from craftsim.mjcf.drives import Drive
from craftsim.mjcf.machines import Machines
from craftsim.models.config import SimulationConfig
from craftsim.models.randomization import DomainRandomization
from craftsim.models.sensing import SensorNoise
from craftsim.models.world import PhysicsWorld
from craftsim.skills.gains import Gains, load_gains
from craftsim.skills.library import own_skills
from craftsim.storage.limits import WORKERS, Range
from craftsim.storage.records import record
from craftsim.tasks import Task
from craftsim.tasks.asynchronous import Timing
from craftsim.workers.pool import Engine

BackendName = Literal["physics", "grid"]
_Durations = Literal["nominal", "equal"]
RenderMode = Literal["rgb_array", "rgb_array_list", "human", "ansi"]
RENDER_MODES: Final[tuple[str, ...]] = get_args(RenderMode)
RENDER_FPS: Final = 2
"""Pictures a second in films of one picture a tick, which is about what a move takes."""
MOTION_FPS: Final = 10
"""Pictures a simulated second of the motion between two ticks (``rgb_array_list`` in physics)."""

_DRAWN: Final = ("jitter", "failures", "durations")
"""Of asynchronous execution on the grid; in physics actions take and do what they do."""
_ASYNCHRONOUS: Final = ("wait_s", *_DRAWN)
BATCH_OPTIONS: Final = (
    *(
        "rule_set",
        "helper_depth",
        "time_weight",
        "actions",
        "object_choice",
        "local_view",
        "execution",
    ),
    *_ASYNCHRONOUS,
)
"""What a batch of grid worlds takes."""
_GRID_OPTIONS: Final = (*BATCH_OPTIONS, "backend", "render_mode", "observe")
"""What the grid backend takes."""
_Pixels = Annotated[int, Range(1)]


def _path(value: object) -> object:
    if isinstance(value, str):
        return Path(value)
    return value


def _named(reader: Callable[[str | Path], Any]) -> BeforeValidator:
    """Read what is given by the name of a preset or by a file."""
    return BeforeValidator(lambda value: reader(value) if isinstance(value, str | Path) else value)


_Randomization = Annotated[
    InstanceOf[DomainRandomization] | str | Path | None,
    AfterValidator(lambda levels: levels if levels is None or setup_of(levels) else None),
]
_Noise = Annotated[
    InstanceOf[SensorNoise] | None, _named(lambda name: setup_of(noise=name).randomization.sensors)
]
_Gains = Annotated[InstanceOf[Gains] | None, _named(load_gains)]


@record()
class Options:
    """How an environment works, on top of its task; docs/reference/environments.md explains each. Raises
    InputError for a bad value."""

    backend: BackendName = "physics"
    rule_set: RuleSet = "physical"
    helper_depth: Annotated[int, HELPER_DEPTH] | None = None  # search depth of the action helper
    time_weight: Annotated[float, Range(0)] = 0.0  # cost of a simulated second
    actions: Annotated[
        tuple[Action, ...], BeforeValidator(as_registered)
    ] = ()  # registered ones, after the 15
    object_choice: InstanceOf[ObjectChoice] | None = (
        None  # offered after all other actions; needs the helper
    )
    local_view: Annotated[int, Range(0, 64)] | None = (
        None  # radius of the window that each car observes
    )
    observe: InstanceOf[Observe] | None = (
        None  # in place of the rows of all entities; PettingZoo forms only
    )
    render_mode: RenderMode | None = None

    execution: Execution = "synchronous"
    wait_s: Annotated[float, Range(0, above=True)] = (
        1.0  # STOP waits for the next event, so long at most
    )
    # Of asynchronous execution on the grid:
    jitter: Annotated[float, Range(0, 10)] = 0.0  # standard deviation of the logarithm of durations
    failures: Annotated[float, Range(0, 1)] = 0.0  # probability that an action ends without effect
    durations: _Durations = "nominal"  # those of a table, or 1 s for every action

    # Physics only:
    # The first three and gains also by the names and files that the commands take.
    noise: _Noise = None  # of the cars' sensors and motors
    assumed: _Noise = None  # by the pose estimate, before it finds out
    randomization: _Randomization = None  # drawn for each episode
    config: InstanceOf[SimulationConfig] | None = None
    gains: _Gains = None  # the shipped ones unless given
    machines: InstanceOf[Machines] | None = None  # the nominal ones unless given
    drive: Drive | None = None  # that of the machines unless given, see docs/explanation/drives.md
    skills: Annotated[Any, AfterValidator(own_skills)] = None  # {Action.LIFT: MyLift}, or by car
    recovers: bool = False  # a car whose action failed goes back to where it began
    robots: Callable[..., Any] | None = (
        None  # sets up a world of robots, as craftsim.robots.robots_at does
    )
    check_contacts: bool = (
        False  # the judge logs contacts, 3 % of the time; what is unsafe ends at once
    )
    observers: Sequence[
        Callable[[PhysicsWorld], None]
    ] = ()  # called after every control period; may only look
    images: InstanceOf[Images] | None = None
    render_camera: str | None = None  # ``overview`` unless given, ``top``, or ``front:CAR``
    render_size: tuple[_Pixels, _Pixels] | None = (
        None  # width and height in pixels, 640 x 480 unless given
    )
    record: Annotated[Path | None, BeforeValidator(_path)] = (
        None  # folder for a trajectory of each episode
    )

    def __post_init__(self) -> None:
        if self.execution == "synchronous":
            self._leave_out(_ASYNCHRONOUS, "synchronous execution", "take execution='asynchronous'")
        if self.object_choice is not None and self.helper_depth is None:
            raise ValueError(
                "object_choice needs the action helper; give helper_depth, 20 for instance"
            )
        if self.backend == "physics":
            for action in self.actions:
                if not ACTIONS[action].performed:
                    raise ValueError(
                        f"the action '{action.name}' was registered without a skill; physics needs one"
                    )
            self._leave_out(_DRAWN, "physics", "take backend='grid'")
            if self.robots is not None:
                self._leave_out(("check_contacts",), "a world of robots", "simulate its cars")
            return
        physics_options = [
            field.name for field in dataclasses.fields(self) if field.name not in _GRID_OPTIONS
        ]
        self._leave_out(physics_options, "the grid backend", "take backend='physics'")

    def _leave_out(self, names: Sequence[str], owner: str, instead: str) -> None:
        """Raise ValueError where one of some options is given."""
        for field in dataclasses.fields(self):
            if field.name in names and getattr(self, field.name) != field.default:
                raise ValueError(f"{owner} knows no '{field.name}'; leave it out, or {instead}")

    @property
    def timing(self) -> Timing | None:
        """How long things take in asynchronous execution; None in synchronous execution."""
        if self.execution == "synchronous":
            return None
        return Timing(self.wait_s, self.jitter, self.failures, self.durations == "equal")

    def action_form(self, task: Task) -> ActionForm:
        """Return the action form of a task."""
        if self.object_choice is None:
            return ActionForm(self.actions)
        return ChoiceForm(self.actions, self.object_choice, task)

    @property
    def shows_motion(self) -> bool:
        """Whether pictures are taken of the motion between two ticks."""
        return self.render_mode == "rgb_array_list" and self.backend == "physics"

    @property
    def render_fps(self) -> int:
        """Pictures a second at which a film of this environment plays."""
        if self.shows_motion:
            return MOTION_FPS
        return RENDER_FPS


@record()
class BatchOptions:
    """How many worlds a batch has, and what simulates them. Raises InputError for a bad value."""

    num_envs: Annotated[int, Range(1)]
    workers: Annotated[int, WORKERS] | None = None
    """Processes that share the worlds, at most one per world; one for each processor unless given."""
    engine: Engine = "local"
    """Processes of this machine, or actors of an existing Ray cluster, of which each takes a processor."""
