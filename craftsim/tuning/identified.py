"""The results of an identification: report, figure, and files of parameters and noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from craftsim.errors import InputError
from craftsim.mjcf.machines import Machines
from craftsim.models.sensing import SensorNoise
from craftsim.rendering.plots.style import DPI, ROW_IN, WIDTH_IN, paper, save
from craftsim.reports.report import (
    Column,
    DataTable,
    Headline,
    KeyFigure,
    Report,
    Section,
    TableCell,
    Tone,
    count,
)
from craftsim.robots.log import Log
from craftsim.storage.writing import write_whole
from craftsim.tuning.identification import MISFIT, Identification, Identified, Unidentified
from craftsim.tuning.prediction import SEGMENT_S, SIGNALS, Predictor, machines_of

_LEAD: Final = 0.25
"""Share of a segment that a prediction is fitted to; what follows is predicted."""
_TO_MM: Final = {"m": (1e3, "mm"), "rad": (1e3, "mrad")}
_POSITION_NOTE: Final = (
    "position bias of the localisation: no log without a map tells it, "
    "since motion is the same everywhere"
)


def prediction_errors(
    predictor: Predictor, machines: Machines, values: Mapping[str, float]
) -> dict[str, Any]:
    """Return how well a log is predicted, from the first quarter of each segment on, by channel: RMS and 95 %."""
    errors = predictor.errors(machines, values, lead=_LEAD)
    errors = errors[:, round(_LEAD * errors.shape[1]) :]
    figures: dict[str, Any] = {}
    for name, (unit, columns) in SIGNALS.items():
        residuals = errors[..., columns]
        if name == "position":
            residuals = np.hypot(residuals[..., 0], residuals[..., 1])
        else:
            residuals = np.abs(residuals)
        residuals = residuals[np.isfinite(residuals)]
        factor, shown_unit = _TO_MM.get(unit, (1.0, unit))
        if residuals.size:
            rms = factor * np.sqrt((residuals**2).mean())
            p95 = factor * np.quantile(residuals, 0.95)
            figures[name] = {"unit": shown_unit, "rms": float(rms), "p95": float(p95)}
    return figures


def _untold(identification: Identification, direction: Unidentified) -> str:
    """Return what a log does not tell, with the values that fit as well."""
    ends = identification[direction.held_key].range
    if ends is None or len(direction.members) > 1:
        return direction.text
    return f"{direction.text}; values from {ends[0]:.3g} to {ends[1]:.3g} fit as well"


def _at_bounds(identification: Identification) -> list[str]:
    """Return which estimates lie at the border of the search."""
    texts = []
    for estimate in identification.estimates:
        if estimate.at_bound:
            where = f"the best value lies at the border of the search, {estimate.value:.4g}"
            texts.append(f"{estimate.unknown.words}: {where}")
    return texts


def _misses(identification: Identification) -> str:
    """Return by how much the model misses the log, by channel that it does not explain."""
    texts = []
    for name, ratio in identification.misfit.items():
        if ratio > MISFIT:
            texts.append(f"{name} by {ratio:.3g} times the noise")
    return ", ".join(texts)


def identification_figures(
    identification: Identification, predictor: Predictor, held_out: Predictor | None
) -> dict[str, Any]:
    """Return what the report holds; ``held_out`` is of a log that nothing was fitted to."""
    start = {}
    estimates = {}
    for estimate in identification.estimates:
        key = estimate.unknown.key
        start[key] = estimate.start
        estimates[key] = {
            "what": estimate.unknown.words,
            "assumed": estimate.start,
            "value": estimate.value,
            "half_width_95": estimate.half_width,
            "told": estimate.identified,
            "at_bound": estimate.at_bound,
            "range": estimate.range,
        }
    untold = [_untold(identification, direction) for direction in identification.unidentified]
    figures: dict[str, Any] = {
        "estimates": estimates,
        "untold": [*untold, *_at_bounds(identification), _POSITION_NOTE],
        "fits": identification.fits,
        "noise": identification.noise,
        "measured_noise": identification.measured_noise,
        "misfit": identification.misfit,
        "outliers": identification.outliers,
        "values": identification.n_values,
        "segments": identification.n_segments,
        "segment_s": SEGMENT_S,
    }
    assumed = machines_of(identification.machines, start)
    for name, log in (("fitted_log", predictor), ("held_out_log", held_out)):
        if log is None:
            continue
        figures[name] = {
            "as_assumed": prediction_errors(log, assumed, start),
            "as_identified": prediction_errors(log, identification.machines, identification.values),
        }
    return figures


def write_parameters(
    path: Path, identification: Identification, assumed: Machines, source: str
) -> list[str]:
    """Write a file for ``--machines``: what was assumed, with what was fitted in its place.

    Returns what was left out because the machines would not fit together with it, with the reason.
    """
    fitted = {}
    left_out = []
    for estimate in identification.estimates:
        if not estimate.moved:
            continue
        if estimate.unknown.key.startswith("smartcar."):
            problem = _conflict_of(estimate, assumed)
            if problem:
                left_out.append(problem)
                continue
        fitted[estimate.unknown.key] = estimate
    lines = [f"# Identified from {source}; intervals are of 95 %."]
    if not identification.fits:
        lines.append(
            f"# The model misses the log: {_misses(identification)}. The intervals do not include that."
        )
    for direction in identification.unidentified:
        lines.append(f"# Unidentifiable: {_untold(identification, direction)}.")
    for text in left_out:
        lines.append(f"# Left out: {text}")
    for section, record in (("smartcar", assumed.car(0)), ("block", assumed.block)):
        rows = []
        for field in fields(record):
            value = getattr(record, field.name)
            fitted_value = fitted.get(f"{section}.{field.name}")
            if fitted_value is not None:
                certainty = _certainty(fitted_value)
                rows.append(f"  {field.name}: {fitted_value.value:.6g}  # {certainty}")
            elif value != field.default:
                rows.append(f"  {field.name}: {value:.9g}")
        if rows:
            lines += [f"{section}:", *rows]
    write_whole(path, "\n".join(lines) + "\n")
    return left_out


def _conflict_of(estimate: Identified, assumed: Machines) -> str:
    """Return the value of a car's parameter and why it does not fit the other machines; empty where it does."""
    name = estimate.unknown.name
    value: dict[str, Any] = {name: estimate.value}
    try:
        replace(assumed, cars=(replace(assumed.car(0), **value),))
    except InputError as error:
        return f"{name}: {estimate.value:.6g}; {error}".replace("\n", " ")
    return ""


