"""The models of a car's drive."""

from __future__ import annotations

from typing import Final, Literal, get_args

Drive = Literal["wheels", "rollers"]
"""Model of the mecanum wheels: one tyre each, whose friction acts along its rollers, or ten free rollers each."""
DRIVES: Final[tuple[Drive, ...]] = get_args(Drive)
