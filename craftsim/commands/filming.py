"""Whether films can be made here, and the clip of a replay bundle."""

from __future__ import annotations

import sys
import textwrap
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Final

from rich.console import Console

from craftsim.rendering.backend import RenderingUnavailable, choose_backend

if TYPE_CHECKING:
    from craftsim.models.site import Site
    from craftsim.skills.executor import Observer
    from craftsim.validation.replays.bundle import Recorded
    from craftsim.validation.replays.replay import Replay

_LINE: Final = 66
"""Characters that fit into a line of a clip's caption."""


def rendering_works(console: Console) -> bool:
    """Choose a rendering backend, before anything imports MuJoCo; say why where there is none."""
    if "mujoco" in sys.modules:
        return True
    try:
        choose_backend()
    except RenderingUnavailable as error:
        console.print(f"No film: {error}", style="yellow", soft_wrap=True, markup=False)
        return False
    return True


def film_bundle(recorded: Recorded, path: Path) -> Replay:
    """Replay a bundle, film its last step, and return what came of it; :func:`rendering_works` must have said yes."""
    from craftsim.rendering.clip import clip
    from craftsim.validation.replays.replay import replay

    bundle = recorded.bundle
    attempt = bundle.attempts[0]
    told = ", ".join(f"car {a.car} {a.action.replace('_', ' ').lower()}: {a.result}" for a in bundle.attempts)
    lines = [told, *textwrap.wrap(attempt.reason, _LINE, max_lines=2)]

    def watch(site: Site) -> AbstractContextManager[Observer]:
        return clip(path, site, attempt.car, bundle.end_s - bundle.start_s, lines)

    return replay(recorded, watch)
