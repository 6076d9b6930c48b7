"""What the records of validations and of audits hold: the schemas by which they are read back."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field

from craftsim.checking.attempt import Attempt, Finding, Verdict
from craftsim.experiments.experiment import STRICT, Form
from craftsim.experiments.records import Finished, read_any

_Count = Annotated[int, Field(ge=0, lt=2**53)]


@dataclass(frozen=True, repr=False)
class Judged(Attempt):
    """An attempt as a record holds it.

    A schema of its own, because a run's records are held to more than the attempts of bundles and trajectories: whole
    numbers that JSON keeps, and known verdicts and findings.
    """

    __pydantic_config__ = STRICT
    tick: _Count
    car: _Count
    level: _Count
    result: Verdict
    finding: Finding
    capped_steps: _Count
    tries: _Count


@dataclass(frozen=True)
class _Recovery:
    """What a run of a policy with recovery leaves besides."""

    __pydantic_config__ = STRICT
    replaces: str
    plans: _Count
    seated: _Count


@dataclass(frozen=True)
class _RunExtra:
    """What a run leaves besides its attempts."""

    __pydantic_config__ = STRICT
    ticks: _Count
    forbidden: _Count
    makespan_s: float
    grid_success: bool = False
    physics_success: bool = False
    coverage: dict[str, dict[str, _Count]] = field(default_factory=dict)
    does_not_stand: str = ""
    identical: Annotated[int, Field(ge=1, lt=2**53)] = 1
    """Number of trials that this one stands for: nothing is drawn at random in any of them."""
    recovery: _Recovery | None = None


@dataclass(frozen=True, kw_only=True)
class _BuildExtra(_RunExtra):
    """What a building with re-planning leaves besides."""

    __pydantic_config__ = STRICT
    ended: Literal["built", "gave up", "not readable"]
    why: str
    replans: _Count
    seated: _Count = 0
    planned_s: float
    disturbed: str


@dataclass(frozen=True)
class _TrialExtra:
    """What a trial of an audit leaves besides its attempts."""

    __pydantic_config__ = STRICT
    does_not_stand: tuple[str, ...] = ()
    identical: Annotated[int, Field(ge=1, lt=2**53)] = 1


RUN_FORM: Final = Form(Judged, _RunExtra)
BUILD_FORM: Final = Form(Judged, _BuildExtra)
TRIAL_FORM: Final = Form(Judged, _TrialExtra)
COMPARED: Final = {"validate": RUN_FORM, "audit": TRIAL_FORM}
"""What the records of the commands hold that make runs to compare."""


def read_run(folder: Path) -> Finished:
    """Return the finished run in a folder; raise InputError for a folder that holds none of validate or audit."""
    return read_any(folder, COMPARED, "give the --out of 'craftsim validate' or 'craftsim audit'")
