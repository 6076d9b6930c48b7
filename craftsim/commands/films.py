"""Films of replay bundles and of whole runs, where they can be made."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Final

from rich.console import Console

from craftsim.checking.episode import Watch
from craftsim.commands.progress import counting
from craftsim.discrete.actions import Action
from craftsim.discrete.rules.table import ACTIONS
from craftsim.models.site import Site
from craftsim.rendering.backend import RenderingUnavailable, choose_backend
from craftsim.rendering.clip import clip
from craftsim.rendering.episode_film import EpisodeFilm
from craftsim.report import output_directory
from craftsim.skills.executor import Observer
from craftsim.validation.campaign import Item, TrialRecord
from craftsim.validation.replays.bundle import FILM, Recorded, read_bundle
from craftsim.validation.replays.replay import Replay, replay
from craftsim.validation.runs.run import run_episode

FILMS: Final = "films"
_SPEED: Final = 4.0
_LINE: Final = 66
"""Characters that fit into a line of a clip's caption."""


def rendering_works(console: Console) -> bool:
    """Return whether films can be made here; say why not."""
    try:
        choose_backend()
    except RenderingUnavailable as error:
        console.print(f"No film: {error}", style="yellow", soft_wrap=True, markup=False)
        return False
    return True


def film_bundle(recorded: Recorded, path: Path) -> Replay:
    """Replay a bundle, film its last step, and return the replay; :func:`rendering_works` must have said yes."""
    bundle = recorded.bundle
    attempt = bundle.attempts[0]
    result = ", ".join(f"car {a.car} {ACTIONS[Action[a.action]].words}: {a.result}" for a in bundle.attempts)
    lines = [*textwrap.wrap(result, _LINE, max_lines=2), *textwrap.wrap(attempt.reason, _LINE, max_lines=2)]

    def watch(site: Site) -> AbstractContextManager[Observer]:
        return clip(path, site, attempt.car, bundle.end_s - bundle.start_s, lines)

    return replay(recorded, watch)


def film_failures(console: Console, out: Path, records: Iterable[TrialRecord]) -> None:
    """Film the bundles that have no film yet."""
    folders = (out / record["bundle"] for record in records if record["bundle"])
    missing = [folder for folder in folders if not (folder / FILM).exists()]
    with counting(console, "films", len(missing), bool) as tell:
        for folder in missing:
            film_bundle(read_bundle(folder), folder / FILM)
            tell(True)


def film_runs(console: Console, out: Path, items: Sequence[Item], records: Iterable[TrialRecord]) -> None:
    """Film runs from their start to their end, those that came to one and have no film yet."""
    folder = output_directory(out / FILMS)
    ended = (item for item, record in zip(items, records, strict=True) if record["error"] is None)
    paths = ((item, folder / f"{item.key.replace('/', '-')}.mp4") for item in ended)
    missing = [(item, path) for item, path in paths if not path.exists()]
    with counting(console, "films", len(missing), bool) as tell:
        for item, path in missing:
            with EpisodeFilm(path, item.key, size=(640, 360), speed=_SPEED) as film:
                run_episode(item.job, Watch(film.begin))
            tell(True)
