"""``craftsim doctor``: what works on this machine."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from importlib.metadata import requires
from typing import Final

from craftsim.cli.options import OptionalDir
from craftsim.cli.text import say
from craftsim.rendering.offscreen import INSTALL_COMMAND, RenderingUnavailable, choose_backend
from craftsim.storage.folders import owning

_WRONG_MUJOCO: Final = "4.0.0"
"""Its solver tilts and sinks stacked blocks (google-deepmind/mujoco issue 3767, fixed in 4.0.1)."""

_FALLING_BALL: Final = """
import mujoco
model = mujoco.MjModel.from_xml_string(
    '<mujoco><worldbody><geom type="plane" size="1 1 1"/>'
    '<body pos="0 0 0.2"><freejoint/><geom size="0.1"/></body></worldbody></mujoco>'
)
data = mujoco.MjData(model)
while data.time < 1:
    mujoco.mj_step(model, data)
if abs(data.qpos[2] - 0.1) > 0.001:
    raise SystemExit(f"a ball of radius 0.1 m came to rest at {data.qpos[2]:.4f} m")
"""


@dataclass(frozen=True)
class Check:
    """One thing that was tried."""

    what: str
    """What it is for."""
    works: bool
    """Whether it does."""
    found: str
    """What was found, or why it fails."""
    remedy: str = ""
    """The command that fixes it."""


@owning
def doctor(*, out: OptionalDir = None) -> int:
    """Say what works on this machine, and the command that fixes what does not.

    Physics and rendering are really tried, each in a process of its own. Exit status 0 when physics runs, even if
    films cannot be made, 2 when it does not.

    Args:
        out: folder for report.json.
    """
    from rich.table import Table

    from craftsim.reports.json_file import versions, write_report
    from craftsim.reports.terminal import Terminal, cell

    physics = _physics()
    films = [_rendering(), _encoder()]
    checks = [physics, *films]
    table = Table(title="craftsim doctor")
    for heading in ("", "what", "found"):
        table.add_column(heading, overflow="fold")
    for name, found in {**versions(), "processors": str(_processors())}.items():
        table.add_row("", name, found)
    table.add_section()
    for check in checks:
        table.add_row("[green]ok[/]" if check.works else "[red]no[/]", check.what, cell(check.found))
    Terminal().print(table)
    for check in checks:
        if check.remedy:
            say(f"{check.what}: run this to fix it:\n    {check.remedy}")
    if out is not None:
        figures = {"checks": checks, "processors": _processors()}
        say(f"Report: {write_report(out, figures, command='doctor')}")
    if not physics.works:
        say("Physics does not run.")
        return 2
    say("All well." if all(check.works for check in films) else "Physics runs; films cannot be made yet.")
    return 0


def _physics() -> Check:
    what = "physics (MuJoCo)"
    wanted = next(line for line in requires("craftsim") or [] if line.startswith("mujoco"))
    install = f"{sys.executable} -m pip install '{wanted}'"
    from craftsim.reports.json_file import versions

    found = versions()["mujoco"]
    if found == _WRONG_MUJOCO:
        return Check(what, False, f"version {found} gives wrong contact physics", install)
    command = [sys.executable, "-P", "-c", _FALLING_BALL]
    child = subprocess.run(command, capture_output=True, text=True, check=False)
    if child.returncode == 0:
        return Check(what, True, f"{found}, a dropped ball comes to rest")
    reason = (child.stderr.strip().splitlines() or [f"exit status {child.returncode}"])[-1]
    # A backend that cannot load makes the import of MuJoCo itself fail.
    return Check(what, False, reason, _unset_backend_or(install))


def _rendering() -> Check:
    what = "off-screen rendering"
    try:
        return Check(what, True, f"{choose_backend()}, renders a frame")
    except RenderingUnavailable as error:
        return Check(what, False, str(error), _unset_backend_or(INSTALL_COMMAND))


def _unset_backend_or(remedy: str) -> str:
    return "unset MUJOCO_GL" if os.environ.get("MUJOCO_GL") else remedy


def _encoder() -> Check:
    import av

    what = "film encoder (H.264)"
    install = f"{sys.executable} -m pip install --force-reinstall --only-binary av av"
    try:
        av.Codec("libx264", "w")
    except ValueError:
        return Check(what, False, f"PyAV {av.__version__} has no libx264", install)
    return Check(what, True, f"libx264 in PyAV {av.__version__}")


def _processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0))
