"""How an environment works, on top of its task: every option with the values that it takes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.kinds import Action
from craftsim.discrete.own_actions import as_own
from craftsim.discrete.rules import RuleSet
from craftsim.discrete.tasks import Task
from craftsim.envs.backend import MOTION_FPS, Backend
from craftsim.envs.grid_backend import GridBackend
from craftsim.envs.images import Images
from craftsim.envs.observe import Observe
from craftsim.errors import InputError, suggestion

if TYPE_CHECKING:
    from craftsim.mjcf.parameters import Drive, Machines
    from craftsim.models.config import SimulationConfig
    from craftsim.models.randomization import DomainRandomization
    from craftsim.models.sensing import SensorNoise
    from craftsim.models.world import PhysicsWorld
    from craftsim.skills.gains import Gains
    from craftsim.skills.library import SkillChoice

BackendName = Literal["physics", "grid"]
RenderMode = Literal["rgb_array", "rgb_array_list", "human", "ansi"]
RENDER_MODES: Final[tuple[str, ...]] = get_args(RenderMode)
RENDER_FPS: Final = 2
"""Pictures a second in films of one picture a tick, which is about what a move takes."""

_PHYSICS_KINDS: Final = {
    "noise": ("craftsim.models.sensing", "SensorNoise"),
    "assumed": ("craftsim.models.sensing", "SensorNoise"),
    "randomization": ("craftsim.models.randomization", "DomainRandomization"),
    "config": ("craftsim.models.config", "SimulationConfig"),
    "gains": ("craftsim.skills.gains", "Gains"),
    "machines": ("craftsim.mjcf.parameters", "Machines"),
}
_PHYSICS_ONLY: Final = (
    *_PHYSICS_KINDS,
    "drive",
    "skills",
    "render_camera",
    "render_size",
    "record",
    "images",
)


@dataclass(frozen=True)
class Options:
    """How an environment works, on top of its task; docs/reference/environments.md explains each. Raises
    InputError for a bad value."""

    backend: BackendName = "physics"
    rule_set: RuleSet = "physical"
    helper_depth: int | None = None
    """Search depth of the action helper; None is without it."""
    time_weight: float = 0.0
    """What a simulated second costs."""
    render_mode: RenderMode | None = None
    render_camera: str | None = None
    """``overview`` unless given, ``top``, or ``front:CAR``, that of a car; physics only."""
    render_size: tuple[int, int] | None = None
    """Width and height of a picture in pixels, 640 x 480 unless given; physics only."""
    noise: SensorNoise | None = None
    """Noise of the cars' sensors and motors; physics only."""
    assumed: SensorNoise | None = None
    """What the cars' pose estimate takes that noise to be before it finds out, whatever it is; physics only."""
    randomization: DomainRandomization | None = None
    """How far the physics of each episode is drawn from the nominal one; physics only."""
    config: SimulationConfig | None = None
    """How the physics is computed; physics only."""
    gains: Gains | None = None
    """Of the controllers, the shipped ones unless given; physics only."""
    machines: Machines | None = None
    """The parameters of cars, blocks and slopes, the nominal ones unless given; physics only."""
    drive: Drive | None = None
    """How cars touch the ground, ``rollers`` or ``reduced``; that of ``machines`` if they are given, and
    else ``reduced``, which is several times as fast (docs/explanation/drives.md says how far it can be trusted).
    Physics only."""
    skills: SkillChoice | None = None
    """Skills of one's own in place of built-in ones, ``{Action.LIFT: MyLift}`` or ``{0: {Action.LIFT: MyLift}}``;
    physics only."""
    check_contacts: bool = False
    """Whether the judge logs contacts, 3 % of the time; what is unsafe then ends at once. Physics only."""
    observers: tuple[Callable[[PhysicsWorld], None], ...] = ()
    """Called with the PhysicsWorld after every control period; they may look, but not change it. Physics only."""
    record: str | Path | None = None
    """Folder that takes a trajectory of each episode, as :class:`craftsim.Trajectory` reads it; physics only."""
    observe: Observe | None = None
    """What cars observe instead of the rows of all entities; PettingZoo forms only."""
    images: Images | None = None
    """What cameras see, beside that; physics only."""
    actions: tuple[Action | str, ...] = ()
    """Registered actions (:func:`craftsim.register_action`), or their names, that are offered after the 15, in this
    order: the action space has so many more."""

    def __post_init__(self) -> None:
        choices = {"backend": get_args(BackendName), "render_mode": (None, *RENDER_MODES)}
        for name, allowed in choices.items():
            value = getattr(self, name)
            if value not in allowed:
                words = [str(word) for word in allowed]
                raise InputError(
                    f"unknown {name} '{value}'{suggestion(str(value), words)}; there are {', '.join(words)}"
                )
        depth, weight, size = self.helper_depth, self.time_weight, self.render_size
        if depth is not None and not (isinstance(depth, int) and depth >= 0):
            raise InputError(f"helper_depth is {depth!r}; allowed: None, or 0 and more")
        if not (isinstance(weight, int | float) and 0 <= weight < math.inf):
            raise InputError(f"time_weight is {weight!r}; allowed: 0 and more, and finite")
        for name in _PHYSICS_ONLY:
            if self.backend == "grid" and getattr(self, name) is not None:
                raise InputError(
                    f"the grid backend knows no '{name}'; leave it out, or take backend='physics'"
                )
        if size is not None and not (
            isinstance(size, tuple) and len(size) == 2 and all(isinstance(n, int) and n > 0 for n in size)
        ):
            raise InputError(f"render_size is {size!r}; allowed: (width, height) in pixels, 1 and more")
        if not isinstance(self.record, str | Path | None):
            raise InputError(f"record is {self.record!r}; allowed: the path of a folder")
        object.__setattr__(self, "actions", as_own(self.actions))
        for action in as_own(self.actions):
            if self.backend == "physics" and not ACTIONS[action].performed:
                raise InputError(
                    f"the action '{action.name}' was registered without a skill; physics needs one"
                )
        self._check_callables()

    def _check_callables(self) -> None:
        if not isinstance(self.observers, list | tuple) or not all(map(callable, self.observers)):
            raise InputError(
                f"observers is {self.observers!r}; allowed: a sequence of functions of a PhysicsWorld"
            )
        if self.observers and self.backend == "grid":
            raise InputError(
                "the grid backend has no control periods to observe; leave 'observers' out, or take backend='physics'"
            )
        if self.observe is not None and not isinstance(self.observe, Observe):
            raise InputError(f"the option 'observe' must be an Observe, not {self.observe!r}")
        if self.images is not None and not isinstance(self.images, Images):
            raise InputError(f"the option 'images' must be an Images, not {self.images!r}")

    @classmethod
    def named(cls, **options: Any) -> Options:
        """Return options given by name; raises InputError for a name that is none of them."""
        known = [field.name for field in fields(cls)]
        for name in options:
            if name not in known:
                raise InputError(
                    f"unknown option '{name}'{suggestion(name, known)}; there are {', '.join(known)}"
                )
        return cls(**options)

    @property
    def render_fps(self) -> int:
        """Pictures a second at which a film of this environment plays."""
        return MOTION_FPS if self._shows_motion else RENDER_FPS

    @property
    def _shows_motion(self) -> bool:
        return self.render_mode == "rgb_array_list" and self.backend == "physics"

    def make_backend(self, task: Task) -> Backend:
        """Return the backend; only here does the physics get imported."""
        if self.backend == "grid":
            return GridBackend()
        if self.images is not None or self.render_mode in ("rgb_array", "rgb_array_list"):
            from craftsim.rendering.backend import choose_backend

            choose_backend()
        from craftsim.checking.setup import Setup, nominal_gains
        from craftsim.envs.physics_backend import PhysicsBackend
        from craftsim.envs.pictures import Pictures
        from craftsim.envs.records import EpisodeRecords
        from craftsim.mjcf.parameters import NOMINAL
        from craftsim.models.config import SimulationConfig
        from craftsim.models.randomization import NONE
        from craftsim.models.sensing import ASSUMED
        from craftsim.rendering.images import CameraImages
        from craftsim.skills.library import check_cars, own_skills

        for name, (module, kind) in _PHYSICS_KINDS.items():
            value = getattr(self, name)
            if value is not None and not isinstance(value, getattr(import_module(module), kind)):
                raise InputError(f"the option '{name}' must be a {kind}, not {value!r}")
        machines = self.machines or replace(NOMINAL, drive="reduced")
        if self.drive is not None:
            machines = replace(machines, drive=self.drive)
        randomization = self.randomization or NONE
        setup = Setup(
            rules=self.rule_set,
            randomization=randomization if self.noise is None else replace(randomization, sensors=self.noise),
            assumed=self.assumed or ASSUMED,
            simulation=self.config or SimulationConfig.of(machines.drive),
            gains=self.gains or nominal_gains(),
            machines=machines,
            skills=own_skills(self.skills),
        )
        check_cars(setup.skills, task.layout.n_cars)
        pictures = Pictures(self.render_camera, self.render_size, self._shows_motion)
        seen, n_cars = self.images, task.layout.n_cars
        images = None if seen is None else CameraImages(seen.cameras(n_cars), seen.size, seen.kinds)
        records = None if self.record is None else EpisodeRecords(Path(self.record), task.name, task.design)
        return PhysicsBackend(
            setup,
            self.helper_depth,
            task.goal_cells,
            self.observers,
            self.check_contacts,
            pictures,
            records,
            images,
        )
