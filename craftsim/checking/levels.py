"""The presets of the randomization, and their numbers."""

from __future__ import annotations

from typing import Final

LEVELS: Final = ("none", "mild", "strong", "lab_floor", "workshop_floor")
"""Randomization presets, levels 0 to 4: exact, mild, strong, lab floor, workshop floor."""


def preset_of_level(name: str) -> str:
    """Return the preset for the number or name of a level; anything else unchanged.

    Example:
        >>> preset_of_level("0"), preset_of_level("4"), preset_of_level("exact"), preset_of_level("mine.yaml")
        ('none', 'workshop_floor', 'none', 'mine.yaml')
    """
    levels = {str(number): preset for number, preset in enumerate(LEVELS)} | {"exact": LEVELS[0]}
    return levels.get(name, name)
