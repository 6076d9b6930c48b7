"""A run as HTML: its title, the state of a car at a moment, and the list of what was tried."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import Final

from craftsim.checking.attempt import Attempt
from craftsim.rendering.viewer.moment import CarMoment, Moment, Motor

LISTED: Final = 9
"""Actions in the list at one time."""
_GOOD, _BAD, _QUIET = "#2b8a3e", "#c92a2a", "#868e96"
_ROWS: Final = "<table style='width:100%;font-size:0.8em;border-spacing:0 0.15em'>"


def title_html(title: str) -> str:
    """Return what stands above all."""
    return _framed(f"<b>{escape(title)}</b>")


def car_html(moment: Moment, car: int) -> str:
    """Return what is known of a car."""
    state = moment.cars[car]
    x, y, z = state.pose
    rows = [
        ("time", f"{moment.time_s:.2f} s"),
        ("action", escape(state.action) or "waits"),
        ("pose", f"{x:z.3f}, {y:z.3f}, {z:z.3f} m"),
    ]
    if state.measured is not None:
        x, y, heading = state.measured
        rows.append(("measured", f"{x:z.3f}, {y:z.3f} m, {math.degrees(heading):z.1f}°"))
    *wheels, board = state.motors
    rows.append(("wheels (Nm)", "".join(_bar(motor, motor.name[-2:]) for motor in wheels)))
    rows.append(("board (N)", _bar(board, "")))
    if not math.isnan(moment.contact_n):
        rows.append(("largest contact", f"{moment.contact_n:.0f} N, of all machines"))
    cells = "".join(f"<tr><td style='color:{_QUIET}'>{name}</td><td>{text}</td></tr>" for name, text in rows)
    return _framed(f"{_ROWS}{cells}</table>{_verdict(state)}")


def list_html(attempts: Sequence[Attempt], time_s: float) -> str:
    """Return the actions around a moment: when each began, of which car, and the verdict on it."""
    if not attempts:
        return _framed(f"<span style='color:{_QUIET}'>no actions yet</span>")
    ordered = sorted(attempts, key=lambda one: (one.start_s, one.car))
    begun = sum(one.start_s <= time_s + 1e-6 for one in ordered)
    first = max(0, min(begun - LISTED // 2 - 1, len(ordered) - LISTED))
    rows = []
    for number, one in enumerate(ordered[first : first + LISTED], first):
        runs = one.start_s <= time_s < one.start_s + one.duration_s
        style = "font-weight:600;background:#e7f5ff" if runs else f"color:{_QUIET}" if number >= begun else ""
        texts = (f"{one.start_s:.1f} s", f"car {one.car}", escape(one.action), _mark(one))
        rows.append(f"<tr style='{style}'>{''.join(f'<td>{text}</td>' for text in texts)}</tr>")
    return _framed(f"{_ROWS}{''.join(rows)}</table>")


def _verdict(state: CarMoment) -> str:
    attempt = state.attempt
    if attempt is None:
        return ""
    which = "" if attempt.action == state.action else f"last: {escape(attempt.action)}, "
    reason = f"<br>{escape(attempt.reason)}" if attempt.reason else ""
    return f"<div style='font-size:0.85em;margin-top:0.3em'>{which}{_mark(attempt)}{reason}</div>"


def _mark(attempt: Attempt) -> str:
    return f"<span style='color:{_GOOD if attempt.agrees else _BAD}'>{escape(attempt.result)}</span>"


def _bar(motor: Motor, name: str) -> str:
    """Return what a motor gives, over a bar that is full at its limit."""
    share = min(1.0, abs(motor.force) / motor.limit) if motor.limit else 0.0
    bar = f"<span style='display:block;width:{100 * share:.0f}%;height:0.3em;background:#4dabf7'></span>"
    style = "display:inline-block;width:24%;margin-right:1%;font-size:0.9em"
    return f"<span style='{style}' title='of {motor.limit:g}'>{name} {motor.force:z.2f}{bar}</span>"


def _framed(content: str) -> str:
    return f"<div style='padding:0 0.75em'>{content}</div>"
