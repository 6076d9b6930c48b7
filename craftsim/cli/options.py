"""Types of options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

from cyclopts import Group, Parameter

RESULTS_GROUP: Final = Group("Results", sort_key=99)
"""The last heading of the help."""
Dir = Annotated[Path, Parameter(metavar="DIR", group=RESULTS_GROUP)]
OptionalDir = Annotated[Path | None, Parameter(metavar="DIR", group=RESULTS_GROUP)]
File = Annotated[Path | None, Parameter(metavar="FILE")]
RecordChoice = Annotated[Literal["none", "trajectory"], Parameter(group=RESULTS_GROUP)]
PlayedChoice = Annotated[Literal["none", "trajectory", "3d"], Parameter(group=RESULTS_GROUP)]
Shown = Annotated[bool, Parameter(group=RESULTS_GROUP)]
