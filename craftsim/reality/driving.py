"""The drives beside a real robot: its wheels' measured speeds are what simulated wheels are commanded.

What is compared are ways in windows of several lengths, in the robot's frame as a window begins, with those of ideal
mecanum kinematics as the baseline: of nominal parameters, of a fitted radius and lever, and of a fitted radius of each
wheel and a lever. :mod:`craftsim.tuning.identification` fits the simulated robot.

Where markers sit on a robot, and by how much they are turned, belongs to the measurement: it is fitted with the robot's
figures, and taken out of what is compared.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from craftsim.compiled.arrays import Floats
from craftsim.errors import InputError
from craftsim.experiments.intervals import CONFIDENCE, Estimate
from craftsim.mjcf.car import WHEELS
from craftsim.mjcf.drives import DRIVES
from craftsim.mjcf.machines import Machines
from craftsim.reality.recordings import PERIOD_S, DriveRecording, joined_log, on_drive
from craftsim.reality.resampling import draws, estimate_of, interval_of
from craftsim.tuning.identification import Identification
from craftsim.tuning.prediction import SEGMENT_S, UNKNOWNS, Predictor

WINDOWS_S: Final = (0.5, 2.0, 10.0)
"""Lengths of windows whose ways are compared."""
_FITTED_S: Final = 1.0
"""Length of windows that kinematics are fitted to."""
_REGRESSED_S: Final = 0.5
"""Length of windows that effective radii are taken from: within one a robot hardly turns."""
_COMMON_ERROR_M: Final = 0.005
"""Beyond which an error counts less in a fit."""
_OUTLIER: Final = 6.0
"""In terms of the spread of what is left."""
_TRIMS: Final = 3
_LEAST_MOTION_RAD: Final = 0.05
"""Mean turn of a wheel in a window that says something of its radius."""
_FEWEST_WINDOWS: Final = 10
"""That effective radii are taken from."""
_FEWEST_FITTED: Final = 4
"""That kinematics are fitted to."""
_SHORTEST_HALF_S: Final = 10.0
"""Half of a single drive."""
_SURE: Final = 0.05
"""Share of a radius that half its interval may be, or the drive does not show it."""
IDENTIFIED: Final = (
    "smartcar.wheel_radius_m",
    "smartcar.wheel_y_m",
    "smartcar.roller_friction",
    "mounting.heading_bias_rad",
    "mounting.marker_x_m",
    "mounting.marker_y_m",
)
"""What is fitted of the simulated robot: of its lever, half the track."""
RADIUS_SHARE: Final = 0.01
"""By what share of it an effective radius has to differ, interval and all, to count."""
DRIFT: Final = 0.005
"""Radians or metres a metre by which a robot has to leave its course, interval and all, to count."""

# Of the wheels' angles: how far the robot goes forward and to the left, and turns, in terms of their radius.
_FORWARD: Final = np.array([1.0, 1.0, 1.0, 1.0]) / 4
_LEFT: Final = np.array([-1.0, 1.0, 1.0, -1.0]) / 4
_TURN: Final = np.array([-1.0, 1.0, -1.0, 1.0]) / 4


class Mounting(NamedTuple):
    """Where a robot's markers are."""

    heading_bias_rad: float = 0.0
    """By how much measured headings are larger than true ones."""
    marker_x_m: float = 0.0
    marker_y_m: float = 0.0
    """Ahead and left of the middle of the wheels."""


@dataclass(frozen=True, eq=False)
class Kinematics:
    """Ideal mecanum kinematics, with rollers that do not slip."""

    radii_m: Floats
    """(4,), in the order of WHEELS."""
    lever_m: float
    """Half the track and half the wheelbase."""

    def poses(self, angles: Floats) -> Floats:
        """Return the poses (n, 3) from the origin on of a robot whose wheels have turned by ``angles`` (n, 4)."""
        rolled = np.diff(angles, axis=0) * self.radii_m
        forward = rolled @ _FORWARD
        sideways = rolled @ _LEFT
        turn = rolled @ _TURN / self.lever_m
        heading = np.concatenate([[0.0], np.cumsum(turn)])
        middle = heading[:-1] + turn / 2
        cos = np.cos(middle)
        sin = np.sin(middle)
        x = np.cumsum(cos * forward - sin * sideways)
        y = np.cumsum(sin * forward + cos * sideways)
        return np.column_stack([np.append(0.0, x), np.append(0.0, y), heading])


