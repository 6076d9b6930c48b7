"""The page of the viewer: the scene, the playback controls, and the state of the selected car.

Events of browsers arrive in threads of the server; they wait in a queue until :meth:`ViewerPage.attend`.
"""

from __future__ import annotations

import math
import queue
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import Attempt
from craftsim.discrete.grid import Cell
from craftsim.models.world import PhysicsWorld
from craftsim.rendering.viewer.scene import BrowserScene
from craftsim.workers.copying import NotCopyable

if TYPE_CHECKING:
    from viser import GuiEvent, ViserServer

FRAMES_HZ: Final = 25.0
"""How often poses are sent at most."""
_TEXT_S: Final = (
    0.15  # real time between two updates of texts and the slider; eyes do not follow faster ones
)
REAL_TIME: Final = "1 x"
AS_IT_GOES: Final = "as it goes"
SPEEDS: Final = {
    "1/8 x": 0.125,
    "1/4 x": 0.25,
    "1/2 x": 0.5,
    "1 x": 1.0,
    "2 x": 2.0,
    "4 x": 4.0,
    "8 x": 8.0,
    AS_IT_GOES: math.inf,
}
"""Simulated seconds in a second."""
_LISTED: Final = 9  # actions in the list at one time
_GOOD = "#2b8a3e"
_BAD = "#c92a2a"
_QUIET = "#868e96"
_ROWS: Final = "<table style='width:100%;font-size:0.8em;border-spacing:0 0.15em'>"


class Moment(NamedTuple):
    """State of a car at one moment of a run."""

    time_s: float
    action: str
    """Name of the action that runs; empty where there is none."""
    pose: Sequence[float]
    """x, y and z in metres, where it is."""
    measured: Sequence[float] | None
    """x and y in metres and heading in radians, as it measures them; None where nobody knows."""
    motors: tuple[tuple[str, float, float], ...]
    """For each wheel, then for the board: its name, what it gives and the most that it can give, in Nm and in N."""
    attempt: Attempt | None
    """The verdict on its action, where that is known, or else on its last one; None before its first."""
    contact_n: float
    """The largest force between any two machines; nan where nobody looks."""


class ViewerPage(NotCopyable):
    """The page that all browsers of a server show; all share one state."""

    _instead = "open another one"

    def __init__(self, server: ViserServer, speed: str) -> None:
        """Add the panel, with a speed of :data:`SPEEDS`; a scene comes with :meth:`show_world`."""
        from viser import Icon

        self._server = server
        self._n_cars = 0
        self._next_text_s = 0.0
        self._icons = {True: Icon.PLAYER_PAUSE, False: Icon.PLAYER_PLAY}
        self.controls: Mapping[str, Callable[..., None]] = {}
        """Buttons: ``toggle``, ``step``, ``step_back``, ``seek`` (to a time), ``choose`` (a run); one that is
        missing does nothing."""
        self._pending: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self.scene: BrowserScene | None = None
        self.car = 0
        """The one that is looked at."""
        gui = server.gui
        server.scene.world_axes.visible = False
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        gui.set_panel_label("craftsim")
        self._title = gui.add_html("")
        self.run = gui.add_dropdown("Run", ("",), visible=False)
        self.play = gui.add_button("Play", icon=Icon.PLAYER_PLAY)
        self.back = gui.add_button("Previous action", icon=Icon.PLAYER_SKIP_BACK)
        self.forward = gui.add_button("Next action", icon=Icon.PLAYER_SKIP_FORWARD)
        self.speed = gui.add_dropdown("Speed", tuple(SPEEDS), initial_value=speed)
        self.slider = gui.add_slider("Time (s)", min=0.0, max=1.0, step=0.02, initial_value=0.0)
        with gui.add_folder("Car"):
            self._cars = gui.add_dropdown("Car", ("0",))
            self._state = gui.add_html("")
        with gui.add_folder("Actions"):
            self._list = gui.add_html("")
        self._when(self.run.on_update, lambda: self._control("choose", self.run.value))
        self._when(self.play.on_click, lambda: self._control("toggle"))
        self._when(self.back.on_click, lambda: self._control("step_back"))
        self._when(self.forward.on_click, lambda: self._control("step"))
        self._when(self.slider.on_update, lambda: self._control("seek", float(self.slider.value)))
        self._when(self._cars.on_update, lambda: self.look_at(int(self._cars.value)))

    def _when(
        self, register: Callable[[Callable[[GuiEvent[Any]], None]], Any], do: Callable[[], None]
    ) -> None:
        # What this program sets has no client.
        register(lambda event: None if event.client is None else self.ask(do))

    def _control(self, name: str, *value: object) -> None:
        if name in self.controls:
            self.controls[name](*value)

    def offer(self, runs: Sequence[str], times_s: tuple[float, float] | None) -> None:
        """Offer runs to choose from, and moments between two times, where it is a recorded one."""
        _put(self.run, "options", tuple(runs) or ("",))
        self.run.visible = len(runs) > 1
        for control in (self.back, self.forward, self.slider):
            control.visible = times_s is not None
        if times_s is not None:
            first_s, last_s = times_s
            self.slider.min = first_s
            self.slider.max = max(last_s, first_s + self.slider.step)
            if self.speed.value == AS_IT_GOES:
                _put(self.speed, "value", REAL_TIME)
            _put(self.speed, "options", tuple(name for name in SPEEDS if name != AS_IT_GOES))

    def ask(self, do: Callable[[], None]) -> None:
        """Have something done at the next :meth:`attend`; from any thread."""
        self._pending.put(do)

    def attend(self) -> bool:
        """Do what people asked for since the last call; return whether there was anything."""
        has_requests = not self._pending.empty()
        while not self._pending.empty():
            self._pending.get()()
        return has_requests

    def show_world(self, title: str, physics: PhysicsWorld, marks: Mapping[Cell, float]) -> None:
        """Show another world; ``marks`` as of :class:`BrowserScene`."""
        self._title.content = _framed(f"<b>{escape(title)}</b>")
        self.scene = BrowserScene(
            self._server, physics, marks, lambda car: self.ask(lambda: self.look_at(car))
        )
        self._n_cars = len(physics.cars)
        self._cars.options = tuple(map(str, range(self._n_cars))) or ("0",)
        self.look_at(0)

    def look_at(self, car: int) -> None:
        """Choose the car whose state is shown."""
        self.car = car
        _put(self._cars, "value", str(car))
        self.hurry()

    def show(
        self,
        qpos: NDArray[np.float64],
        time_s: float,
        attempts: Sequence[Attempt],
        moment: Callable[[int], Moment],
    ) -> None:
        """Show a moment: poses at once, words not more often than they can be read.

        ``qpos`` are MuJoCo's positions of everything (nq,), ``attempts`` those of the run as far as they are known, and
        ``moment`` returns what is known of a car, by its number.
        """
        assert self.scene is not None, "show_world() comes first"
        self.scene.show(qpos)
        wall_s = time.monotonic()
        if wall_s < self._next_text_s:
            return
        self._next_text_s = wall_s + _TEXT_S
        with self._server.atomic():
            _put(self.slider, "value", round(min(max(time_s, self.slider.min), self.slider.max), 3))
            if self._n_cars:
                _put(self._state, "content", car_html(moment(self.car)))
            _put(self._list, "content", list_html(attempts, time_s))

    def show_playing(self, playing: bool) -> None:
        """Let the button say what it does now."""
        _put(self.play, "label", "Pause" if playing else "Play")
        _put(self.play, "icon", self._icons[playing])

    def hurry(self) -> None:
        """Show words with the next moment, however short ago they were shown."""
        self._next_text_s = 0.0

    def print_error(self, text: str) -> None:
        """Show what is wrong to everybody."""
        for client in self._server.get_clients().values():
            client.add_notification("This cannot be shown", text, color="red")