def _certainty(estimate: Identified) -> str:
    """Return how sure an estimate is, and what was assumed."""
    assumed = f"assumed {estimate.start:.6g}"
    if estimate.at_bound:
        return f"at the border of the search, {assumed}"
    if estimate.half_width is None:
        return f"the log does not tell it; {assumed}"
    return f"+- {estimate.half_width:.2g}, {assumed}"


def write_noise(path: Path, identification: Identification, log: Log, source: str) -> SensorNoise:
    """Write a file for ``--noise``: delay and lags where the log tells them, and what noise is left; return it."""
    identified = {}
    for estimate in identification.estimates:
        if estimate.identified:
            identified[estimate.unknown.name] = estimate.value
    figures: dict[str, float] = {}
    for lag in ("encoder_lag_s", "motor_lag_s"):
        if lag in identified:
            figures[lag] = identified[lag]
    if "delay_s" in identified:
        figures |= {"min_delay_s": identified["delay_s"], "max_delay_s": identified["delay_s"]}
    if "position" in identification.noise:
        figures |= {
            "position_m": identification.noise["position"],
            "heading_rad": identification.noise["heading"],
        }
    if {"board", "board force"} <= identification.noise.keys():
        figures |= {
            "board_m": identification.noise["board"],
            "board_force_n": identification.noise["board force"],
        }
    # The white noise of a signal that changes slowly, from its differences from row to row.
    steps = np.diff(log.tilt, axis=0)
    steps = steps[np.isfinite(steps)]
    if steps.size > 10:
        figures["tilt_rad"] = float(1.4826 * np.median(np.abs(steps)) / np.sqrt(2))
    noise = SensorNoise(**{name: float(f"{value:.4g}") for name, value in figures.items()})
    lines = [
        f"# Identified from {source}: what its sensors and motors do to commands and measurements."
    ]
    for field in fields(noise):
        value = getattr(noise, field.name)
        if value:
            lines.append(f"{field.name}: {value:g}")
    write_whole(path, "\n".join(lines) + "\n")
    return noise


