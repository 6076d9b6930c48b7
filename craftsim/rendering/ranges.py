"""Ranges of options of films and pictures.

Help and tab completion import this, so it imports nothing heavy.
"""

from typing import Final

from craftsim.storage.limits import Range

FRAME_RATE: Final = Range(1, 120)
"""Frames per second of a film."""
FILM_SPEED: Final = Range(0.01, 1000)
"""Simulated seconds per second of film."""
MOMENT_S: Final = Range(0, 1_000_000)
"""Simulated time of a picture."""