def _put(handle: Any, name: str, value: object) -> None:
    """Set a property of a part of the panel; the same value is not sent again."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)


def car_html(moment: Moment) -> str:
    """Return what is known of a car as HTML."""
    x, y, z = moment.pose
    rows = {
        "time": f"{moment.time_s:.2f} s",
        "action": escape(moment.action) or "waits",
        "pose": f"{x:z.3f}, {y:z.3f}, {z:z.3f} m",
    }
    if moment.measured is not None:
        x, y, heading = moment.measured
        rows["measured"] = f"{x:z.3f}, {y:z.3f} m, {math.degrees(heading):z.1f}°"
    *wheels, (_, force, limit) = moment.motors
    rows["wheels (Nm)"] = "".join(_bar(name[-2:], *figures) for name, *figures in wheels)
    rows["board (N)"] = _bar("", force, limit)
    if not math.isnan(moment.contact_n):
        rows["largest contact"] = f"{moment.contact_n:.0f} N, of all machines"
    cells = (
        f"<tr><td style='color:{_QUIET}'>{name}</td><td>{text}</td></tr>"
        for name, text in rows.items()
    )
    verdict = ""
    attempt = moment.attempt
    if attempt is not None:
        which = ""
        if attempt.action != moment.action:
            which = f"last: {escape(attempt.action)}, "
        reason = ""
        if attempt.reason:
            reason = f"<br>{escape(attempt.reason)}"
        verdict = f"<div style='font-size:0.85em;margin-top:0.3em'>{which}{_verdict(attempt)}{reason}</div>"
    return _framed(f"{_ROWS}{''.join(cells)}</table>{verdict}")


def list_html(attempts: Iterable[Attempt], time_s: float) -> str:
    """Return the actions around a moment as HTML: when each began, of which car, and the verdict on it."""
    ordered = sorted(attempts, key=lambda attempt: (attempt.start_s, attempt.car))
    if not ordered:
        return _framed(f"<span style='color:{_QUIET}'>no actions yet</span>")
    n_begun = sum(attempt.has_begun(time_s) for attempt in ordered)
    first = max(0, min(n_begun - _LISTED // 2 - 1, len(ordered) - _LISTED))
    rows = []
    for number, attempt in enumerate(ordered[first : first + _LISTED], first):
        runs = attempt.has_begun(time_s) and not attempt.has_ended(time_s)
        if runs:
            style = "font-weight:600;background:#e7f5ff"
        elif number >= n_begun:
            style = f"color:{_QUIET}"
        else:
            style = ""
        texts = (
            f"{attempt.start_s:.1f} s",
            f"car {attempt.car}",
            escape(attempt.action),
            _verdict(attempt),
        )
        rows.append(f"<tr style='{style}'>{''.join(f'<td>{text}</td>' for text in texts)}</tr>")
    return _framed(f"{_ROWS}{''.join(rows)}</table>")


def _verdict(attempt: Attempt) -> str:
    return (
        f"<span style='color:{_GOOD if attempt.agrees else _BAD}'>{escape(attempt.result)}</span>"
    )


def _bar(name: str, force: float, limit: float) -> str:
    share = 0.0
    if limit:
        share = min(1.0, abs(force) / limit)
    bar = f"<span style='display:block;width:{100 * share:.0f}%;height:0.3em;background:#4dabf7'></span>"
    style = "display:inline-block;width:24%;margin-right:1%;font-size:0.9em"
    return f"<span style='{style}' title='of {limit:g}'>{name} {force:z.2f}{bar}</span>"


def _framed(content: str) -> str:
    return f"<div style='padding:0 0.75em'>{content}</div>"