_ROWS: Final = (
    ("x (m)", 0, "error (mm)", 1e3),
    ("y (m)", 1, "error (mm)", 1e3),
    ("heading (rad)", 2, "error (mrad)", 1e3),
    ("front left wheel (rad/s)", 3, "error (rad/s)", 1.0),
    ("board force (N)", 8, "error (N)", 1.0),
)


def draw_prediction(
    folder: Path, identification: Identification, predictor: Predictor
) -> list[Path]:
    """Draw measured and predicted signals of a log over time into a PNG and a PDF, and return their paths."""
    from matplotlib.figure import Figure

    errors = predictor.errors(identification.machines, identification.values)
    rows = np.concatenate([np.arange(s.start, s.stop) for s in predictor.segments])
    time = predictor.log.time_s[rows]
    measured = predictor.measured[rows]
    residuals = errors.reshape(-1, errors.shape[-1])
    signals = [row for row in _ROWS if np.isfinite(measured[:, row[1]]).any()]
    with paper():
        figure = Figure(
            figsize=(WIDTH_IN, (ROW_IN + 0.15) * len(signals)), dpi=DPI, layout="constrained"
        )
        axes = figure.subplots(len(signals), 2, sharex=True, squeeze=False)
        for (name, column, unit, factor), (value_axes, residual_axes) in zip(
            signals, axes, strict=True
        ):
            value_axes.plot(
                time, measured[:, column], linewidth=1.2, color="0.65", label="measured"
            )
            value_axes.plot(
                time,
                measured[:, column] - residuals[:, column],
                linewidth=0.6,
                color="black",
                label="predicted",
            )
            value_axes.set_ylabel(name)
            residual_axes.plot(time, factor * residuals[:, column], linewidth=0.5, color="black")
            residual_axes.set_ylabel(unit)
        axes[0, 0].legend(loc="upper right")
        for axis in axes[-1]:
            axis.set_xlabel("time (s)")
        return [save(figure, folder / f"prediction.{ending}") for ending in ("png", "pdf")]


def identified_report(
    identification: Identification,
    log: str,
    document: Mapping[str, Any],
    files: Mapping[str, str | Path],
) -> Report:
    """Return the report of an identification from a log of this name; ``document`` is what ``report.json`` holds."""
    figures = document["figures"]
    identified = sum(estimate.identified for estimate in identification.estimates)
    n = len(identification.estimates)
    headline = _headline(identification, identified, log)
    worst = max(identification.misfit, key=lambda name: identification.misfit[name], default="")
    logs = {"fitted_log": "the log that was fitted to", "held_out_log": "the held-out log"}
    about = "What was assumed before, what the log says, and how sure it is."
    lacking = "What the log cannot say, and why."
    predicted = "Errors of predictions over 1.5 s, with the car as assumed and as identified."
    unidentified = [f"Unidentifiable: {text}" for text in figures["untold"]]
    unidentified += [f"Not in parameters.yaml: {text}" for text in figures["left_out"]]
    predictions = [
        _prediction(figures[key], words) for key, words in logs.items() if key in figures
    ]
    outliers = f"{figures['outliers']:,} outliers left out"
    return Report(
        "Identification of a car",
        log,
        headline,
        [
            KeyFigure(f"{identified}", "parameters identified", f"of {n}"),
            KeyFigure(
                f"{identification.misfit.get(worst, 0.0):.2f}",
                "largest residual, in terms of the noise",
                worst,
            ),
            KeyFigure(f"{figures['values']:,}", "measured values", outliers),
        ],
        [
            Section(
                "parameters",
                "Parameters",
                about,
                [_estimates(identification.estimates)],
                terminal=True,
            ),
            Section("fit", "Fit", _FIT, [_fit(identification)], terminal=True),
            Section("prediction", "Prediction", predicted, predictions, terminal=True),
            Section("unidentified", "Not identified", lacking, unidentified, terminal=True),
        ],
        notes=figures["notes"],
        files=files,
        document=document,
        exit_code=0 if identified and identification.fits else 1,
    )


