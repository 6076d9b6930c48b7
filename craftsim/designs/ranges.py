"""Ranges of options of designs.

Help and tab completion import this, so it imports nothing heavy.
"""

from typing import Final

from craftsim.storage.limits import Range

DESIGN_SIDE: Final = Range(1, 128)
"""Size of a design in cells."""
