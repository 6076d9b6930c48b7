"""``craftsim view``: watch a recorded run, or one that runs, in the browser."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from craftsim.cli.strangers import warn_of_strangers
from craftsim.cli.text import say
from craftsim.options import Physics, number
from craftsim.rendering.viewer import LOOPBACK, PORT, need_viser
from craftsim.storage.limits import PORTS
from craftsim.storage.paths import is_file, is_folder

if TYPE_CHECKING:
    from collections.abc import Callable

    from craftsim.rendering.trajectory import Trajectory
    from craftsim.rendering.viewer.live import LiveView
    from craftsim.validation.building import Building

    Runs = dict[str, Callable[[], Trajectory]]


def view(
    what: Annotated[str, Parameter(metavar="RUN|FILE|TASK")],
    *,
    host: Annotated[str, Parameter(metavar="ADDRESS")] = LOOPBACK,
    port: Annotated[int, number(PORTS)] = PORT,
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
    from craftsim.discrete.tasks import TASK_NAMES
    from craftsim.rendering.trajectory import SUFFIX
    from craftsim.rendering.viewer.live import LiveView
    from craftsim.rendering.viewer.page import REAL_TIME
    from craftsim.rendering.viewer.recorded import RecordedView
    from craftsim.validation.building import read_building

    path = Path(what)
    recorded = what not in TASK_NAMES and (is_folder(path) or path.suffix == SUFFIX)
    building = None if recorded else read_building(what)
    runs = _runs(path) if building is None else {}
    with LiveView(host, port, REAL_TIME) as live:
        try:
            say(f"Watch at {live.address} (Ctrl-C ends it)")
            warn_of_strangers(host, "look on and press the buttons")
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
    from craftsim.experiments.bundle import TEXT, read_bundle
    from craftsim.rendering.trajectory import Trajectory, name_of, trajectory_files
    from craftsim.validation.recording import record_bundle

    if is_file(path / TEXT):
        return {path.name: lambda: record_bundle(read_bundle(path))[1]}
    return {name_of(file): partial(Trajectory.read, file) for file in trajectory_files(path)}


def _carry_out(building: Building, live: LiveView) -> Trajectory:
    """Carry out a plan while people look on, and return what happened."""
    from craftsim.checking.attempt import Attempt
    from craftsim.checking.episode import OnAttempts
    from craftsim.checking.judge import Judge

    attempts, task = list[Attempt](), building.task

    def watch(judge: Judge) -> OnAttempts:
        live.follow(judge, building.name, task.goal_cells, lambda: attempts)
        return attempts.extend

    setup = Physics(randomize="none").setup()
    done = building.run(setup, 0, "concurrent", watch)
    assert done.trajectory is not None
    return done.trajectory
