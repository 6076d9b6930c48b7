"""What decides a report's page; :func:`craftsim.validation.html.writing.write_html` sets it by its template.

All text is plain text: it is escaped when it is set, wherever it comes from.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from craftsim.report import plain, versions


class Tone(StrEnum):
    """What a colour says."""

    PLAIN = "plain"
    GOOD = "good"
    CAUTION = "caution"
    BAD = "bad"
    MUTED = "muted"


@dataclass(frozen=True)
class Case:
    """A disagreement, to be watched and replayed."""

    title: str
    result: str
    tone: Tone
    reason: str
    differences: tuple[str, ...] = ()
    bundle: str = ""
    """Folder relative to the page, empty when there is none."""


@dataclass(frozen=True)
class KeyFigure:
    """One of the few figures that stand at the top."""

    value: str
    label: str
    note: str = ""


@dataclass(frozen=True)
class Headline:
    """The verdict: a word or two on a coloured ground, and one sentence."""

    badge: str
    tone: Tone
    sentence: str


@dataclass(frozen=True)
class Page:
    """A whole report."""

    template: str
    """Name of the template of its sections."""
    title: str
    subtitle: str
    headline: Headline
    key_figures: tuple[KeyFigure, ...]
    content: Mapping[str, Any]
    """What its template shows."""


def percent(share: float | None) -> str:
    """Return a share as percents, 100 % only if it is all."""
    if share is None:
        return "none"
    digits = 0 if share in (0.0, 1.0) else 1
    text = f"{100 * share:.{digits}f}"
    return f"{'> 99.9' if text == '100.0' else '< 0.1' if text == '0.0' else text} %"


def interval(low: float, high: float) -> str:
    """Return an interval of shares as percents."""
    return f"{100 * low:.1f} to {100 * high:.1f} %"


def count(number: int, thing: str) -> str:
    """Return a number with its thing, in the plural where it needs one."""
    return f"{number:,} {thing}{'' if number == 1 else 's'}"


def provenance(command: str, seed: int, config: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Return what decides the figures of a run, each by its dotted name: thresholds, configuration, and versions.

    Args:
        command: as it can be typed again.
        seed: of the run.
        config: of the run, the ``setup`` of the physics included.
    """
    setup = config["setup"]
    brief = {key: value for key, value in config.items() if key != "setup"}
    run = {"command": command, "seed": seed, **brief, "gains": setup.gains, "machines": setup.machines}
    described = {"thresholds": setup.thresholds, "run": run, "versions": versions()}
    return {name: dict(_flat(plain(values))) for name, values in described.items()}


def _flat(value: Any, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the leaves of nested mappings with their dotted names."""
    if isinstance(value, Mapping) and value:
        for key, item in value.items():
            yield from _flat(item, f"{prefix}.{key}" if prefix else str(key))
    elif isinstance(value, list) and value and isinstance(value[0], Mapping):
        for number, item in enumerate(value):
            yield from _flat(item, f"{prefix}.{number}")
    elif isinstance(value, list):
        yield prefix, ", ".join("none" if item is None else str(item) for item in value) or "none"
    else:
        yield prefix, "none" if value is None or value == {} else str(value)
