"""Ranges of options of the grid: sizes of worlds and episodes.

Help and tab completion import this, so it imports nothing heavy.
"""

from typing import Final

from craftsim.storage.limits import Range

CARS: Final = Range(0, 256)
BLOCKS: Final = Range(0, 131_072)
EPISODE_TICKS: Final = Range(1, 100_000)
BATCH: Final = Range(1, 100_000)
"""Number of worlds of a batch on the grid."""
HELPER_DEPTH: Final = Range(0, 100)
"""Search depth of the action helper in primitive actions."""
