"""Situations that take more than one car, or more than the contexts vary: drawn by hand, each for a suspect rule."""

from __future__ import annotations

from typing import Final

from craftsim.validation.audit.scenes.flaps import flaps
from craftsim.validation.audit.scenes.loads import lifts_and_drops, onto_folded_slopes_and_flags
from craftsim.validation.audit.scenes.ramps import ramps
from craftsim.validation.audit.scenes.scene import Scene
from craftsim.validation.audit.scenes.ticks import ticks
from craftsim.validation.audit.scenes.turns import turns

SCENES: Final[tuple[Scene, ...]] = (
    *flaps(),
    *turns(),
    *ramps(),
    *lifts_and_drops(),
    *onto_folded_slopes_and_flags(),
    *ticks(),
)

__all__ = ["SCENES", "Scene"]
