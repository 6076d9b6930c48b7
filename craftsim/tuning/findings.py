"""What an identification leaves behind: figures for its report, and files of parameters and noise to run with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from craftsim.errors import InputError
from craftsim.logs.log import Floats, Log
from craftsim.mjcf.parameters import Machines
from craftsim.models.sensing import SensorNoise
from craftsim.storage.writing import write_whole
from craftsim.tuning.identification import Identification, Identified
from craftsim.tuning.prediction import CHANNELS, SEGMENT_S, Predictor
from craftsim.tuning.unknowns import machines_of

_LEAD: Final = 0.25
"""Share of a segment that a prediction is fitted to; what follows is predicted."""
_TO_MM: Final = {"m": (1e3, "mm"), "rad": (1e3, "mrad")}
POSITION_NOTE: Final = (
    "position bias of the localisation: no log without a map tells it, since motion is the same everywhere"
)


def prediction_errors(
    predictor: Predictor, machines: Machines, values: Mapping[str, float]
) -> dict[str, Any]:
    """Return how well a log is predicted, from the first quarter of each segment on, by channel: RMS and 95 %."""
    errors = predictor.errors(machines, values, lead=_LEAD)
    errors = errors[:, round(_LEAD * errors.shape[1]) :]
    found: dict[str, Any] = {}
    for name, (unit, columns) in CHANNELS.items():
        left = errors[..., columns]
        left = np.hypot(left[..., 0], left[..., 1]) if name == "position" else np.abs(left)
        left = left[np.isfinite(left)]
        factor, shown = _TO_MM.get(unit, (1.0, unit))
        if left.size:
            rms, most = factor * np.sqrt((left**2).mean()), factor * np.quantile(left, 0.95)
            found[name] = {"unit": shown, "rms": float(rms), "p95": float(most)}
    return found


def figures_of(found: Identification, predictor: Predictor, held_out: Predictor | None) -> dict[str, Any]:
    """Return what the report holds; ``held_out`` is of a log that nothing was fitted to."""
    start = {one.unknown.key: one.start for one in found.estimates}
    figures: dict[str, Any] = {
        "estimates": {
            one.unknown.key: {
                "what": one.unknown.words,
                "assumed": one.start,
                "value": one.value,
                "half_width_95": one.half_width,
                "told": one.told,
                "at_bound": one.at_bound,
            }
            for one in found.estimates
        },
        "untold": [*(one.text for one in found.untold), POSITION_NOTE],
        "noise": found.noise,
        "outliers": found.outliers,
        "values": found.n_values,
        "segments": found.n_segments,
        "segment_s": SEGMENT_S,
    }
    for name, log in (("fitted_log", predictor), ("held_out_log", held_out)):
        if log is not None:
            figures[name] = {
                "as_assumed": prediction_errors(log, machines_of(found.machines, start), start),
                "as_identified": prediction_errors(log, found.machines, found.values),
            }
    return figures


def write_parameters(path: Path, found: Identification, assumed: Machines, source: str) -> list[str]:
    """Write a file for ``--parameters``: what was assumed, with what the log tells in its place.

    Returns what was left out because the machines would not fit together with it, with the reason.
    """
    told = {
        section: {
            one.unknown.name: one for one in found.estimates if one.told and one.unknown.section == section
        }
        for section in ("smartcar", "block")
    }
    left_out = _drop_misfits(told, assumed)
    lines = [f"# Identified from {source}; intervals are of 95 %."]
    lines += [f"# Unidentifiable: {one.text}." for one in found.untold]
    lines += [f"# Left out: {text}" for text in left_out]
    for section, record in (("smartcar", assumed.car(0)), ("block", assumed.block)):
        rows = []
        for field in fields(record):
            value = getattr(record, field.name)
            if (one := told[section].get(field.name)) is not None:
                rows.append(
                    f"  {field.name}: {one.value:.6g}  # +- {one.half_width:.2g}, assumed {one.start:.6g}"
                )
            elif value != field.default:
                rows.append(f"  {field.name}: {value:.9g}")
        lines += [f"{section}:", *rows] if rows else []
    write_whole(path, "\n".join(lines) + "\n")
    return left_out


def _drop_misfits(told: dict[str, dict[str, Identified]], assumed: Machines) -> list[str]:
    """Remove from what was told what makes no car that fits together, and return why."""
    left_out = []
    for name in list(told["smartcar"]):
        try:
            kept: dict[str, Any] = {key: one.value for key, one in told["smartcar"].items() if key == name}
            replace(assumed, cars=(replace(assumed.car(0), **kept),))
        except InputError as error:
            left_out.append(f"{name}: {told['smartcar'].pop(name).value:.6g}; {error}".replace("\n", " "))
    return left_out


def write_noise(path: Path, found: Identification, log: Log, source: str) -> SensorNoise:
    """Write a file for ``--noise``: delay and lags where the log tells them, and what noise is left; return it."""
    told = {one.unknown.name: one.value for one in found.estimates if one.told}
    figures: dict[str, float] = {n: told[n] for n in ("encoder_lag_s", "motor_lag_s") if n in told}
    if "delay_s" in told:
        figures |= {"min_delay_s": told["delay_s"], "max_delay_s": told["delay_s"]}
    if "position" in found.noise:
        figures |= {"position_m": found.noise["position"], "heading_rad": found.noise["heading"]}
    if {"board", "board force"} <= found.noise.keys():
        figures |= {"board_m": found.noise["board"], "board_force_n": found.noise["board force"]}
    if (tilt := _jitter(log.tilt)) is not None:
        figures["tilt_rad"] = tilt
    noise = SensorNoise(**{name: float(f"{value:.4g}") for name, value in figures.items()})
    lines = [f"# Identified from {source}: what its sensors and motors do to commands and measurements."]
    lines += [f"{field.name}: {value:g}" for field in fields(noise) if (value := getattr(noise, field.name))]
    write_whole(path, "\n".join(lines) + "\n")
    return noise


def _jitter(values: Floats) -> float | None:
    """Return the white noise of a signal that changes slowly, from its differences from row to row."""
    steps = np.diff(values, axis=0)
    steps = steps[np.isfinite(steps)]
    return float(1.4826 * np.median(np.abs(steps)) / np.sqrt(2)) if steps.size > 10 else None
