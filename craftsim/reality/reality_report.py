"""The report of recordings of real motion beside simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from craftsim.experiments.intervals import Estimate
from craftsim.reality.contact_law import evaluate_tosses
from craftsim.reality.driving import DRIFT, RADIUS_SHARE, WINDOWS_S, evaluate_drives
from craftsim.reality.recordings import DriveRecording, Tosses, about
from craftsim.reports.json_file import document
from craftsim.reports.plots import interval_rows, rows_height_in
from craftsim.reports.report import (
    Block,
    Column,
    DataTable,
    Drawing,
    Headline,
    KeyFigure,
    Report,
    Section,
    Tone,
    count,
    numbers,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes

REALITY_COMMAND: Final = "reality"


def compare_recordings(
    recordings: Sequence[Tosses | DriveRecording], seed: int, tell: Callable[[str, int], None]
) -> dict[str, Any]:
    """Return what a report holds of recordings; raises InputError for ones of which too little is known.

    ``tell`` is called with what is done now, and with the number of simulations so far.
    """
    laws = []
    for recording in recordings:
        if isinstance(recording, Tosses):
            laws.append({"file": recording.name, **evaluate_tosses(recording, seed, tell)})
    drives = [recording for recording in recordings if isinstance(recording, DriveRecording)]
    driving = None
    if drives:
        driving = evaluate_drives(drives, seed, tell)
    return {
        "recordings": [about(recording) for recording in recordings],
        "contact_law": laws,
        "driving": driving,
        "differences": _differences(laws, driving),
    }


def _differences(laws: Sequence[Mapping[str, Any]], driving: Mapping[str, Any] | None) -> list[str]:
    """Return in words where what was fitted is not what was declared."""
    differences = []
    for law in laws:
        friction = law["friction"]
        if friction["differs"]:
            differences.append(
                f"{law['file']}: friction {_number(friction['fitted'], 3)}, declared {friction['declared']:g}"
            )
    if driving is not None:
        differences += driving["differences"]
    return differences


def reality_report(
    figures: Mapping[str, Any], seed: int, config: Mapping[str, Any], wall_s: float
) -> Report:
    """Return the report of what :func:`compare_recordings` has found."""
    differences = figures["differences"]
    n = len(figures["recordings"])
    headline = Headline(
        "As declared",
        Tone.GOOD,
        f"Nothing in {count(n, 'recording')} differs from what is declared.",
    )
    if differences:
        headline = Headline("Differs", Tone.CAUTION, f"Not as declared: {'; '.join(differences)}.")
    sections = []
    key_figures = []
    for law in figures["contact_law"]:
        sections.append(_law_section(law))
        measured = law["laws"][1]
        key_figures.append(
            KeyFigure(
                f"{measured['position_widths'].value:.3f}",
                "widths of the cube, mean position error of a toss",
                law["file"],
            )
        )
    if figures["driving"] is not None:
        sections += _driving_sections(figures["driving"])
    return Report(
        "Reality",
        count(n, "recording"),
        headline,
        key_figures,
        sections,
        document=document(
            figures, command=REALITY_COMMAND, seed=seed, config=config, wall={"total_s": wall_s}
        ),
        exit_code=1 if differences else 0,
    )


def _number(estimate: Estimate, digits: int, factor: float = 1.0) -> str | None:
    """Return a value with its interval as text; None without a value."""
    if estimate.value is None:
        return None
    text = f"{factor * estimate.value:.{digits}f}"
    if estimate.low is None or estimate.high is None:
        return text
    return f"{text} ({factor * estimate.low:.{digits}f} to {factor * estimate.high:.{digits}f})"


def _law_section(law: Mapping[str, Any]) -> Section:
    columns = numbers(
        "law", "position, widths", "rotation, degrees", "more than with the measured friction"
    )
    rows = []
    for row in law["laws"]:
        rows.append(
            (
                row["law"],
                _number(row["position_widths"], 3),
                _number(row["rotation_deg"], 1),
                _number(row["more_than_measured"], 3),
            )
        )
    fitted = []
    for name, estimate in law["fitted"].items():
        fitted.append((name, _number(estimate, 4)))
    readings = []
    for row in law["checks"]:
        readings.append(
            (row["reading"], _number(row["position_widths"], 3), _number(row["rotation_deg"], 1))
        )
    lead = (
        f"Each toss is simulated from its first state. Errors are means along a toss, then over {law['tested_on']} "
        f"tosses; the fitted law is of {law['fitted_to']} others. Intervals of 95 % by bootstrap over tosses."
    )
    values = {}
    for row in law["laws"]:
        estimate = row["position_widths"]
        values[row["law"]] = (
            estimate.value,
            estimate.low or estimate.value,
            estimate.high or estimate.value,
        )

    def draw(axes: Axes) -> None:
        interval_rows(axes, values)
        axes.set_xlabel("mean position error of a toss (widths of the cube)")

    blocks: list[Block] = [
        DataTable(columns, rows, "Laws"),
        Drawing.of_axes(draw, rows_height_in(len(values)), "Position errors by law.", "errors"),
        DataTable(numbers("parameter", "fitted"), fitted, "Fitted law"),
        DataTable(
            numbers("reading", "position, widths", "rotation, degrees"),
            readings,
            "Other readings of the recording, with the measured friction",
        ),
    ]
    return Section("contact-law", f"Contact law: {law['file']}", lead, blocks, terminal=True)


def _driving_sections(driving: Mapping[str, Any]) -> list[Section]:
    windows = [f"{seconds:g}_s" for seconds in WINDOWS_S]
    names = []
    for seconds in WINDOWS_S:
        names += [f"{seconds:g} s, mm", f"{seconds:g} s, mrad"]
    rows: list[tuple[str | None, ...]] = []
    drifts: list[tuple[str | None, ...]] = []
    for row in driving["models"]:
        cells: list[str | None] = [row["model"]]
        for window in windows:
            figures = row["windows"][window]
            if figures["windows"]:
                cells += [_number(figures["position_mm"], 1), _number(figures["heading_mrad"], 1)]
            else:
                cells += [None, None]
        rows.append(tuple(cells))
        longest = row["windows"][windows[1]]
        if longest["windows"]:
            drifts.append(
                (
                    row["model"],
                    _number(longest["position_share"], 1, 1e3),
                    _number(longest["heading_share"], 1, 360.0),
                )
            )
    tested = ", ".join(driving["tested_on"])
    lead = (
        f"Fitted to {', '.join(driving['fitted_to'])}; ways in windows of {tested}, in the robot's frame as a window "
        "begins. Medians with 95 % intervals by bootstrap over windows."
    )
    tables: list[Block] = [
        DataTable(numbers("model", *names), rows, "Errors of predicted ways"),
        DataTable(
            numbers("model", "mm per metre", "degrees per turn"),
            drifts,
            f"Drift in windows of {WINDOWS_S[1]:g} s",
        ),
    ]
    return [
        Section("driving", "Drives", lead, tables, terminal=True),
        _effective_section(driving),
        _identified_section(driving),
    ]


def _effective_section(driving: Mapping[str, Any]) -> Section:
    rows = []
    for name, figures in driving["effective"].items():
        for row in figures:
            rows.append(
                (
                    f"{row['drive']}, {name}",
                    _number(row["forward_m"], 2, 1e3),
                    _number(row["sideways_m"], 2, 1e3),
                    _number(row["sideways_over_forward"], 3),
                    _number(row["turning"], 4),
                    _number(row["turn_forward"], 1, 1e3),
                    _number(row["sideways_forward"], 1, 1e3),
                )
            )
    columns = (
        Column("drive"),
        Column("forward, mm", "number"),
        Column("sideways, mm", "number"),
        Column("sideways over forward", "number"),
        Column("turning", "number", "Radius over lever."),
        Column("turn on a way forward, mrad/m", "number"),
        Column("sideways on a way forward, mm/m", "number"),
    )
    nominal = driving["nominal"]
    lead = (
        f"What the way and the turn of a robot are over the angles of its wheels. Nominal: "
        f"{1e3 * nominal['radius_m']:.1f} mm, turning {nominal['radius_m'] / nominal['lever_m']:.4f}. A difference "
        f"counts beyond {100 * RADIUS_SHARE:g} % and {1e3 * DRIFT:g} mrad or mm a metre, interval and all, in every "
        "drive."
    )
    table = DataTable(columns, rows, "Effective radii and drift")
    return Section("effective", "Effective radii", lead, [table], terminal=True)


def _identified_section(driving: Mapping[str, Any]) -> Section:
    rows = []
    for estimate in driving["identified"]["estimates"].values():
        interval: str | None = None
        if estimate["range"] is not None:
            low, high = estimate["range"]
            interval = f"{low:.3g} to {high:.3g} fit as well"
        elif estimate["half_width_95"] is not None:
            interval = f"+- {estimate['half_width_95']:.2g}"
        rows.append(
            (
                estimate["words"],
                f"{estimate['nominal']:.4g}",
                f"{estimate['value']:.4g}",
                interval,
            )
        )
    ideal = []
    for key, words in (("kinematics", "one radius"), ("each_wheel", "four radii")):
        for name, fitted in driving[key].items():
            ideal.append(
                (words, name, f"{fitted['value']:.4f}", f"+- {fitted['half_width_95']:.4f}")
            )
    columns = numbers("figure", "nominal", "fitted", "95 % interval")
    tables = [
        DataTable(columns, rows, "Simulated robot"),
        DataTable(
            (Column("ideal kinematics"), *numbers("figure", "fitted", "95 % interval")),
            ideal,
            "Ideal kinematics",
        ),
    ]
    misfit = driving["identified"]["misfit"]
    texts = []
    for name, ratio in misfit.items():
        texts.append(f"{name} {ratio:.1f} times the noise")
    lead = (
        "Identified on the drive wheels, in segments of two seconds. What the model leaves of the measurements: "
        f"{', '.join(texts)}."
    )
    return Section("identified", "Fitted figures", lead, tables, terminal=True)
