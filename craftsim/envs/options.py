"""How an environment works, on top of its task: every option with the values that it takes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args

from pydantic import AfterValidator, BeforeValidator, InstanceOf

from craftsim.discrete.actions import ACTIONS, as_own
from craftsim.discrete.asynchronous import Timing
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import RuleSet
from craftsim.discrete.tasks import Task
from craftsim.envs.actions import ActionForm, ChoiceForm, ObjectChoice
from craftsim.envs.observations import Images, Observe
from craftsim.mjcf.parameters import Drive, Machines
from craftsim.models.config import SimulationConfig
from craftsim.models.randomization import DomainRandomization
from craftsim.models.sensing import SensorNoise
from craftsim.models.world import PhysicsWorld
from craftsim.skills.gains import Gains
from craftsim.skills.library import own_skills
from craftsim.storage.limits import HELPER_DEPTH, WORKERS, Range
from craftsim.storage.records import record
from craftsim.workers.pool import Engine

BackendName = Literal["physics", "grid"]
Execution = Literal["synchronous", "asynchronous"]
Durations = Literal["nominal", "equal"]
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
    *("rule_set", "helper_depth", "time_weight", "actions", "object_choice", "local_view", "execution"),
    *_ASYNCHRONOUS,
)
"""What a batch of grid worlds takes."""
_GRID_OPTIONS: Final = (*BATCH_OPTIONS, "backend", "render_mode", "observe")
"""What the grid backend takes."""
_Pixels = Annotated[int, Range(1)]


def _path(value: object) -> object:
    return Path(value) if isinstance(value, str) else value


@record()
class Options:
    """How an environment works, on top of its task; docs/reference/environments.md explains each. Raises
    InputError for a bad value."""

    backend: BackendName = "physics"
    rule_set: RuleSet = "physical"
    helper_depth: Annotated[int, HELPER_DEPTH] | None = None
    """Search depth of the action helper; None is without it."""
    time_weight: Annotated[float, Range(0)] = 0.0
    """Cost of a simulated second."""
    render_mode: RenderMode | None = None
    render_camera: str | None = None
    """``overview`` unless given, ``top``, or ``front:CAR``, that of a car; physics only."""
    render_size: tuple[_Pixels, _Pixels] | None = None
    """Width and height of a picture in pixels, 640 x 480 unless given; physics only."""
    noise: InstanceOf[SensorNoise] | None = None
    """Noise of the cars' sensors and motors; physics only."""
    assumed: InstanceOf[SensorNoise] | None = None
    """The noise that the cars' pose estimate assumes before it finds out, whatever it is; physics only."""
    randomization: InstanceOf[DomainRandomization] | None = None
    """How far the physics of each episode is drawn from the nominal one; physics only."""
    config: InstanceOf[SimulationConfig] | None = None
    """How the physics is computed; physics only."""
    gains: InstanceOf[Gains] | None = None
    """Of the controllers, the shipped ones unless given; physics only."""
    machines: InstanceOf[Machines] | None = None
    """The parameters of cars, blocks and slopes, the nominal ones unless given; physics only."""
    drive: Drive | None = None
    """How cars touch the ground, ``rollers`` or ``reduced``; that of ``machines`` if they are given, and else
    ``reduced``, which is several times as fast (docs/explanation/drives.md says how far it can be trusted).
    Physics only."""
    skills: Annotated[Any, AfterValidator(own_skills)] = None
    """Skills of one's own in place of built-in ones, ``{Action.LIFT: MyLift}`` or ``{0: {Action.LIFT: MyLift}}``;
    physics only."""
    robots: Callable[..., Any] | None = None
    """Sets up a world whose cars are robots elsewhere, such as :func:`craftsim.robots.robots_at`; physics
    only."""
    check_contacts: bool = False
    """Whether the judge logs contacts, 3 % of the time; what is unsafe then ends at once. Physics only."""
    observers: Sequence[Callable[[PhysicsWorld], None]] = ()
    """Called with the PhysicsWorld after every control period; they may look, but not change it. Physics only."""
    record: Annotated[Path | None, BeforeValidator(_path)] = None
    """Folder that takes a trajectory of each episode, as :class:`craftsim.Trajectory` reads it; physics only."""
    observe: InstanceOf[Observe] | None = None
    """What cars observe instead of the rows of all entities; PettingZoo forms only."""
    images: InstanceOf[Images] | None = None
    """Camera images beside that; physics only."""
    actions: Annotated[tuple[Action, ...], BeforeValidator(as_own)] = ()
    """Registered actions (:func:`craftsim.register_action`), or their names, that are offered after the 15, in this
    order: the action space has so many more."""
    object_choice: InstanceOf[ObjectChoice] | None = None
    """Blocks, slopes and free cells that cars may choose to drive to, offered after all other actions; it needs the
    action helper."""
    local_view: Annotated[int, Range(0, 64)] | None = None
    """Radius of the window around each car that is observed as ``local_view``, in cells along x and y."""

    execution: Execution = "synchronous"
    """Whether all cars act in ticks, or ``asynchronous``: each decides when its own action has ended."""
    wait_s: Annotated[float, Range(0, above=True)] = 1.0
    """Asynchronous: STOP waits for the next event, so many seconds at most."""
    jitter: Annotated[float, Range(0, 10)] = 0.0
    """Asynchronous, grid: standard deviation of the logarithm of an action's duration."""
    failures: Annotated[float, Range(0, 1)] = 0.0
    """Asynchronous, grid: probability that an action ends without effect."""
    durations: Durations = "nominal"
    """Asynchronous, grid: those of a table, or ``equal``, 1 s for every action."""

    def __post_init__(self) -> None:
        if self.execution == "synchronous":
            self._leave_out(_ASYNCHRONOUS, "synchronous execution", "take execution='asynchronous'")
        if self.object_choice is not None and self.helper_depth is None:
            raise ValueError("object_choice needs the action helper; give helper_depth, 20 for instance")
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
        others = [one.name for one in dataclasses.fields(self) if one.name not in _GRID_OPTIONS]
        self._leave_out(others, "the grid backend", "take backend='physics'")

    def _leave_out(self, names: Sequence[str], what: str, instead: str) -> None:
        """Raise ValueError where one of some options is given."""
        for one in dataclasses.fields(self):
            if one.name in names and getattr(self, one.name) != one.default:
                raise ValueError(f"{what} knows no '{one.name}'; leave it out, or {instead}")

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
        return MOTION_FPS if self.shows_motion else RENDER_FPS


@record()
class BatchOptions:
    """How many worlds a batch has, and what simulates them. Raises InputError for a bad value."""

    num_envs: Annotated[int, Range(1)]
    workers: Annotated[int, WORKERS] | None = None
    """Processes that share the worlds, at most one per world; one for each processor unless given."""
    engine: Engine = "local"
    """Processes of this machine, or actors of an existing Ray cluster, of which each takes a processor."""