def _headline(identification: Identification, identified: int, log: str) -> Headline:
    n = len(identification.estimates)
    if not identification.fits:
        sentence = (
            f"The model misses {log}: {_misses(identification)} of the measurements. "
            f"Its {count(n, 'parameter')} make up for "
            "what it lacks, and their intervals do not include that."
        )
        return Headline("Does not fit", Tone.CAUTION, sentence)
    sentence = f"{identified} of {count(n, 'parameter')} identified from {log}; the model leaves no more than noise."
    if not identified:
        return Headline("Nothing identified", Tone.CAUTION, sentence)
    return Headline("Identified", Tone.GOOD, sentence)


_FIT: Final = (
    "Standard deviation of what the model leaves of the log, outliers aside, and of the noise of the measurements, by "
    f"their differences from row to row. Above {MISFIT:g} times the noise the model does not explain the log."
)


def _fit(identification: Identification) -> DataTable:
    rows = []
    for name, residual in identification.noise.items():
        unit, _ = SIGNALS[name]
        ratio = identification.misfit[name]
        if ratio > MISFIT:
            tone = Tone.BAD
        else:
            tone = Tone.PLAIN
        noise = f"{identification.measured_noise[name]:.3g}"
        rows.append((f"{name}, {unit}", f"{residual:.3g}", noise, TableCell(f"{ratio:.2f}", tone)))
    numbers = (Column(name, "number") for name in ("left", "noise", "ratio"))
    return DataTable((Column("channel"), *numbers), rows, "Residuals")


def _estimates(estimates: Sequence[Identified]) -> DataTable:
    rows: list[tuple[str | TableCell, ...]] = []
    for estimate in estimates:
        sure = estimate.identified
        value = TableCell(f"{estimate.value:.4g}", Tone.PLAIN if sure else Tone.CAUTION)
        if estimate.half_width is None:
            value = TableCell("not told", Tone.MUTED)
        rows.append((estimate.unknown.words, f"{estimate.start:.4g}", value, _interval(estimate)))
    numbers = (Column(name, "number") for name in ("assumed", "fitted", "95 % interval"))
    note = "uncertain: the interval is wider than half of what such a figure commonly differs by."
    return DataTable((Column("what"), *numbers), rows, "Parameters", note)


def _interval(estimate: Identified) -> str:
    if estimate.range is not None:
        return f"{estimate.range[0]:.3g} to {estimate.range[1]:.3g}"
    if estimate.half_width is None:
        return ""
    if estimate.at_bound:
        return "at the border of the search"
    if estimate.identified:
        uncertain = ""
    else:
        uncertain = ", uncertain"
    return f"+- {estimate.half_width:.2g}{uncertain}"


def _prediction(errors: Mapping[str, Mapping[str, Mapping[str, Any]]], words: str) -> DataTable:
    rows = []
    for channel, figures in errors["as_identified"].items():
        values = errors["as_assumed"][channel]["rms"], figures["rms"], figures["p95"]
        rows.append((f"{channel}, {figures['unit']}", *(f"{value:.3g}" for value in values)))
    numbers = (Column(name, "number") for name in ("as assumed", "as identified", "95 % below"))
    return DataTable(
        (Column("channel"), *numbers), rows, f"RMS errors of 1.5 s predictions, {words}"
    )
