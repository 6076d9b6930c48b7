"""``craftsim render``: films and pictures of what happened in physics."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from craftsim.choices import PlanOrder
from craftsim.cli.options import File
from craftsim.cli.text import say
from craftsim.errors import InputError
from craftsim.options import Physics, number
from craftsim.storage.limits import FILM_SPEED, FRAME_RATE, MOMENT_S, WORKERS


def render(
    what: Annotated[str, Parameter(metavar="RUN|FILE|TASK")],
    out: Annotated[Path, Parameter(metavar="FILE|DIR/")] = Path("out/render.mp4"),
    *,
    camera: Annotated[tuple[str, ...], Parameter(metavar="VIEW")] = ("overview",),
    layout: Literal["side", "main", "inset"] = "side",
    quality: Literal["draft", "paper"] = "draft",
    size: Annotated[str, Parameter(metavar="WxH")] = "1280x720",
    fps: Annotated[int, number(FRAME_RATE)] = 30,
    speed: Annotated[float | None, number(FILM_SPEED)] = None,
    at: Annotated[tuple[float, ...], number(MOMENT_S, "SECONDS")] = (),
    ghost: bool = True,
    captions: bool | None = None,
    cards: bool = True,
    title: str | None = None,
    run: Annotated[str | None, Parameter(metavar="NAME")] = None,
    plan: File = None,
    policy: Annotated[str | None, Parameter(metavar="NAME")] = None,
    order: PlanOrder = "concurrent",
    workers: Annotated[int, number(WORKERS)] = 1,
    physics: Physics = Physics(),  # noqa: B008
) -> int:
    """Make a film, an animation, pictures or figures of a recorded trajectory, of a run's folder, of a replay bundle,
    or of a task or start file whose plan or policy is carried out now.

    A name without an ending is a folder for figures: paths, tracking errors, wheel torques, boards, hinges and contact
    forces, each as PDF and PNG, and all of them in all.pdf.

    What is carried out now is also written beside the film as a trajectory, from which other films can be rendered.
    Exit status 0, or 2 for wrong input.

    Args:
        what: a trajectory (.npz), a folder of a run or of a replay bundle, a shipped task's name, or a blueprint.
        out: the file to write; its name ends in .mp4 (H.264), .webm (VP9), .webp or .gif (animations), or .png (a
            contact sheet, or with --at pictures); or a folder for figures, such as figures/.
        camera: one or several views: overview, top, orbit, follow:CAR, closeup:CAR, a YAML file, or grid, which is what
            the rules predict.
        layout: several views side by side; the first one large with the others in a column; or as insets in a corner of
            the first one, where they hide none of the area.
        quality: draft, or paper with shadows, materials, coordinates and the design as a ghost.
        size: width and height of a frame in pixels.
        fps: frames a second.
        speed: simulated seconds in a second of film; unless given it follows what the cars do.
        at: simulated times of pictures to take, in seconds; for .png only.
        ghost: what the design still lacks, translucent.
        captions: what the cars do and how it is judged, beside the picture; in films unless given.
        cards: a card at the start and one at the end of a film.
        title: in place of the trajectory's own.
        run: name of one of the trajectories in a run's folder.
        plan: plan file for a blueprint or task, 'tick car ACTION' a line.
        policy: in place of a plan, as of 'craftsim validate'.
        order: how a plan is carried out.
        workers: processes to share the work; the pictures do not depend on it.
    """
    if out.suffix == "":
        from craftsim.cli.plot import draw_figures

        return draw_figures(Path(what), run, out)
    from craftsim.cli.progress import counting
    from craftsim.cli.sources import find_trajectory
    from craftsim.rendering.film import Look
    from craftsim.rendering.offscreen import choose_backend
    from craftsim.rendering.render import check_format
    from craftsim.rendering.render import render as render_file
    from craftsim.reports.terminal import Terminal
    from craftsim.storage.folders import output_directory

    look = Look(_pixels(size), fps, camera, layout, quality, speed, None, ghost, captions, cards, title)
    check_format(out, at)
    choose_backend()
    output_directory(out.parent)
    trajectory = find_trajectory(what, out, run, physics, plan, policy, order)
    console = Terminal()
    written = render_file(
        trajectory,
        out,
        look,
        workers=workers,
        at=at,
        progress=lambda total: counting(console, "frames", total, bool),
    )
    for path in written:
        say(f"Written: {path}")
    return 0


def _pixels(text: str) -> tuple[int, int]:
    """Return width and height from a text such as ``1280x720``; raise InputError for another one."""
    width, sign, height = text.partition("x")
    if not (sign and width.isdecimal() and height.isdecimal() and len(text) < 12):
        raise InputError(f"--size is '{text}'; allowed: width and height in pixels, such as 1280x720")
    return int(width), int(height)
