"""Ranges of options of training.

Help and tab completion import this, so it imports nothing heavy.
"""

from collections.abc import Mapping
from typing import Final

from craftsim.discrete.ranges import BATCH, BLOCKS, CARS, EPISODE_TICKS, HELPER_DEPTH
from craftsim.storage.limits import SEED, SHARE, Range

TRAIN_STEPS: Final = Range(1, 10**12)
TRAIN_EPISODES: Final = Range(1, 1_000_000)
RUN_RANGES: Final[Mapping[str, Range]] = {
    "seed": SEED,
    "worlds": BATCH,
    "width": Range(1, 4096),
    "novelty": Range(0, 1000),
    "n_cars": CARS,
    "n_blocks": BLOCKS,
    "max_steps": EPISODE_TICKS,
    "helper_depth": HELPER_DEPTH,
    "explore": Range(0, 10_000_000),
    # A reached world takes up to a kilobyte.
    "imitate": Range(0, 50_000),
    "shown_share": SHARE,
    "stage_steps": Range(0, TRAIN_STEPS.high),
    "evaluate_every": TRAIN_STEPS,
    "evaluation_episodes": TRAIN_EPISODES,
}
"""Those of the fields of a run's configuration, which are options of the command."""
