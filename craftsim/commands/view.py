"""``craftsim view``: watch a recorded run, or one that runs, in the browser."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from craftsim.commands.options import PhysicsOptions
from craftsim.commands.text import say
from craftsim.errors import InputError
from craftsim.rendering.viewer.extra import LOOPBACK, PORT, need_viser
from craftsim.storage.limits import PORTS

if TYPE_CHECKING:
    from collections.abc import Callable

    from craftsim.rendering.trajectory import Trajectory
    from craftsim.rendering.viewer.live import LiveView
    from craftsim.validation.building import Building

    Runs = dict[str, Callable[[], Trajectory]]


def view(
    what: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="WHAT")],
    host: str = LOOPBACK,
    port: Annotated[int, PORTS] = PORT,
) -> int:
    """Watch a run in the browser: play, pause, go from action to action, and look at what each car does and feels.

    It says which address to open, and serves it until Ctrl-C. Exit status 0 then, and 2 for wrong input.

    Args:
        what: a trajectory, the folder of a run that was recorded, that of a replay bundle, or a task, whose plan is
            then carried out while one looks on.
        host: address to listen on. Only this machine reaches the usual one; there is no password.
        port: 0 takes one that is free.
    """
    need_viser()
    from craftsim.rendering.viewer.live import LiveView
    from craftsim.rendering.viewer.page import REAL_TIME
    from craftsim.rendering.viewer.recorded import RecordedView
    from craftsim.validation.building import read_building

    path = Path(what)
    building = None if path.exists() else read_building(what)
    runs = _runs(path) if building is None else {}
    with LiveView(host, port, REAL_TIME) as live:
        try:
            say(f"Watch at {live.address} (Ctrl-C ends it)")
            if building is not None:
                done = _carry_out(building, live)
                runs[building.name] = lambda: done
            shown = RecordedView(live.page, runs)
            if building is not None:
                live.page.ask(lambda: shown.seek(math.inf))  # where it has just ended
            shown.serve()
        except KeyboardInterrupt:
            return 0


def _runs(path: Path) -> Runs:
    """Return the recorded runs in a file or a folder, by name."""
    from craftsim.rendering.trajectory import SUFFIX, TRAJECTORIES, Trajectory
    from craftsim.validation.replays.bundle import TEXT, read_bundle
    from craftsim.validation.replays.trajectory import trajectory_of

    if not path.is_dir():
        return {path.stem: partial(Trajectory.read, path)}
    if (path / TEXT).exists():
        return {path.name: partial(trajectory_of, read_bundle(path))}
    folder = path / TRAJECTORIES if (path / TRAJECTORIES).is_dir() else path
    files = sorted(folder.glob(f"*{SUFFIX}"))
    if not files:
        raise InputError(
            f"{path}: neither trajectories nor a replay bundle; record a run, or give the folder of a bundle"
        )
    return {file.stem: partial(Trajectory.read, file) for file in files}


def _carry_out(building: Building, live: LiveView) -> Trajectory:
    """Carry out a plan while people look on, and return what happened."""
    from craftsim.checking.attempt import Attempt
    from craftsim.checking.checked_site import CheckedSite
    from craftsim.checking.episode import Watch
    from craftsim.rendering.recorder import Recorder
    from craftsim.validation.runs.run import Run, Terms, run_episode
    from craftsim.validation.runs.steps import steps_of

    recorder, attempts, task = Recorder(), list[Attempt](), building.task

    def begin(checked: CheckedSite) -> None:
        recorder.begin(checked)
        live.follow(checked, building.name, task.goal_cells, lambda: attempts)

    terms = Terms(0, PhysicsOptions(randomize="none").setup())
    run = Run(building.name, task, steps_of(building.plan.ticks, "ticks"), "", 0, terms)
    episode = run_episode(run, Watch(begin, attempts.extend))
    return recorder.trajectory(building.name, episode.recipe, episode.attempts, task.design)
