"""Look at what happened: ``craftsim render`` and ``view``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

from cyclopts import Parameter

from craftsim.cli.progress import counting
from craftsim.cli.text import print_safe, warn_if_exposed
from craftsim.errors import InputError
from craftsim.rendering.ranges import FILM_SPEED, FRAME_RATE, MOMENT_S
from craftsim.rendering.viewer import VIEWER_HOST, VIEWER_PORT, need_viser
from craftsim.storage.limits import PORTS, WORKERS
from craftsim.storage.paths import is_file
from craftsim.validation.options import CarriedPlan, Physics, number

RERUN_SUFFIX: Final = ".rrd"

if TYPE_CHECKING:
    from craftsim.planning.plan_file import Plan
    from craftsim.rendering.trajectory import Trajectory
    from craftsim.rendering.viewer.views import LiveView
    from craftsim.tasks import Task


def render(
    source: Annotated[str, Parameter(metavar="RUN|FILE|TASK")],
    out: Annotated[Path, Parameter(metavar="FILE|DIR/")] = Path("out/render.mp4"),
    *,
    beside: Annotated[tuple[Path, ...], Parameter(metavar="RUN|FILE")] = (),
    camera: Annotated[tuple[str, ...], Parameter(metavar="VIEW")] = ("overview",),
    layout: Literal["side", "main", "inset"] = "side",
    quality: Literal["draft", "paper"] = "draft",
    size: Annotated[str, Parameter(metavar="WxH")] = "1280x720",
    fps: Annotated[int, number(FRAME_RATE)] = 30,
    speed: Annotated[float | None, number(FILM_SPEED)] = None,
    at: Annotated[tuple[float, ...], number(MOMENT_S)] = (),
    hide: tuple[Literal["ghost", "captions", "cards", "none"], ...] | None = None,
    title: Annotated[tuple[str, ...], Parameter(metavar="TITLE")] = (),
    carried: CarriedPlan = CarriedPlan(),  # noqa: B008
    policy: Annotated[str | None, Parameter(metavar="NAME")] = None,
    workers: Annotated[int, number(WORKERS)] = 1,
    physics: Physics = Physics(),  # noqa: B008
) -> int:
    """Make films, animations, pictures, figures, or recordings for Rerun.

    The source is a recorded trajectory, the folder of a run, a replay bundle, or a task or start file: its plan or
    policy is then executed first, and its trajectory is written beside the film.

    If --out has no suffix it is a folder for figures: paths, tracking errors, wheel torques, boards, hinges and contact
    forces, each as PDF and PNG, and all together in all.pdf. Exit status: 0, or 2 for invalid input.

    Args:
        source: a trajectory (.npz), the folder of a replay bundle or of a run with one trajectory (for figures with any
            number), the name of a task, or a blueprint.
        out: file to write, also as --out: .mp4 (H.264), .webm (VP9), .webp or .gif (animations), or .png (a contact
            sheet, or pictures with --at), or .rrd (for the viewer of Rerun); or a folder for figures, such as figures/.
        beside: other recorded runs, shown at its right at the same simulated time.
        camera: one or several views: overview, top, orbit, follow:CAR, closeup:CAR, a YAML file, or grid for the
            predicted grid world.
        layout: several views side by side; one large with the others in a column; or insets in the corners.
        quality: draft, or paper with materials, coordinates and the design as a ghost.
        size: width and height of a frame in pixels.
        fps: frames per second.
        speed: simulated seconds per second of film; default: adapted to the activity.
        at: simulated times of pictures in seconds; for .png only.
        hide: the translucent design, the captions, or the cards at the start and end; default: nothing in films, the
            captions in pictures.
        title: title; default: that of the trajectory. With runs beside it one for each; default: the names of the
            files.
        policy: policy to execute instead of a plan, as in 'craftsim validate'.
        workers: number of processes; the pictures do not depend on it.
    """
    if out.suffix == "":
        if beside:
            raise InputError(
                "figures are of one run; give --out a film or a picture, or leave --beside out"
            )
        return _draw_figures(Path(source), out)
    if out.suffix == RERUN_SUFFIX:
        if beside or at:
            raise InputError(f"{out} is of one whole run; leave --beside and --at out")
        return _write_rerun(source, out, physics, carried, policy)
    from craftsim.cli.films import recorded_run
    from craftsim.rendering.film import FilmOptions
    from craftsim.rendering.offscreen import choose_backend
    from craftsim.rendering.render import check_format
    from craftsim.rendering.render import render as render_file
    from craftsim.storage.folders import output_directory

    hidden = hide or ()
    captions = None
    if hide is not None:
        captions = "captions" not in hidden
    width, sign, height = size.partition("x")
    if not (sign and width.isdecimal() and height.isdecimal() and len(size) < 12):
        raise InputError(
            f"--size is '{size}'; allowed: width and height in pixels, such as 1280x720"
        )
    parts = ("ghost" not in hidden, captions, "cards" not in hidden)
    look = FilmOptions((int(width), int(height)), fps, camera, layout, quality, speed, None, *parts)
    names = title or ((Path(source).stem, *(path.stem for path in beside)) if beside else ())
    if names and len(names) != 1 + len(beside):
        raise InputError(
            f"--title names {len(names)} of {1 + len(beside)} runs; give a title for each, or none"
        )
    check_format(out, at)
    output_directory(out.parent)
    # Before the run that they stand beside, which may have to be made first.
    trajectories = [recorded_run(path) for path in beside]
    choose_backend()
    trajectories = [_find_trajectory(source, out, physics, carried, policy), *trajectories]
    if names:
        trajectories = [
            trajectory.titled(name) for trajectory, name in zip(trajectories, names, strict=True)
        ]
    for path in render_file(
        trajectories, out, look, workers=workers, at=at, progress=counting("frames", bool)
    ):
        print_safe(f"Written: {path}")
    return 0


def _write_rerun(
    source: str, out: Path, physics: Physics, carried: CarriedPlan, policy: str | None
) -> int:
    """Write a recorded run, or one that is executed now, as a recording of Rerun."""
    from craftsim.rendering.rerun_file import need_rerun, write_rerun
    from craftsim.storage.folders import output_directory

    need_rerun()
    output_directory(out.parent)
    trajectory = _find_trajectory(source, out, physics, carried, policy)
    print_safe(f"Written: {write_rerun(out, trajectory)}; look at it with: rerun {out}")
    return 0


def _draw_figures(recorded: Path, out: Path) -> int:
    """Draw figures of a recorded run, or all of a folder; each trajectory gets a folder of its own in ``out``."""
    from craftsim.rendering.plots.figures import write_figures
    from craftsim.rendering.trajectory import Trajectory, trajectory_files
    from craftsim.storage.folders import directory_within, output_directory

    files = trajectory_files(recorded)
    output_directory(out)
    with counting("trajectories", bool)(len(files)) as on_trajectory:
        for file in files:
            written = list(write_figures(directory_within(out, file.stem), Trajectory.read(file)))
            on_trajectory(written)
            print_safe(f"{file.stem}: {len(written)} files in {out / file.stem}")
    return 0


def view(
    source: Annotated[str, Parameter(metavar="RUN|FILE|TASK")],
    *,
    host: Annotated[str, Parameter(metavar="ADDRESS")] = VIEWER_HOST,
    port: Annotated[int, number(PORTS)] = VIEWER_PORT,
) -> int:
    """Show a run in the browser: play, pause, step from action to action, and inspect each car.

    Prints the address to open, and serves it until Ctrl-C. Exit status: 0, or 2 for invalid input.

    Args:
        source: a trajectory, the folder of a recorded run or of a replay bundle, or a task, whose plan is then executed
            live.
        host: address to listen on; the default is reachable from this machine only. There is no password.
        port: port; 0 takes a free one.
    """
    need_viser()
    from craftsim.cli.films import is_recorded, recorded_runs
    from craftsim.experiments.bundle import BUNDLE_FILE
    from craftsim.rendering.viewer.page import REAL_TIME
    from craftsim.rendering.viewer.views import LiveView, RecordedView
    from craftsim.validation.rollout import planned_task

    planned = None
    if not is_recorded(source):
        planned = planned_task(source)
    runs = {}
    if planned is None:
        runs = recorded_runs(Path(source))
    with LiveView(host, port, REAL_TIME) as live:
        try:
            print_safe(f"Watch at {live.address} (Ctrl-C ends it)")
            warn_if_exposed(host, "look on and press the buttons")
            if planned is not None:
                trajectory = _run_live(*planned, live)
                runs[planned[0].name] = lambda: trajectory
            is_bundle = planned is None and is_file(Path(source) / BUNDLE_FILE)
            recorded_view = RecordedView(live.page, runs, at_failure=is_bundle)
            if planned is not None:
                live.page.ask(lambda: recorded_view.seek(math.inf))  # where it has just ended
            recorded_view.serve()
        except KeyboardInterrupt:
            return 0


def _run_live(task: Task, plan: Plan, live: LiveView) -> Trajectory:
    """Execute a plan in nominal physics while the browser shows it, and return what was recorded."""
    from craftsim.checking.attempt import Attempt
    from craftsim.checking.judge import Judge
    from craftsim.checking.recipe import OnAttempts
    from craftsim.validation.rollout import run_plan

    attempts = list[Attempt]()

    def watch(judge: Judge) -> OnAttempts:
        live.follow(judge, task.name, task.goal_cells, lambda: attempts)
        return attempts.extend

    episode = run_plan(task, plan, Physics(randomize="none").setup(), 0, "concurrent", watch)
    assert episode.trajectory is not None
    return episode.trajectory


def _find_trajectory(
    source: str, out: Path, physics: Physics, carried: CarriedPlan, policy: str | None
) -> Trajectory:
    """Return the trajectory that a word on the command line stands for.

    What is not recorded yet is run now, and written beside ``out``, under its name with the ending ``.npz``.
    """
    from craftsim.cli.films import is_recorded, recorded_run
    from craftsim.rendering.trajectory import SUFFIX
    from craftsim.validation.sources import record_once

    if is_recorded(source):
        if carried.plan or policy:
            raise InputError(f"{source} is recorded already; leave --plan and --policy out")
        return recorded_run(Path(source))
    plan = carried.plan_file
    setup = physics.setup()
    trajectory = record_once(
        source, setup, physics.seed, plan=plan, policy=policy, order=carried.order
    )
    print_safe(f"Recorded: {trajectory.write(out.with_suffix(SUFFIX))}")
    return trajectory
