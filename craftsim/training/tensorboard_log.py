"""The learning curve for TensorBoard."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from craftsim.errors import InputError
from craftsim.storage.folders import directory_within
from craftsim.training.curve import CurvePoint

FOLDER: Final = "tensorboard"
"""In the folder of a training run."""


class TensorboardLog:
    """Writes the points of a learning curve as they come: ``eval/success``, ``eval/return``, ``eval/ticks`` by steps.

    A run that goes on has its earlier points written again, in place of the log that it left.
    """

    def __init__(self, folder: Path, curve: Sequence[CurvePoint]) -> None:
        """Begin the log of a run in its folder, with the points that it has already.

        Raises InputError where TensorBoard is not installed.
        """
        if find_spec("tensorboard") is None:
            raise InputError(
                "--tensorboard needs tensorboard, not installed here; try: pip install tensorboard"
            )
        from torch.utils.tensorboard import SummaryWriter

        place = directory_within(folder, FOLDER)
        for old in place.glob("events.out.tfevents.*"):
            old.unlink()
        self._log = SummaryWriter(str(place))
        for point in curve:
            self.write(point)

    def write(self, point: CurvePoint) -> None:
        """Write a point, at once."""
        values = {"success": point.success, "return": point.mean_return, "ticks": point.mean_ticks}
        for name, value in values.items():
            self._log.add_scalar(f"eval/{name}", value, point.steps)
        self._log.flush()
