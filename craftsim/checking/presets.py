"""Names of the randomization presets, without heavy imports."""

from __future__ import annotations

from typing import Final

RANDOMIZATIONS: Final = ("none", "mild", "strong", "lab_floor", "workshop_floor")
"""Each has more than the one before."""
