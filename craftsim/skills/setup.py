"""The parameters and gains of a skill, and the ground of a move."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from craftsim.compiled.arrays import Records
from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.mjcf.machines import Machines
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.skills import state
from craftsim.skills.gains import Gains, careful
from craftsim.skills.mecanum import Triple


@dataclass(frozen=True)
class Terrain:
    """The map's part of an action: the pitch of the ground in a move's two cells, nose up positive, the room, and where
    a load stands."""

    start_rad: float = 0.0
    end_rad: float = 0.0
    tight: bool = False
    """Whether the way leads under something, or takes a load past something."""
    load_offset: Triple | None = None
    """Where what is to be lifted stands beside the middle of its cell: x and y in metres, and turn in radians. None
    where the boss catches it from the middle."""
    free_side: tuple[int, int] = (0, 0)
    """The direction, x and y, to which a load that passes something has room; (0, 0) where there is none."""

    @property
    def sloping(self) -> bool:
        """Whether the move starts or ends on a slope."""
        return bool(self.start_rad or self.end_rad)

    @property
    def steepest_rad(self) -> float:
        """The larger of the two pitches, up or down."""
        return max(abs(self.start_rad), abs(self.end_rad))


@dataclass(frozen=True)
class SkillSetup:
    """Parameters and gains for a skill."""

    machine: SmartcarParameters
    """The car's own parameters."""
    machines: Machines
    gains: Gains
    period_s: float
    """Control period."""
    terrain: Terrain = Terrain()
    """The ground of a move."""

    @cached_property
    def constants(self) -> Records:
        """(1,) KNOWN of :mod:`craftsim.skills.state`, read-only: the same for compiled laws."""
        return state.constants_of(self.machine, self.machines, self.gains, self.period_s)

    @property
    def expects_uneven_floor(self) -> bool:
        """Whether a path waits for a car that is beside it; on a flat floor no place in a cell is too far beside it."""
        return self.gains.drive.astray < CELL_PITCH_M

    def on(self, terrain: Terrain) -> SkillSetup:
        """Return the same for a move on other ground."""
        if terrain == self.terrain:
            return self
        changed = replace(self, terrain=terrain)
        vars(changed)["constants"] = self.constants  # they depend on all but the ground
        return changed

    def carefully(self) -> SkillSetup:
        """Return the same for driving as slowly as on an uneven floor."""
        return replace(self, gains=careful(self.gains))