def robot_poses(recording: DriveRecording, mounting: Mounting) -> Floats:
    """Return the measured poses of the middle of the wheels, (n, 3); nan where not measured."""
    poses = recording.log.pose.copy()
    poses[:, 2] -= mounting.heading_bias_rad
    cos = np.cos(poses[:, 2])
    sin = np.sin(poses[:, 2])
    poses[:, 0] -= cos * mounting.marker_x_m - sin * mounting.marker_y_m
    poses[:, 1] -= sin * mounting.marker_x_m + cos * mounting.marker_y_m
    return poses


def window_starts(poses: Floats, periods: int) -> np.ndarray:
    """Return the first rows (k,) of windows one after the other, at both ends of which a pose is known."""
    measured = np.isfinite(poses).all(axis=-1).reshape(-1)
    starts = []
    row = 0
    while row + periods < len(poses):
        if measured[row] and measured[row + periods]:
            starts.append(row)
            row += periods
        else:
            row += 1
    return np.array(starts, int)


def travelled(poses: Floats, starts: np.ndarray, periods: int) -> Floats:
    """Return the ways (k, 3) in windows, each in the robot's frame as it begins."""
    change = poses[starts + periods] - poses[starts]
    cos = np.cos(poses[starts, 2])
    sin = np.sin(poses[starts, 2])
    forward = cos * change[:, 0] + sin * change[:, 1]
    sideways = -sin * change[:, 0] + cos * change[:, 1]
    return np.column_stack([forward, sideways, change[:, 2]])


@dataclass(frozen=True, eq=False)
class KinematicFit:
    """Kinematics and markers that fit drives best."""

    kinematics: Kinematics
    mounting: Mounting
    covariance: Floats
    """Of radii, lever and mounting, with windows as independent samples (Liang and Zeger's sandwich estimate)."""
    n_radii: int
    """1, or one for each wheel."""
    n_windows: int

    def half_width(self, contrast: Floats) -> float:
        """Return half the 95 % interval of a linear combination of the figures."""
        from scipy.stats import t

        freedom = max(1, self.n_windows - len(self.covariance))
        deviation = float(np.sqrt(contrast @ self.covariance @ contrast))
        return deviation * float(t.ppf(0.5 + CONFIDENCE / 2, freedom))


def fit_kinematics(recordings: Sequence[DriveRecording], each_wheel: bool) -> KinematicFit:
    """Return the kinematics that fit drives best, with one radius or one of each wheel, and the markers' place.

    Raises InputError where poses are known in too few windows.
    """
    from scipy.optimize import least_squares

    radius_m = recordings[0].machines.car(0).wheel_radius_m
    lever_m = recordings[0].lever_m
    periods = round(_FITTED_S / PERIOD_S)
    n_radii = 1
    if each_wheel:
        n_radii = len(WHEELS)
    angles = [recording.angles for recording in recordings]
    windows = [window_starts(recording.log.pose, periods) for recording in recordings]
    n_windows = sum(map(len, windows))
    if n_windows < _FEWEST_FITTED:
        raise InputError(
            f"{', '.join(recording.name for recording in recordings)}: poses are known in {n_windows} windows of "
            f"{_FITTED_S:g} s; allowed: {_FEWEST_FITTED} or more"
        )

    def split(figures: Floats) -> tuple[Kinematics, Mounting]:
        radii = np.broadcast_to(figures[:n_radii], len(WHEELS))
        return Kinematics(radii, float(figures[n_radii])), Mounting(
            *figures[n_radii + 1 :].tolist()
        )

    def errors(figures: Floats) -> Floats:
        kinematics, mounting = split(figures)
        off: list[Floats] = []
        for recording, turned, starts in zip(recordings, angles, windows, strict=True):
            measured = travelled(robot_poses(recording, mounting), starts, periods)
            off.append(travelled(kinematics.poses(turned), starts, periods) - measured)
        return (np.concatenate(off) * [1.0, 1.0, lever_m]).ravel()

    start = np.array([*[radius_m] * n_radii, lever_m, 0.0, 0.0, 0.0])
    scale = np.array([*[radius_m] * n_radii, lever_m, 0.1, 0.1, 0.1])
    best = least_squares(errors, start, loss="soft_l1", f_scale=_COMMON_ERROR_M, x_scale=scale)
    # The Jacobian is scaled so that its square is the Hessian of the robust cost: with z the squares of the errors in
    # terms of the common one, by (1 + z)^(-3/4).
    weights = best.fun * (1 + (best.fun / _COMMON_ERROR_M) ** 2) ** 0.25
    pulls = (best.jac * weights[:, None]).reshape(n_windows, -1, len(start)).sum(axis=1)
    inverse = np.linalg.pinv(best.jac.T @ best.jac)
    share = n_windows / max(1, n_windows - len(start))
    covariance = inverse @ (pulls.T @ pulls * share) @ inverse
    return KinematicFit(*split(best.x), covariance, n_radii, n_windows)


