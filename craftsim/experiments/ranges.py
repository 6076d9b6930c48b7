"""Ranges of options of trials.

Help and tab completion import this, so it imports nothing heavy.
"""

from typing import Final

from craftsim.storage.limits import Range

TRIAL_COUNT: Final = Range(1, 1_000_000)
RUNS: Final = Range(1, 1_000_000)
"""Number of all trials of a run."""
