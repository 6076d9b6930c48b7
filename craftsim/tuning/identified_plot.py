"""The figure of an identification: what was measured, and what the identified car would have measured."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from craftsim.rendering.plots.style import ROW_IN, WIDTH_IN, paper
from craftsim.storage.writing import whole
from craftsim.tuning.identification import Identification
from craftsim.tuning.prediction import Predictor

_ROWS: Final = (
    ("x (m)", 0, "error (mm)", 1e3),
    ("y (m)", 1, "error (mm)", 1e3),
    ("heading (rad)", 2, "error (mrad)", 1e3),
    ("front left wheel (rad/s)", 3, "error (rad/s)", 1.0),
    ("board force (N)", 8, "error (N)", 1.0),
)
_DPI: Final = 200
_ENDINGS: Final = ("png", "pdf")


def draw_prediction(folder: Path, found: Identification, predictor: Predictor) -> list[Path]:
    """Draw measured and predicted signals of a log over time into a PNG and a PDF, and return their paths.

    Raises InputError where the disk does not take them.
    """
    from matplotlib.figure import Figure

    errors = predictor.errors(found.machines, found.values)
    rows = np.concatenate([np.arange(s.start, s.stop) for s in predictor.segments])
    time, measured = predictor.log.time_s[rows], predictor.measured[rows]
    left = errors.reshape(-1, errors.shape[-1])
    shown = [row for row in _ROWS if np.isfinite(measured[:, row[1]]).any()]
    written = []
    with paper():
        figure = Figure(figsize=(WIDTH_IN, (ROW_IN + 0.15) * len(shown)), dpi=_DPI, layout="constrained")
        axes = figure.subplots(len(shown), 2, sharex=True, squeeze=False)
        for (name, column, unit, factor), (value, rest) in zip(shown, axes, strict=True):
            value.plot(time, measured[:, column], linewidth=1.2, color="0.65", label="measured")
            value.plot(
                time, measured[:, column] - left[:, column], linewidth=0.6, color="black", label="predicted"
            )
            value.set_ylabel(name)
            rest.plot(time, factor * left[:, column], linewidth=0.5, color="black")
            rest.set_ylabel(unit)
        axes[0, 0].legend(loc="upper right")
        for axis in axes[-1]:
            axis.set_xlabel("time (s)")
        for ending in _ENDINGS:
            path = folder / f"prediction.{ending}"
            metadata = {"Software": None} if ending == "png" else {"CreationDate": None, "Producer": None}
            with whole(path) as partial:
                figure.savefig(partial, dpi=_DPI, metadata=metadata)
            written.append(path)
    return written
