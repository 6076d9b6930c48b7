"""The films of ``craftsim validate``: clips of failures beside their bundles, and whole runs."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from rich.console import Console

from craftsim.checking.recipe import Act, Step, do, prepare
from craftsim.commands.filming import film_bundle
from craftsim.commands.progress import counting
from craftsim.models.site import Site
from craftsim.rendering.film import Film
from craftsim.report import output_directory
from craftsim.validation.campaign import Item, TrialRecord
from craftsim.validation.replays.bundle import FILM, read_bundle
from craftsim.validation.runs.run import Run, start_recipe

FILMS = "films"
_SPEED = 4.0


def film_failures(console: Console, out: Path, records: Sequence[TrialRecord]) -> None:
    """Film the bundles that have no film yet."""
    folders = [out / record["bundle"] for record in records if record["bundle"]]
    missing = [folder for folder in folders if not (folder / FILM).exists()]
    with counting(console, "films", len(missing)) as tell:
        for folder in missing:
            partial = folder / f".{FILM}"
            film_bundle(read_bundle(folder), partial)
            partial.replace(folder / FILM)
            tell(True)


def film_runs(console: Console, out: Path, items: Sequence[Item], records: Sequence[TrialRecord]) -> None:
    """Film runs from their start to their end, those that came to one and have no film yet."""
    folder = output_directory(out / FILMS)
    wanted = [
        (item, record, folder / f"{item.key.replace('/', '-')}.mp4")
        for item, record in zip(items, records, strict=True)
        if record["error"] is None
    ]
    missing = [one for one in wanted if not one[2].exists()]
    with counting(console, "films", len(missing)) as tell:
        for item, record, path in missing:
            _film_run(item, record, path)
            tell(True)


def _film_run(item: Item, record: TrialRecord, path: Path) -> None:
    checked = prepare(start_recipe(item.job))
    partial = path.with_name(f".{path.name}")
    words = ""
    with Film(partial, checked.site.model, "overview", size=(640, 360), speed=_SPEED) as film:

        def watch(site: Site) -> None:
            if film.due(site.time_s):
                film.capture(site.data, [record["key"], words])

        watch(checked.site)
        checked.executor.observers.append(watch)
        for step in _steps(item.job, record):
            words = ", ".join(f"car {act.car} {act.action.replace('_', ' ').lower()}" for act in step.acts)
            do(checked, step)
    partial.replace(path)


def _steps(run: Run, record: TrialRecord) -> list[Step]:
    """Return what was done in a run; what was forbidden did nothing."""
    if run.plan is not None:
        return list(run.plan[: record["extra"]["ticks"]])
    ticks = groupby(record["attempts"], lambda attempt: int(attempt["tick"]))
    return [Step(tick, tuple(Act(a["car"], a["action"]) for a in told), "concurrent") for tick, told in ticks]
