"""Ranges of options of robots and logs.

Help and tab completion import this, so it imports nothing heavy.
"""

from typing import Final

from craftsim.storage.limits import Range

DELAY_MS: Final = Range(0, 10_000)
"""Delay of a simulated network."""
PACE: Final = Range(0.01, 100)
"""Speed of simulated robots relative to real time."""
PATIENCE_S: Final = Range(0.01, 3600)
"""Time limit of an answer."""
LOGGED_CARS: Final = Range(0, 255)
"""Number of a car in a log."""