def _twists(displacements: Floats) -> Floats:
    """Return the constant motions (k, 3) forward, to the left and about the middle that go such ways."""
    half = displacements[:, 2] / 2
    # x cot(x), which is 1 without a turn.
    share = np.where(np.abs(half) > 1e-6, half / np.tan(np.where(half == 0, 1.0, half)), 1.0)
    forward = share * displacements[:, 0] + half * displacements[:, 1]
    sideways = share * displacements[:, 1] - half * displacements[:, 0]
    return np.column_stack([forward, sideways, displacements[:, 2]])


def effective_figures(
    recording: DriveRecording, mounting: Mounting, rng: np.random.Generator
) -> dict[str, Any]:
    """Return the effective radii of a drive, and how it leaves its course.

    The motion in windows of half a second is regressed on what the wheels' angles say of going forward, to the left and
    turning. The radius forward is that of a wheel; that of turning is radius over lever. Drift is what a way forward or
    to the left adds to the heading and across the way. None is what the drive does not show.
    """
    periods = round(_REGRESSED_S / PERIOD_S)
    starts = window_starts(recording.log.pose, periods)
    motion = _twists(travelled(robot_poses(recording, mounting), starts, periods))
    turned = recording.angles[starts + periods] - recording.angles[starts]
    moving = np.abs(turned).mean(axis=1) > _LEAST_MOTION_RAD
    motion = motion[moving]
    causes = np.column_stack([turned @ _FORWARD, turned @ _LEFT, turned @ _TURN])[moving]
    names = ("forward_m", "sideways_m", "turning")
    drifts = ("turn_forward", "turn_sideways", "sideways_forward", "forward_sideways")
    nothing = Estimate(None, None, None)
    figures: dict[str, Any] = {"windows": len(motion)}
    for name in (*names, "sideways_over_forward", *drifts):
        figures[name] = nothing
    if len(motion) < _FEWEST_WINDOWS:
        return figures
    excited = np.linalg.norm(causes, axis=0) > _LEAST_MOTION_RAD * np.sqrt(len(causes))
    if not excited.any():
        return figures
    causes = causes[:, excited]
    inliers = np.full(len(motion), True)
    for _ in range(_TRIMS):
        matrix = np.linalg.lstsq(causes[inliers], motion[inliers], rcond=None)[0]
        residuals = motion - causes @ matrix
        spread = 1.4826 * np.median(np.abs(residuals[inliers]), axis=0)
        inliers = (np.abs(residuals) < _OUTLIER * spread + 1e-9).all(axis=1)
    motion = motion[inliers]
    causes = causes[inliers]
    samples = draws(len(motion), rng)
    sampled_causes = causes[samples]
    products = np.swapaxes(sampled_causes, 1, 2)
    matrices = np.full((len(samples) + 1, 3, 3), np.nan)
    fitted = np.linalg.lstsq(causes, motion, rcond=None)[0]
    inverses = np.linalg.pinv(products @ sampled_causes)
    resampled = inverses @ (products @ motion[samples])
    matrices[:, excited] = np.concatenate([fitted[None], resampled])

    def estimate(values: Floats) -> Estimate:
        if not np.isfinite(values[0]):
            return nothing
        return interval_of(values[0], values[1:])

    figures["windows"] = len(motion)
    for column, name in enumerate(names):
        figures[name] = estimate(matrices[:, column, column])
    forward = matrices[:, 0, 0]
    sideways = matrices[:, 1, 1]
    figures["sideways_over_forward"] = estimate(sideways / forward)
    figures["turn_forward"] = estimate(matrices[:, 0, 2] / forward)
    figures["turn_sideways"] = estimate(matrices[:, 1, 2] / sideways)
    figures["sideways_forward"] = estimate(matrices[:, 0, 1] / forward)
    figures["forward_sideways"] = estimate(matrices[:, 1, 0] / sideways)
    for column, name in enumerate(names):
        if not _is_shown(figures[name]):
            figures[name] = nothing
            for drift in drifts:
                if drift.endswith(("_forward", "_sideways")[column : column + 1]):
                    figures[drift] = nothing
    if figures["forward_m"].value is None or figures["sideways_m"].value is None:
        figures["sideways_over_forward"] = nothing
    return figures


