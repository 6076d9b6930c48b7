"""Ranges of options of trials.

Help and tab completion import this, so it imports nothing heavy.
"""

from typing import Final

from craftsim.storage.limits import Range

TRIAL_COUNT: Final = Range(1, 1_000_000)
RUNS: Final = Range(1, 1_000_000)
"""Number of all trials of a run."""
SUCCESS_RATE: Final = Range(0.01, 0.9999)
"""Success rates that can be certified."""
CONFIDENCE_LEVEL: Final = Range(0.5, 0.999999)
