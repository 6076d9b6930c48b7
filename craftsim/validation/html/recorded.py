"""Figures of recorded runs within a page, while there is room."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from markupsafe import Markup

from craftsim.errors import InputError
from craftsim.experiments.bundle import TRAJECTORY
from craftsim.experiments.experiment import Item, TrialRecord
from craftsim.rendering.plots.figures import plots_of
from craftsim.rendering.plots.signals import Signals
from craftsim.rendering.plots.style import WIDTH_IN
from craftsim.rendering.trajectory import SUFFIX, TRAJECTORIES, Trajectory
from craftsim.validation.html.page import Case
from craftsim.validation.html.svg import canvas

MOST_RUNS: Final = 4
"""Runs that a page draws."""
BUDGET_BYTES: Final = 3_000_000
"""Of the drawings of all of them; the first run is drawn in any case."""
_MOST_POINTS: Final = 300
"""Of a line."""


@dataclass(frozen=True)
class RecordedRun:
    """A run whose trajectory should lie beside the page."""

    title: str
    file: str
    """Relative to the page."""
    agrees: bool
    """Whether physics did what the rules predict."""


@dataclass(frozen=True)
class DrawnRun:
    """What a page shows of a recorded run."""

    run: RecordedRun
    drawings: tuple[tuple[Markup, str], ...]
    """Each with its caption."""
    problem: str = ""
    """Why there are none."""


def recorded_runs(items: Sequence[Item], records: Sequence[TrialRecord]) -> list[RecordedRun]:
    """Return the runs that were recorded and came to an end, those first that disagree."""
    ended = [
        RecordedRun(item.key, f"{TRAJECTORIES}/{item.job.file_name}{SUFFIX}", record["agrees"])
        for item, record in zip(items, records, strict=False)
        if item.job.terms.record and record["error"] is None
    ]
    return sorted(ended, key=lambda run: run.agrees)


def recorded_cases(cases: Iterable[Case]) -> list[RecordedRun]:
    """Return what was recorded of disagreements, if it was."""
    return [RecordedRun(case.title, f"{case.bundle}/{TRAJECTORY}", False) for case in cases if case.bundle]


class Drawn:
    """The drawings of one page."""

    def __init__(self, out: Path, budget_bytes: int = BUDGET_BYTES) -> None:
        """Look for trajectories below ``out``, the page's folder."""
        self.out = out
        self.left_bytes = budget_bytes

    def there(self, runs: Sequence[RecordedRun]) -> list[RecordedRun]:
        """Return the runs that were recorded."""
        return [run for run in runs if (self.out / run.file).is_file()]

    def of(self, runs: Sequence[RecordedRun]) -> Iterator[DrawnRun]:
        """Yield the first runs as far as there is room."""
        for number, run in enumerate(runs[:MOST_RUNS]):
            found = _draw(run, self.out / run.file)
            size = sum(len(svg) for svg, _ in found.drawings)
            if number and size > self.left_bytes:
                return
            self.left_bytes -= size
            yield found


def _draw(run: RecordedRun, path: Path) -> DrawnRun:
    try:
        signals = Signals.of(Trajectory.read(path))
    except InputError as error:
        # A campaign that has come to its end gets its page, whatever became of a trajectory.
        return DrawnRun(run, (), f"No figures: {error}")
    drawings = []
    for plot in plots_of(signals, _MOST_POINTS):
        with canvas(WIDTH_IN, plot.height_in, f"{run.title}: {plot.caption}", dense=True) as drawing:
            plot.draw(drawing.figure)
        drawings.append((drawing.svg, plot.caption))
    return DrawnRun(run, tuple(drawings))