def _is_shown(estimate: Estimate) -> bool:
    if estimate.value is None or estimate.low is None or estimate.high is None:
        return estimate.value is not None
    return (estimate.high - estimate.low) / 2 < _SURE * abs(estimate.value)


def window_errors(
    recordings: Sequence[DriveRecording],
    predictions: Sequence[Floats],
    mounting: Mounting,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """Return the errors of predicted poses by length of window, and of the longest per metre and per turn."""
    figures: dict[str, Any] = {}
    for seconds in WINDOWS_S:
        periods = round(seconds / PERIOD_S)
        off = []
        lengths = []
        turns = []
        for recording, predicted in zip(recordings, predictions, strict=True):
            starts = window_starts(recording.log.pose, periods)
            measured = travelled(robot_poses(recording, mounting), starts, periods)
            off.append(travelled(predicted, starts, periods) - measured)
            length, turn = _lengths(predicted)
            lengths.append(length[starts + periods] - length[starts])
            turns.append(turn[starts + periods] - turn[starts])
        errors = np.concatenate(off)
        if not len(errors):
            figures[f"{seconds:g}_s"] = {"windows": 0}
            continue
        way_m = np.concatenate(lengths)
        turned = np.concatenate(turns)
        position_mm = 1e3 * np.hypot(errors[:, 0], errors[:, 1])
        heading_mrad = 1e3 * np.abs(errors[:, 2])
        figures[f"{seconds:g}_s"] = {
            "windows": len(errors),
            "position_mm": estimate_of(position_mm, rng, np.median),
            "position_mm_90": float(np.quantile(position_mm, 0.9)),
            "heading_mrad": estimate_of(heading_mrad, rng, np.median),
            "heading_mrad_90": float(np.quantile(heading_mrad, 0.9)),
            "position_share": _ratio(position_mm / 1e3, way_m, rng),
            "heading_share": _ratio(heading_mrad / 1e3, turned, rng),
        }
    return figures


def _lengths(poses: Floats) -> tuple[Floats, Floats]:
    """Return the length of the way in metres, and the sum of all turns in radians, up to each row."""
    steps = np.diff(poses, axis=0)
    length = np.append(0.0, np.cumsum(np.hypot(steps[:, 0], steps[:, 1])))
    return length, np.append(0.0, np.cumsum(np.abs(steps[:, 2])))


def _ratio(errors: Floats, amounts: Floats, rng: np.random.Generator) -> Estimate:
    """Return the median of errors over the amounts of motion in which they arose, where there was motion."""
    moving = amounts > max(_LEAST_MOTION_RAD, 0.2 * float(amounts.max(initial=0.0)))
    return estimate_of(errors[moving] / amounts[moving], rng, np.median)


def identify_robot(
    recordings: Sequence[DriveRecording], tell: Callable[[str, int], None]
) -> Identification:
    """Fit the simulated robot, on the drive ``wheels``, to drives of the real one."""
    unknowns = [unknown for unknown in UNKNOWNS if unknown.key in IDENTIFIED]
    log = joined_log([recording.log for recording in recordings], SEGMENT_S)
    machines = on_drive(recordings[0].machines, "wheels")
    predictor = Predictor(log, machines)
    return Identification(predictor, machines, unknowns, tell)


def simulated_poses(recording: DriveRecording, machines: Machines) -> Floats:
    """Return the poses (n, 3) of a simulated robot whose wheels turn as the real one's did."""
    return Predictor(recording.log, machines).poses(machines)


def _simulated(recording: DriveRecording, machines: Machines) -> DriveRecording:
    """Return a recording with the poses of a simulated robot in place of the measured ones, where there are any."""
    poses = simulated_poses(recording, machines)
    poses[~np.isfinite(recording.log.pose).all(axis=1)] = np.nan
    return replace(recording, log=replace(recording.log, pose=poses))


def halves(recording: DriveRecording) -> tuple[DriveRecording, DriveRecording]:
    """Return the two halves of a drive. Raises InputError for one that is too short."""
    log = recording.log
    middle_s = log.duration_s / 2
    if middle_s < _SHORTEST_HALF_S:
        raise InputError(
            f"{recording.name}: {log.duration_s:.3g} s long; allowed for a single drive: at least "
            f"{2 * _SHORTEST_HALF_S:g} s, "
            "of which one half is fitted to and the other tested on"
        )
    half_logs = (log.between(0.0, middle_s), log.between(middle_s, log.duration_s + PERIOD_S))
    first, second = (
        DriveRecording(f"{recording.name}, {words} half", half_log, recording.machines)
        for words, half_log in zip(("first", "second"), half_logs, strict=True)
    )
    return first, second


def evaluate_drives(
    recordings: Sequence[DriveRecording], seed: int, tell: Callable[[str, int], None]
) -> dict[str, Any]:
    """Return what drives of a robot say of the simulated drives.

    Figures are fitted to the first, third and each further second drive, or to the first half of a single one, and all
    models are tested on the others.
    """
    rng = np.random.default_rng(seed)
    declared = recordings[0].machines
    for recording in recordings[1:]:
        if recording.machines.digest != declared.digest:
            raise InputError(
                f"{recording.name}: of another robot than {recordings[0].name}: its radius, track or wheelbase differ; "
                "allowed: drives of one robot"
            )
    if len(recordings) == 1:
        recordings = halves(recordings[0])
    fitted_to = recordings[::2]
    tested_on = recordings[1::2]
    car = declared.car(0)
    nominal = Kinematics(np.full(len(WHEELS), car.wheel_radius_m), car.turn_radius_m)
    common = fit_kinematics(fitted_to, each_wheel=False)
    four = fit_kinematics(fitted_to, each_wheel=True)
    four_of_tested = fit_kinematics(tested_on, each_wheel=True)
    identification = identify_robot(fitted_to, tell)
    values = identification.values
    mounted = Mounting(
        values["mounting.heading_bias_rad"],
        values["mounting.marker_x_m"],
        values["mounting.marker_y_m"],
    )
    rows = []
    for name, kinematics, place in (
        ("ideal kinematics, nominal", nominal, common.mounting),
        ("ideal kinematics, radius and lever fitted", common.kinematics, common.mounting),
        ("ideal kinematics, four radii and lever fitted", four.kinematics, four.mounting),
    ):
        predictions = [kinematics.poses(recording.angles) for recording in tested_on]
        rows.append({"model": name, "windows": window_errors(tested_on, predictions, place, rng)})
    for state, machines, place in (
        ("nominal", declared, common.mounting),
        ("identified", identification.machines, mounted),
    ):
        for drive in DRIVES:
            tell(f"{drive}, {state}", identification.predictions)
            of_drive = on_drive(machines, drive)
            predictions = [simulated_poses(recording, of_drive) for recording in tested_on]
            errors = window_errors(tested_on, predictions, place, rng)
            rows.append({"model": f"{drive}, {state}", "windows": errors})
    effective: dict[str, list[dict[str, Any]]] = {"recording": []}
    for recording in recordings:
        figures = effective_figures(recording, common.mounting, rng)
        effective["recording"].append({"drive": recording.name, **figures})
    for drive in DRIVES:
        machines = on_drive(identification.machines, drive)
        effective[drive] = []
        for recording in recordings:
            tell(f"{drive}, {recording.name}", identification.predictions)
            figures = effective_figures(_simulated(recording, machines), Mounting(), rng)
            effective[drive].append({"drive": recording.name, **figures})
    return {
        "fitted_to": [recording.name for recording in fitted_to],
        "tested_on": [recording.name for recording in tested_on],
        "nominal": {"radius_m": car.wheel_radius_m, "lever_m": car.turn_radius_m},
        "kinematics": _fitted_figures(common),
        "each_wheel": _fitted_figures(four),
        "identified": _identified(identification),
        "models": rows,
        "effective": effective,
        "differences": _differences(effective["recording"], nominal, (four, four_of_tested)),
    }


def _fitted_figures(fit: KinematicFit) -> dict[str, Any]:
    """Return what was fitted, each with half its interval."""
    names = [f"radius_{wheel.removeprefix('wheel_')}_m" for wheel in WHEELS]
    if fit.n_radii == 1:
        names = ["radius_m"]
    values = [*fit.kinematics.radii_m[: fit.n_radii], fit.kinematics.lever_m, *fit.mounting]
    figures = {}
    names += ["lever_m", *Mounting._fields]
    for name, value, contrast in zip(names, values, np.eye(len(values)), strict=True):
        figures[name] = {"value": value, "half_width_95": fit.half_width(contrast)}
    return figures


def _identified(identification: Identification) -> dict[str, Any]:
    estimates = {}
    for estimate in identification.estimates:
        estimates[estimate.unknown.key] = {
            "words": estimate.unknown.words,
            "nominal": estimate.start,
            "value": estimate.value,
            "half_width_95": estimate.half_width,
            "identified": estimate.identified,
            "range": estimate.range,
        }
    return {
        "estimates": estimates,
        "misfit": identification.misfit,
        "fits": identification.fits,
        "segments": identification.n_segments,
        "outliers": identification.outliers,
    }


def _differences(
    effective: Sequence[dict[str, Any]], nominal: Kinematics, fits: Sequence[KinematicFit]
) -> list[str]:
    """Return in words what differs from the nominal robot, interval and all, in all drives that show it.

    ``fits`` are of a radius of each wheel, to the drives that were fitted to and to the others.
    """
    radius_m = float(nominal.radii_m[0])
    expected = {
        "forward_m": ("effective radius forward", radius_m),
        "sideways_m": ("effective radius sideways", radius_m),
        "turning": ("turn a wheel's turn", radius_m / nominal.lever_m),
    }
    differences = []
    for key, (words, value) in expected.items():
        shares = []
        for row in effective:
            estimate = row[key]
            if estimate.value is not None:
                shares.append(_beyond(estimate, value, RADIUS_SHARE * value) / value)
        if shares and all(shares) and min(shares) * max(shares) > 0:
            text = f"{words}: {_percent(min(shares))} to {_percent(max(shares))} of nominal"
            differences.append(text)
    for key, words in _DRIFTS.items():
        amounts = []
        for row in effective:
            estimate = row[key]
            if estimate.value is not None:
                amounts.append(_beyond(estimate, 0.0, DRIFT))
        if amounts and all(amounts) and min(amounts) * max(amounts) > 0:
            differences.append(
                f"{words}: {1e3 * min(amounts):+.1f} to {1e3 * max(amounts):+.1f} a metre"
            )
    for number, wheel in enumerate(WHEELS):
        contrast = np.zeros(2 * len(WHEELS))
        contrast[: len(WHEELS)] = -1 / (len(WHEELS) - 1)
        contrast[number] = 1.0
        shares = []
        for fit in fits:
            share = float(contrast[: len(WHEELS)] @ fit.kinematics.radii_m) / radius_m
            if abs(share) - fit.half_width(contrast) / radius_m > RADIUS_SHARE:
                shares.append(share)
        if len(shares) == len(fits) and min(shares) * max(shares) > 0:
            differences.append(
                f"radius of {wheel}: {_percent(min(shares))} to {_percent(max(shares))} beside the other wheels"
            )
    return differences


_DRIFTS: Final = {
    "turn_forward": "turn on a way forward, mrad",
    "turn_sideways": "turn on a way sideways, mrad",
    "sideways_forward": "way sideways on a way forward, mm",
    "forward_sideways": "way forward on a way sideways, mm",
}


def _percent(share: float) -> str:
    return f"{100 * share:+.1f} %"


def _beyond(estimate: Estimate, value: float, tolerance: float) -> float:
    """Return the difference from a value where all of the interval is further from it than a tolerance, or else 0."""
    assert estimate.value is not None
    low = estimate.value if estimate.low is None else estimate.low
    high = estimate.value if estimate.high is None else estimate.high
    if high < value - tolerance or low > value + tolerance:
        return estimate.value - value
    return 0.0
